"""Advice for a user's own system: the cheapest scheme and step for an energy error."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import openmm
from openmm import app, unit

from openmm_exactrb.mechanics.overheating import StepSizeWarning
from openmm_exactrb.openmm_access.units import stripped
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.support.checks import positive, whole
from openmm_exactrb.tuning.benchmark import CANDIDATES, NESTED_CANDIDATES, Benchmark, Method, schemes_named
from openmm_exactrb.tuning.floor import causes
from openmm_exactrb.tuning.initial_state import initial_state, thermalised
from openmm_exactrb.tuning.measurements import Measurements, Point
from openmm_exactrb.tuning.result import Choice, Tuning
from openmm_exactrb.tuning.search import search

__all__ = ["CANDIDATES", "progress", "tune"]

# Length of survey runs in characteristic times, and of production runs in survey runs. The survey of a named horizon
# takes a tenth of it, up to this many times its usual length.
_SURVEY, _LONGER, _LONGEST = 100.0, 10.0, 4.0


def progress(line: str) -> None:
    """Write a line to stderr."""
    print(line, file=sys.stderr, flush=True)


def tune(
    system: openmm.System | app.Simulation,
    start: Any = None,
    *,
    target: float | None = None,
    schemes: str | Scheme | Sequence[str | Scheme] | None = None,
    velocities: Any = None,
    temperature: float | unit.Quantity | None = None,
    platform: str | openmm.Platform | None = None,
    properties: Mapping[str, str] | None = None,
    bodies: Sequence[Sequence[int]] | None = None,
    horizon: float | unit.Quantity | None = None,
    duration: float | unit.Quantity | None = None,
    levels: int = 10,
    seed: int = 0,
    report: Callable[[str], None] | None = progress,
) -> Tuning:
    """Measure energy error and wall time of schemes on a system, and find the cheapest one for a given error.

    The error is the standard deviation of the total energy within an NVE run as long as `horizon`, in kJ/mol per body
    (rigid bodies and single particles). Survey runs are as long as `duration`, and their errors are extrapolated from
    the growth of the variance with the length of the run. Since the energy may drift over picoseconds, the recommended
    setting is then run over the whole horizon. Costs are those of `Simulation.step`, which calls the integrator every
    ten steps. If the System has bonds and angles that are not constrained, schemes with ``fast="bonded"`` are tried
    too: those of `schemes`, or `NESTED_CANDIDATES`.

    Parameters
    ----------
    system : openmm.System or openmm.app.Simulation
        A Simulation also provides its state, box, parameters, platform, force groups that act and bodies named by hand.
        Errors are measured without its thermostats, barostats and motion removers, costs with them.
    start : openmm.State or (n, 3) array or Quantity, optional
        A State with positions and velocities, preferably of an equilibrated run; or positions, in nm without a unit.
    target : float, optional
        Standard deviation of the total energy to be reached, in kJ/mol per body. Without a target all step sizes are
        measured, and the result provides settings for any error.
    schemes : sequence of str or Scheme, optional
        By default `CANDIDATES`. A scheme of your own needs a name that is not in the catalogue. OpenMM's
        VerletIntegrator is measured too if constraints hold all bodies.
    velocities : (n, 3) array or Quantity, optional
        With positions, in nm/ps without a unit.
    temperature : float or Quantity, optional
        In K, required if all velocities are zero. Positions without velocities are minimised; Langevin dynamics then
        brings the start to the temperature.
    platform : str or openmm.Platform, optional
        By default the one named by OPENMM_DEFAULT_PLATFORM, otherwise the fastest except for OpenCL on a CPU.
    properties : mapping, optional
        Properties of the platform; by default mixed precision if there is a choice.
    bodies : sequence of sequences of int, optional
        As in `ExactRigidBodyIntegrator`; by default those of the integrator of a Simulation.
    horizon : float or Quantity, optional
        Length of the production runs for which errors are promised, in ps without a unit; by default ten times
        `duration`.
    duration : float or Quantity, optional
        Length of the survey runs, in ps without a unit. By default 100 over the root mean square frequency of the
        system (1.5 ps for water), or a tenth of a named horizon if that is longer, up to four times this.
    levels : int, optional
        Largest number of step sizes, from the largest stable one downwards by factors of sqrt(2).
    seed : int, optional
        Of the momenta.
    report : callable, optional
        Called with a line of text per run; by default it is written to stderr. None for no output.

    Returns
    -------
    Tuning

    Raises
    ------
    ValueError
        If an argument is missing or invalid, all velocities are zero and no temperature is given, the temperature is
        not reached, or a scheme is unknown or cannot be used.
    """
    wanted = None if target is None else positive(target, "target", "kJ/mol per body")
    plain = schemes_named(CANDIDATES if schemes is None else schemes)
    levels = whole(levels, "levels", least=3)
    survey = None if duration is None else positive(stripped(duration, unit.picosecond), "duration", "ps")
    production = None if horizon is None else positive(stripped(horizon, unit.picosecond), "horizon", "ps")
    state, notes = initial_state(system, start, velocities, platform, properties, bodies)
    if temperature is not None:
        kelvin = positive(stripped(temperature, unit.kelvin), "temperature", "K")
        state = thermalised(state, kelvin, seed, minimise=not state.velocities.any())
        notes.append(f"the start was brought to {kelvin:g} K in a short run: prefer the State of an equilibrated one")
    elif not state.velocities.any():
        raise ValueError(
            "all velocities of the start are zero, and the energy error of a system at rest says nothing about one in "
            "motion: give a State of an equilibrated run with velocities=True, or a temperature in K"
        )
    benchmark = Benchmark(state)
    nested = plain if schemes is not None else schemes_named(NESTED_CANDIDATES)
    methods = [Method(scheme) for scheme in plain]
    methods += [Method(scheme, nested=True) for scheme in nested if benchmark.nests]
    if survey is None:
        usual = _SURVEY * benchmark.characteristics.time
        survey = usual if production is None else min(max(usual, production / _LONGER), _LONGEST * usual)
    production = _LONGER * survey if production is None else production
    measured = Measurements(benchmark, methods, survey, production, report or (lambda line: None))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepSizeWarning)  # too long steps are tried on purpose
        floor, best = search(measured, wanted, levels)
    return _result(measured, wanted, floor, best, notes)


def _result(
    measured: Measurements, target: float | None, floor: float | None, best: Point | None, notes: list[str]
) -> Tuning:
    state, (n_bodies, _, time, free) = measured.benchmark.state, measured.benchmark.characteristics
    own = {name: scheme for name, method in measured.methods.items() if (scheme := method.own_scheme)}
    chosen = None
    if best is not None:
        setting = best.method, best.step, best.error, best.cost
        evaluations = measured.evaluations[best.method] / best.step
        chosen = Choice(*setting, True, state.bodies, own.get(best.method), state.groups, evaluations)
    if time == free:
        notes.append(
            "at the start bodies hardly feel each other: what was measured says little about runs in which they meet"
        )
    if floor is not None and best is not None and best.error < 1.5 * floor:
        notes.append("the chosen setting is at the floor of the forces: nothing is gained by asking for less")
    return Tuning(
        points=tuple(measured.points),
        seconds=measured.seconds,
        stages=measured.stages,
        evaluations=measured.evaluations,
        n_bodies=n_bodies,
        platform=state.platform,
        duration=measured.duration,
        horizon=measured.horizon,
        target=target,
        chosen=chosen,
        floor=floor,
        causes=tuple(causes(state.system)),
        notes=tuple(notes),
        bodies=state.bodies,
        schemes=own,
        groups=state.groups,
    )
