"""Advice for a user's own system: the cheapest scheme and step size for a given energy error."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import openmm
from openmm import app, unit

from openmm_exactrb.errors import StepSizeWarning
from openmm_exactrb.openmm_access.units import stripped
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.support.checks import positive, whole
from openmm_exactrb.tuning.benchmark import CANDIDATES, NESTED_CANDIDATES, STARTS, Benchmark, Method, schemes_named
from openmm_exactrb.tuning.budget import Budget
from openmm_exactrb.tuning.floor import causes
from openmm_exactrb.tuning.initial_state import InitialState, initial_state, thermalised
from openmm_exactrb.tuning.measurements import UNSURE, Measurements, Point, Report
from openmm_exactrb.tuning.result import Tuning
from openmm_exactrb.tuning.search import COARSE, RATIO, probed, search

__all__ = ["CANDIDATES", "progress", "tune"]

#: Default limit of the processor time of a tuning, in seconds.
BUDGET = 120.0

# Usual and smallest length of survey runs in characteristic times, and ratio of the lengths of production and survey
# runs. For a given horizon, survey runs last a tenth of it, but at least their usual length and at most the last number
# times this length.
_SURVEY, _SHORTEST, _LONGER, _LONGEST = 100.0, 30.0, 10.0, 4.0
# Fractions of the force evaluations that the budget allows, for the survey and for production runs. Number of step
# sizes down to the target, time per evaluation near the target in characteristic times, and number of settings that are
# run until one meets the target.
_OF_SURVEY, _OF_PRODUCTION, _DEEP, _NEAR, _ATTEMPTS = 0.5, 0.4, 8, 0.15, 1.7
# Number of schemes that are tried even if the survey becomes short.
_FEWEST = 4


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
    budget: float | unit.Quantity = BUDGET,
    duration: float | unit.Quantity | None = None,
    levels: int = 10,
    seed: int = 0,
    report: Callable[[str], None] | None = progress,
) -> Tuning:
    """Find the cheapest scheme and step size for a given energy error by measuring schemes on a system.

    The error is the standard deviation of the total energy within an NVE run of length `horizon`, in kJ/mol per body
    (rigid bodies and single particles). Causes that limit the accuracy of every scheme are reported first. If the
    target is less than half the error due to the forces, the search is skipped. Survey runs have the length `duration`,
    and their errors are extrapolated to the horizon from the growth of the variance. The recommended setting is then
    run over the whole horizon from three initial states: the given one, and two others at its temperature. The promised
    error is the largest of the three, increased if the error depends so steeply on the step that another initial state
    may have a larger error. Costs are measured as in `Simulation.step`, which calls the integrator once per ten steps.
    If the System has bonds or angles that are not constrained, schemes with ``fast="bonded"`` are tried too: those of
    `schemes`, or `NESTED_CANDIDATES`.

    Parameters
    ----------
    system : openmm.System or openmm.app.Simulation
        A Simulation also provides its state, box, parameters, platform, active force groups and the bodies passed as
        `bodies`. Errors and costs are measured without its thermostats, barostats and motion removers.
    start : openmm.State or (n, 3) array or Quantity, optional
        A State with positions and velocities, preferably from an equilibrated run, or positions, in nm if they have no
        unit.
    target : float, optional
        Standard deviation of the total energy to be reached, in kJ/mol per body. Without a target, all step sizes are
        measured, and the result provides settings for any error.
    schemes : sequence of str or Scheme, optional
        By default `CANDIDATES`, or as many of them as the budget allows. The name of a custom scheme must not be a key
        of `SCHEMES`. OpenMM's VerletIntegrator is measured too if constraints define all bodies. If this integrator
        fails, the result states the failure.
    velocities : (n, 3) array or Quantity, optional
        Velocities if `start` contains positions only, in nm/ps if they have no unit.
    temperature : float or Quantity, optional
        Temperature in K, required if all velocities are zero. Positions without velocities are minimised; Langevin
        dynamics of this package then brings the system to the temperature.
    platform : str or openmm.Platform, optional
        By default the platform named by OPENMM_DEFAULT_PLATFORM, otherwise the fastest one except for OpenCL on a CPU.
    properties : mapping, optional
        Properties of the platform; by default mixed precision if the platform offers it.
    bodies : sequence of sequences of int, optional
        As in `ExactRigidBodyIntegrator`; by default the argument of the Simulation's integrator.
    horizon : float or Quantity, optional
        Length of the production runs for which errors are promised, in ps if it has no unit. The default is ten times
        `duration`, or less if the budget does not allow that.
    budget : float or Quantity, optional
        Processor time that may be used, in s if it has no unit; by default two minutes. If it is not sufficient for the
        production runs, the recommendation relies on fewer of them or on the survey alone, and the result states this.
    duration : float or Quantity, optional
        Length of the survey runs, in ps if it has no unit. The default is 100 divided by the root mean square frequency
        of the system (1.5 ps for water). If a tenth of a given horizon is longer, this tenth is used, up to four times
        the default. The runs are shorter if the budget requires it.
    levels : int, optional
        Largest number of step sizes, which decrease from the largest stable one by factors of sqrt(2).
    seed : int, optional
        Seed of the momenta and of the noise of preparations.
    report : callable, optional
        Function that is called with a line of text per run. The default writes to stderr, and None suppresses the
        output.

    Returns
    -------
    Tuning

    Raises
    ------
    ValueError
        If an argument is missing or invalid, all velocities are zero and no temperature is given, the temperature is
        not reached, or a scheme is unknown or cannot be used.
    RuntimeError
        If the budget is spent before the first measurement.
    """
    wanted = None if target is None else positive(target, "target", "kJ/mol per body")
    allowed = Budget(positive(stripped(budget, unit.second), "budget", "s"))
    plain, levels = schemes_named(CANDIDATES if schemes is None else schemes), whole(levels, "levels", least=3)
    nested = plain if schemes is not None else schemes_named(NESTED_CANDIDATES)
    survey = None if duration is None else positive(stripped(duration, unit.picosecond), "duration", "ps")
    production = None if horizon is None else positive(stripped(horizon, unit.picosecond), "horizon", "ps")
    state, notes = initial_state(system, start, velocities, platform, properties, bodies)
    tell = report or (lambda line: None)
    state = _in_motion(state, temperature, seed, allowed, notes, tell)
    benchmark = Benchmark(state, allowed, seed)
    methods = [Method(scheme) for scheme in plain]
    methods += [Method(scheme, nested=True) for scheme in nested if benchmark.nests]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepSizeWarning)  # steps that are too long are tried on purpose
        methods, survey, production = _plan(benchmark, methods, survey, production, free=schemes is None)
        tell(
            f"{len(methods)} methods, {survey:.3g} ps each; errors hold for {production:.3g} ps "
            f"(budget: {allowed.seconds:g} s of processor time)"
        )
        measured = Measurements(benchmark, methods, survey, production, tell)
        floor, best = probed(measured), None
        if wanted is not None and floor is not None and wanted < 0.5 * floor:
            tell(f"the target is out of reach: {floor:.1e} kJ/mol per body come from the forces alone")
        else:
            best = search(measured, wanted, levels, floor)
    return _result(measured, wanted, floor, best, notes)


def _in_motion(
    state: InitialState, temperature: Any, seed: int, budget: Budget, notes: list[str], tell: Report
) -> InitialState:
    """Report what limits the energy error, and bring the state to the temperature if one is given."""
    for cause in causes(state.system):
        tell(f"limits the energy error of any integrator: {cause}")
    at_rest = not state.state.getVelocities(asNumpy=True)._value.any()
    if temperature is None and at_rest:
        raise ValueError(
            "all velocities of the start are zero, so the energy error is not that of a system in motion: pass a "
            "State with velocities from an equilibrated run, or set temperature="
        )
    if temperature is None:
        return state
    kelvin = positive(stripped(temperature, unit.kelvin), "temperature", "K")
    notes.append(
        f"the start was brought to {kelvin:g} K in a short run: the State of an equilibrated run is a better start"
    )
    tell(f"bringing the start to {kelvin:g} K")
    return thermalised(state, kelvin, seed, at_rest, budget)


def _plan(
    benchmark: Benchmark, methods: list[Method], survey: float | None, horizon: float | None, free: bool
) -> tuple[list[Method], float, float]:
    """Return methods and run lengths that fit into the budget, keeping those that the user gave."""
    time = benchmark.characteristics.time
    affordable = benchmark.evaluations_left()
    deep = sum(RATIO**level / COARSE for level in range(_DEEP))  # evaluations of a method per characteristic time
    usual = _SURVEY * time
    if survey is None and horizon is not None:
        usual = min(max(usual, horizon / _LONGER), _LONGEST * usual)
    if free:
        most = max(_FEWEST, int(_OF_SURVEY * affordable / (deep * _SURVEY)))
        plain, nested = ([method for method in methods if method.nested == kind] for kind in (False, True))
        half = most if not nested else (most + 1) // 2
        methods = plain[:half] + nested[:half]
    if survey is None:
        survey = min(usual, max(_OF_SURVEY * affordable / (deep * len(methods)), _SHORTEST) * time)
    if horizon is None:
        horizon = _OF_PRODUCTION * affordable * _NEAR / (STARTS * _ATTEMPTS) * time
        horizon = max(survey, min(horizon, _LONGER * survey))
    return methods, survey, horizon


def _result(
    measured: Measurements, target: float | None, floor: float | None, best: Point | None, notes: list[str]
) -> Tuning:
    benchmark = measured.benchmark
    state, scales = benchmark.state, benchmark.characteristics
    if scales.time == scales.free:
        notes.append(
            "bodies hardly interact at the start: the measured errors say little about runs in which they collide"
        )
    if best is not None and floor is not None and best.error < 1.5 * floor:
        notes.append("the forces limit the error of the chosen setting: a smaller target gains nothing")
    if measured.cut:
        notes.append(
            f"the budget of {benchmark.budget.seconds:g} s of processor time ended the search: a larger one allows "
            "more schemes, smaller steps and longer runs"
        )
    tuning = Tuning(
        points=tuple(measured.points),
        methods=measured.methods,
        n_bodies=scales.n_bodies,
        platform=state.platform.getName(),
        duration=measured.duration,
        horizon=measured.horizon,
        target=target,
        floor=floor,
        causes=tuple(causes(state.system)),
        notes=tuple(notes),
        bodies=state.bodies,
        groups=state.groups,
    )
    if best is not None:
        return replace(tuning, chosen=tuning.choice(best))
    if target is not None and measured.cut:
        return replace(tuning, chosen=tuning.surveyed(target / UNSURE))
    return tuning
