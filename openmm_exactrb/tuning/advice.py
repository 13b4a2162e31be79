"""Advice for a user's own system: which scheme and step, at which energy error and cost."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import openmm
from openmm import app, unit

from openmm_exactrb.checks import positive, whole
from openmm_exactrb.context.find import find_bodies
from openmm_exactrb.context.nesting import AUTO, Nesting, nested_in
from openmm_exactrb.context.units import stripped
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.tuning.bench import Bench
from openmm_exactrb.tuning.measurements import Measurements
from openmm_exactrb.tuning.movers import NestedScheme, own_scheme, schemes_of
from openmm_exactrb.tuning.record import Choice
from openmm_exactrb.tuning.result import Tuning
from openmm_exactrb.tuning.search import Found, search
from openmm_exactrb.tuning.start import Start, start_of
from openmm_exactrb.tuning.thermal import thermalised

#: Schemes that are tried unless others are named: for each accuracy those that are the cheapest on some system. Schemes
#: made for a small potential are not among them, nor compositions of Verlet steps, which others beat.
CANDIDATES = (
    "V2",
    "W2_1",
    "S2_2",
    "S2_4",
    "W2_4",
    "W2_5",
    "W4_4",
    "W4_5",
    "W4_6",
    "SRKN4_6b",
    "SRKN6_11b",
    "SRKN6_14a",
)

#: Schemes that are tried with nested bonded forces unless others are named.
NESTED_CANDIDATES = ("W2_1", "S2_2", "S2_3", "W2_4", "W2_5", "W4_4", "W4_5", "SRKN4_6b", "ABA_8_6_4")

# Length of the runs of the survey in units of the system's time scale; of those for which errors are promised, in units
# of that.
_SURVEY, _LONGER = 100.0, 10.0
# The survey of a horizon that is named is a tenth of it, up to so many times the usual one.
_LONGEST = 4.0


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
    nest: bool = True,
    levels: int = 10,
    seed: int = 0,
    report: Callable[[str], None] | None = progress,
) -> Tuning:
    """Measure energy error and wall time of schemes on a system, and find the cheapest for a wanted error.

    The error is the standard deviation of the total energy, its swing and its wandering or drift alike, in kJ/mol per
    body (rigid bodies, and particles beside them), within an NVE run as long as the horizon. The survey runs
    `duration`; how the variance grows from 1/8 of a run to all of it tells how it goes on. The recommended setting is
    run over all of the horizon first. A wandering energy is known badly from one run, so that its error is raised by up
    to a half. Short swings alone would not do: where a step is long against the vibrations, the energy wanders for
    picoseconds, and near hard cores as a random walk does; what a scheme gains in short runs may be lost in longer
    ones.

    Parameters
    ----------
    system : openmm.System or openmm.app.Simulation
        A Simulation gives its state, box, parameters, platform, force groups that act and bodies named by hand too.
        Thermostats, barostats and motion removers are left out of the measurements.
    start : openmm.State or (n, 3) array or Quantity, optional
        A State with positions and velocities, best of an equilibrated run; or positions, in nm if without a unit.
    target : float, optional
        Wanted standard deviation of the total energy in kJ/mol per body. Without one all levels are measured, and the
        result is asked.
    schemes : sequence of str or Scheme, optional
        `CANDIDATES` unless given. One of your own must have a name that is none of the catalogue's. OpenMM's
        VerletIntegrator is measured beside them where constraints hold all bodies.
    velocities : (n, 3) array or Quantity, optional
        Beside positions, in nm/ps if without a unit.
    temperature : float or Quantity, optional
        In K: minimise positions that come without velocities, draw momenta and let them mix with the positions, 20
        times or more within some periods, until they have it. Needed where all velocities are zero.
    platform : str or openmm.Platform, optional
        That of OPENMM_DEFAULT_PLATFORM, else the fastest one here, unless given.
    properties : mapping, optional
        Of the platform; mixed precision where there is a choice, unless given.
    bodies : sequence of sequences of int, optional
        As in `ExactRigidBodyIntegrator`; those of the integrator of a Simulation unless given.
    horizon : float or Quantity, optional
        Length of the runs for which errors are promised, in ps if without a unit: that of your own runs, or 30 ps.
        Wandering shows only in runs as long as this, which take their time. Ten times `duration` unless given.
    duration : float or Quantity, optional
        Length of the runs of the survey, in ps if without a unit; 100 over the root mean square frequency of the
        system unless given (1.5 ps for water), or a tenth of a named horizon, if that is longer, up to four times this.
    nest : bool, optional
        Whether schemes are tried with ``fast="bonded"`` too, where the System has bonds and angles that move: those
        named, or `NESTED_CANDIDATES`. The others nest nothing.
    levels : int, optional
        Most levels of the time a force evaluation, each sqrt(2) below the one before, from the largest stable one.
    seed : int, optional
        Of the momenta.
    report : callable, optional
        Gets a line of text for each run, which goes to stderr if nothing is given; None for silence.

    Returns
    -------
    Tuning

    Raises
    ------
    ValueError
        If something is missing or does not fit, all velocities are zero without a temperature, the temperature is not
        reached, or a scheme is unknown or cannot serve.
    """
    wanted = None if target is None else positive(target, "target", "kJ/mol per body")
    chosen = schemes_of(CANDIDATES if schemes is None else schemes)
    levels = whole(levels, "levels", least=3)
    length = None if duration is None else positive(stripped(duration, unit.picosecond), "duration", "ps")
    named = None if horizon is None else positive(stripped(horizon, unit.picosecond), "horizon", "ps")
    begin, notes = start_of(system, start, velocities, platform, properties, bodies)
    if temperature is not None:
        kelvin = positive(stripped(temperature, unit.kelvin), "temperature", "K")
        begin = thermalised(begin, kelvin, seed, minimise=not begin.velocities.any())
        notes.append(
            f"the start was brought to {kelvin:g} K in a short run: the State of an equilibrated one is better"
        )
    elif not begin.velocities.any():
        raise ValueError(
            "all velocities of the start are zero, and the energy error of a system at rest says nothing about one in "
            "motion: give a State of an equilibrated run with velocities=True, or a temperature in K"
        )
    inner = _nested(begin, schemes) if nest else []
    bench = Bench(begin)
    if length is None:
        usual = _SURVEY * bench.scales.time
        length = usual if named is None else min(max(usual, named / _LONGER), _LONGEST * usual)
    promised = _LONGER * length if named is None else named
    measured = Measurements(bench, [*chosen, *inner], length, promised, report or (lambda line: None))
    found = search(measured, wanted, levels)
    return _result(measured, found, wanted, notes)


def _result(measured: Measurements, found: Found, target: float | None, notes: list[str]) -> Tuning:
    start, scales = measured.bench.start, measured.bench.scales
    own = {name: scheme for name, method in measured.methods.items() if (scheme := own_scheme(method))}
    floor, best = found
    if scales.time == scales.free:
        notes.append(
            "at the start bodies hardly feel each other: what was measured says little about runs in which they meet"
        )
    if floor is not None and best is not None and best.error < 1.5 * floor:
        notes.append("the chosen setting is at the floor of the forces: nothing is gained by asking for less")
    if best is not None and (looks := _looks(measured, best.method)):
        notes.append(
            f"{best.method} evaluates forces {looks} times more for each call of step, and so for each report: that is "
            "not in its cost, so let reports be some hundred forces apart. Simulation.step calls it every ten steps"
        )
    chosen = None
    if best is not None:
        setting = best.method, best.step, best.error, best.cost
        chosen = Choice(*setting, True, start.bodies, own.get(best.method), start.groups)
    return Tuning(
        points=tuple(measured.points),
        seconds=measured.seconds,
        stages=measured.stages,
        n_bodies=scales.n_bodies,
        platform=start.platform,
        duration=measured.duration,
        horizon=measured.horizon,
        target=target,
        chosen=chosen,
        floor=floor,
        notes=tuple(notes),
        bodies=start.bodies,
        schemes=own,
        groups=start.groups,
    )


def _looks(measured: Measurements, name: str) -> int:
    """Return what a look at the state costs beside the steps, in force evaluations."""
    method = measured.methods[name]
    scheme = method.scheme if isinstance(method, NestedScheme) else method
    return scheme.processing if isinstance(scheme, Scheme) else 0


def _nested(start: Start, schemes: str | Scheme | Sequence[str | Scheme] | None) -> list[NestedScheme]:
    """Return the nested schemes that can be tried."""
    bodies = find_bodies(start.system, start.positions, start.bodies)
    if nested_in(start.system, bodies, Nesting(AUTO)) is None:
        return []
    return [NestedScheme(scheme) for scheme in schemes_of(NESTED_CANDIDATES if schemes is None else schemes)]
