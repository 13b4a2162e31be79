"""Rigid-body dynamics as the function of a recipe."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb import checks
from openmm_exactrb.context.units import stripped
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.schemes import Scheme

# What makes the forces of a platform the same numbers at every run.
_DETERMINISTIC = {"CPU": {"Threads": "1", "DeterministicForces": "true"}}


def energies(
    build: Callable[..., Any],
    *,
    step: float | unit.Quantity,
    duration: float | unit.Quantity,
    scheme: str | Scheme = "SRKN4_6b",
    rotor: str = "exact",
    temperature: float | unit.Quantity | None = None,
    seed: int = 0,
    frames: int = 100,
    platform: str = "Reference",
    **arguments: Any,
) -> dict[str, Any]:
    """Run rigid-body dynamics and return its energies; ready for a `Recipe`.

    Parameters
    ----------
    build : callable
        ``build(**arguments)`` returns (topology, system, positions) or (topology, system, positions, velocities), as
        `openmm_exactrb.dipole_fluid` and `openmm_exactrb.rigid_water` do. It gets the seed too if it takes one.
    step, duration : float or Quantity
        In ps if without a unit. The duration is rounded to whole steps, of which it has at least one.
    scheme, rotor
        As `ExactRigidBodyIntegrator` takes them.
    temperature : float or Quantity, optional
        In K if without a unit. Momenta are drawn with the seed; without it they are those of the velocities, or zero.
    seed : int, optional
    frames : int, optional
        Samples after the first one, at least one, evenly spread over the steps.
    platform : str, optional
        With "CPU", its one thread and its deterministic forces are chosen.
    **arguments
        For `build`.

    Returns
    -------
    dict
        "times" in ps and "energies" (total) in kJ/mol, lists of one length; "steps" and "evaluations" (of forces).

    Raises
    ------
    ValueError
        If step or duration is no positive time, the duration is shorter than a step, or frames is no whole number of at
        least 1.
    NonFiniteError
        If the run blows up.
    """
    step, duration = _time(step, "step"), _time(duration, "duration")
    if duration < step * (1.0 - 1e-9):
        raise ValueError(f"duration must be at least one step of {step} ps, not {duration} ps")
    frames = checks.whole(frames, "frames")
    seeded = {"seed": seed} if "seed" in inspect.signature(build).parameters else {}
    _, system, positions, *velocities = build(**arguments, **seeded)
    integrator = ExactRigidBodyIntegrator(step, scheme=scheme, rotor=rotor, engine="host")
    kind = openmm.Platform.getPlatform(platform)
    context = openmm.Context(system, integrator, kind, _DETERMINISTIC.get(platform, {}))
    context.setPositions(positions)
    if velocities:
        context.setVelocities(velocities[0])
    if temperature is not None:
        integrator.setVelocitiesToTemperature(temperature, seed)
    steps = round(duration / step)
    stops = np.unique(np.linspace(0, steps, min(frames, steps) + 1).round().astype(int))
    table = [_time_and_energy(context, integrator)]
    integrator.timings.reset()
    for stride in np.diff(stops).tolist():
        integrator.step(stride)
        table.append(_time_and_energy(context, integrator))
    times, totals = zip(*table, strict=True)
    return {"times": times, "energies": totals, "steps": steps, "evaluations": integrator.timings.evaluations}


def _time(value: Any, name: str) -> float:
    """Return a time in ps, which must be positive."""
    return checks.positive(stripped(value, unit.picosecond), name, "ps")


def _time_and_energy(context: openmm.Context, integrator: ExactRigidBodyIntegrator) -> tuple[float, float]:
    """Return the time in ps and the total energy in kJ/mol."""
    return context.getTime()._value, integrator.totalEnergy()._value
