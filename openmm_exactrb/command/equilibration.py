"""The preparation of a run: an equilibrated initial State and a tuned scheme and step, determined once and stored."""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import openmm
from openmm import app, unit

from openmm_exactrb.command.inputs import Box, begin_at
from openmm_exactrb.command.progress import counted, waiting
from openmm_exactrb.context.solver import mended
from openmm_exactrb.errors import ShapeWarning, UnreachableError
from openmm_exactrb.integrators.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.integrators.states import read_xml
from openmm_exactrb.openmm_access.platforms import mixed, why_not_by_default
from openmm_exactrb.runs import Run
from openmm_exactrb.runs.signals import LostInterrupts
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.support.files import written_whole
from openmm_exactrb.support.warn import warn
from openmm_exactrb.tuning.advice import CANDIDATES, progress, tune
from openmm_exactrb.tuning.preparation import heat, minimise

#: Files in the folder of a run that contain the initial State, and the tuned scheme and step.
START, STEP = "start.xml", "step.json"

# Without --equilibrate, the equilibration lasts this fraction of --duration, but at most this time in ps.
_PART, _LONGEST = 0.2, 5.0


def claim(job: Run, args: argparse.Namespace, files: Iterable[str]) -> None:
    """Delete from the folder of a locked run the files that it may overwrite; raise FileExistsError for other files.

    The run writes `files` in addition to `START` and `STEP`. A run that is resumed without a checkpoint replaces
    `START` and `STEP`.
    """
    if job.resuming:
        return
    files = list(files)
    if args.overwrite:
        job.discard()
        for name in (START, STEP, *files):
            (job.folder / name).unlink(missing_ok=True)
    for name in files if args.resume else (START, STEP, *files):
        job.path(name)


def start_of(job: Run, args: argparse.Namespace, box: Box, platform: openmm.Platform) -> openmm.State:
    """Return the State at step 0, which is the user's State or an equilibrated State.

    Positions without velocities are minimised and, with random velocities, equilibrated (see ``--equilibrate``).
    """
    if job.resuming:
        return read_xml(job.folder / START, openmm.State)
    with LostInterrupts() as interrupts:
        state = _equilibrated(args, box, platform, interrupts)
        interrupts.check()
    _store(job, START, openmm.XmlSerializer.serialize(state))
    return state


def step_of(
    job: Run, args: argparse.Namespace, box: Box, start: openmm.State, platform: openmm.Platform
) -> tuple[dict[str, Any], float]:
    """Return options of the integrator, such as its scheme, and the step in ps, tuned unless a step is given."""
    if args.step is not None:
        return {} if args.scheme is None else {"scheme": args.scheme}, args.step
    if job.resuming:
        stored = json.loads((job.folder / STEP).read_text(encoding="utf-8"))
        return stored, stored.pop("step")
    report = None if args.quiet else progress
    options = {"target": args.target, "schemes": candidates(args), "budget": args.budget}
    result = tune(box.system, start, platform=platform, report=report, **options)
    try:
        choice = result.best()
    except UnreachableError as error:
        why = f"{str(error)[0].upper()}{str(error)[1:]}"
        raise ValueError(
            f"--step auto found no suitable step: use a larger --target or --budget, or set --step. {why}"
        ) from None
    if not args.quiet:
        print(choice, file=sys.stderr)
    options, step = choice.options(), choice.step
    _store(job, STEP, json.dumps({**options, "step": step}))
    return options, step


def candidates(args: argparse.Namespace) -> Sequence[str] | None:
    """Return the names of the schemes to try, or None for the default. Thermostats exclude processed schemes."""
    if args.scheme is not None:
        return [args.scheme]
    if args.ensemble == "nve":
        return None
    return [name for name in CANDIDATES if not look_up(name).processor]


def length_of(args: argparse.Namespace) -> float:
    """Return the length of the equilibration in ps, or 0 if it is shorter than a step of the run."""
    length = float(min(_PART * args.duration, _LONGEST) if args.equilibrate is None else args.equilibrate)
    return length if args.step is None or length >= args.step else 0.0


def _equilibrated(
    args: argparse.Namespace, box: Box, platform: openmm.Platform, interrupts: LostInterrupts
) -> openmm.State:
    integrator = ExactRigidBodyLangevinIntegrator(args.temperature, 0.0, 1e-6, engine="host")
    integrator.setRandomNumberSeed(args.seed)
    simulation = app.Simulation(box.topology, box.system, integrator, platform, mixed(platform))
    if box.state is not None:
        begin_at(simulation, box.state)
    else:
        simulation.context.setPositions(box.positions)
    if not box.moves:
        mended(simulation.context)
        with warnings.catch_warnings():  # positions of a file need not match the constraints before the minimisation
            warnings.simplefilter("ignore", ShapeWarning)
            flexible = len(integrator.bodyState()[0].clusters) > 0  # only OpenMM's minimiser supports clusters
        if flexible and (why := why_not_by_default(platform.getName())):
            warn(f"{why}: use --platform CPU if this run ends without a message")
        with waiting("minimising", args.quiet):
            minimise(integrator)
        integrator.setVelocitiesToTemperature(args.temperature, args.seed)
        length = length_of(args)
        if length and not args.quiet:
            print(f"equilibrating for {length:g} ps (--equilibrate)", file=sys.stderr, flush=True)
        reached = _femtoseconds(simulation)
        with counted("equilibrating", round(1000.0 * length), "fs", args.quiet) as tell:
            for _ in heat(integrator, simulation.context, length):
                interrupts.check()
                before, reached = reached, _femtoseconds(simulation)
                tell(reached - before)
    simulation.context.setTime(0.0)
    simulation.context.setStepCount(0)
    return simulation.context.getState(positions=True, velocities=True, parameters=True)


def _femtoseconds(simulation: app.Simulation) -> int:
    return round(float(simulation.context.getTime().value_in_unit(unit.femtosecond)))


def _store(job: Run, name: str, text: str) -> None:
    with written_whole(job.folder / name) as out:
        out.write(text)
