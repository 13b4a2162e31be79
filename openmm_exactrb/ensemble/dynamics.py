"""Rigid-body dynamics as the function of a job."""

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
    """Run rigid-body dynamics and return the total energies, as the function of a `Job`.

    Parameters
    ----------
    build : callable
        ``build(**arguments)``, with the seed if it accepts one, returns topology, system, positions and perhaps
        velocities, as `openmm_exactrb.dipole_fluid` does.
    step, duration : float or Quantity
        In ps if without a unit. The duration is rounded to whole steps.
    scheme, rotor
        Of the `ExactRigidBodyIntegrator`.
    temperature : float or Quantity, optional
        Of the momenta, which are drawn with the seed, in K if without a unit.
    frames : int, optional
        Number of samples after the first one, evenly spread over the steps.
    platform : str, optional
        "CPU" runs in one thread with deterministic forces.

    Returns
    -------
    dict
        "times" in ps and "energies" (total) in kJ/mol, "steps", and "evaluations" of forces and energies by the steps.

    Raises
    ------
    ValueError
        If step or frames are not positive, or the duration is shorter than a step.
    IntegrationError
        If the integration diverges.
    """
    step = checks.positive(stripped(step, unit.picosecond), "step", "ps")
    duration = checks.positive(stripped(duration, unit.picosecond), "duration", "ps")
    frames = checks.whole(frames, "frames")
    if duration < step * (1.0 - 1e-9):
        raise ValueError(f"duration must be at least one step of {step} ps, not {duration} ps")
    seeded = {"seed": seed} if "seed" in inspect.signature(build).parameters else {}
    _, system, positions, *velocities = build(**arguments, **seeded)
    integrator = ExactRigidBodyIntegrator(step, scheme=scheme, rotor=rotor, engine="host")
    properties = {"Threads": "1", "DeterministicForces": "true"} if platform == "CPU" else {}
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform), properties)
    context.setPositions(positions)
    if velocities:
        context.setVelocities(velocities[0])
    if temperature is not None:
        integrator.setVelocitiesToTemperature(temperature, seed)
    steps = round(duration / step)
    stops = np.unique(np.linspace(0, steps, min(frames, steps) + 1).round().astype(int))
    integrator.timings.reset()
    times, totals = [], []
    for stride in [0, *np.diff(stops).tolist()]:
        integrator.step(stride)
        times.append(context.getTime()._value)
        totals.append(integrator.totalEnergy()._value)
    return {"times": times, "energies": totals, "steps": steps, "evaluations": integrator.timings.evaluations}
