"""What comes before a run, is made once and kept in its folder: a start in equilibrium, a scheme and a step."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app, unit

from openmm_exactrb.command.boxes import Box, begin_at
from openmm_exactrb.command.progress import Progress
from openmm_exactrb.context.platforms import mixed
from openmm_exactrb.files import written_whole
from openmm_exactrb.runs import Run
from openmm_exactrb.runs.checkpoint import differences
from openmm_exactrb.runs.identity import text_of_system
from openmm_exactrb.runs.text import hash_of
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.states import read_xml
from openmm_exactrb.tuning.advice import CANDIDATES, progress, tune

#: Files in the folder of a run: what it was asked for, where it begins, and scheme and step that were measured.
COMMAND, START, STEP = "command.json", "start.xml", "step.json"

# What may change until a step was measured: after a target that nothing reaches, for example.
_OF_STEP = ("setting step", "setting target", "setting scheme")
_CHUNK = 50
_ITERATIONS = 100  # of the minimisation: clashes are gone then, the thermostat does the rest
_STEP = 1.0 * unit.femtosecond  # of the equilibration: also free hydrogen atoms take it
_FRICTION = 5.0 / unit.picosecond


def claim(job: Run, args: argparse.Namespace, box: Box, platform: openmm.Platform, files: Iterable[str]) -> None:
    """Make a folder that of a run, before anything is prepared: delete what is to be overwritten, refuse what is not.

    Parameters
    ----------
    job : Run
        Alone in its folder.
    args : argparse.Namespace
    box : Box
        With its barostat.
    platform : openmm.Platform
    files : iterable of str
        Those that the run may write, beside the ones that are prepared.

    Raises
    ------
    FileExistsError
        If there is a file of an earlier run.
    ValueError
        If what was prepared there is that of another command.
    """
    if job.resuming:  # the checkpoint tells whose it is
        return
    prepared: tuple[str, ...] = COMMAND, START, STEP
    if args.overwrite:
        job.discard()
        for name in (*prepared, *files):
            (job.folder / name).unlink(missing_ok=True)
    if args.resume and (job.folder / COMMAND).exists():
        here = _described(job, box, platform)
        _refuse_others(job.folder / COMMAND, here, () if (job.folder / STEP).exists() else _OF_STEP)
        _keep(job, COMMAND, json.dumps(here, indent=1))
        prepared = ()
    for name in (*prepared, *files):
        job.path(name)


def start_of(job: Run, args: argparse.Namespace, box: Box, platform: openmm.Platform) -> openmm.State:
    """Return where the run begins, at step 0: the State of the user, or one brought to the temperature.

    A start without velocities is minimised, gets some, and equilibrates for ``--equilibration`` under OpenMM's
    LangevinMiddleIntegrator.
    """
    file = job.folder / START
    if args.resume and file.exists():
        return read_xml(file, openmm.State)
    state = _equilibrated(args, box, platform)
    _keep(job, COMMAND, json.dumps(_described(job, box, platform), indent=1))
    _keep(job, START, openmm.XmlSerializer.serialize(state))
    return state


def step_of(
    job: Run, args: argparse.Namespace, box: Box, start: openmm.State, platform: openmm.Platform
) -> tuple[dict[str, Any], float]:
    """Return options of the integrator, its scheme among them, and the step in ps: measured if that is asked for."""
    if args.step is not None:
        return {} if args.scheme is None else {"scheme": args.scheme}, args.step
    file = job.folder / STEP
    if args.resume and file.exists():
        try:
            kept = json.loads(file.read_text())
            return {"scheme": str(kept["scheme"]), "fast": kept["fast"]}, float(kept["step"])
        except (ValueError, KeyError, TypeError):
            raise ValueError(f"{file} is damaged: begin anew in another folder or with --overwrite") from None
    result = tune(
        box.system,
        start,
        target=args.target,
        schemes=_schemes(args),
        platform=platform,
        report=None if args.quiet else progress,
    )
    if result.chosen is None:
        raise ValueError(f"{str(result).splitlines()[-1]} Give a larger --target, or a --step.")
    if not args.quiet:
        print(result.chosen, file=sys.stderr)
    options, step = result.chosen.options(), result.chosen.step
    _keep(job, STEP, json.dumps({**options, "step": step}))
    return options, step


def _schemes(args: argparse.Namespace) -> Sequence[str] | None:
    """Return the schemes to be tried, None for the usual ones: a bath has none that are processed."""
    if args.scheme is not None:
        return [args.scheme]
    if args.ensemble == "nve":
        return None
    return [name for name in CANDIDATES if not look_up(name).processor]


def _equilibrated(args: argparse.Namespace, box: Box, platform: openmm.Platform) -> openmm.State:
    integrator = openmm.LangevinMiddleIntegrator(args.temperature * unit.kelvin, _FRICTION, _STEP)
    integrator.setRandomNumberSeed(args.seed)
    simulation = app.Simulation(box.topology, box.system, integrator, platform, mixed(platform))
    if box.state is not None:
        begin_at(simulation, box.state)
    else:
        simulation.context.setPositions(box.positions)
    if not box.moves:
        if box.state is None:
            simulation.minimizeEnergy(maxIterations=_ITERATIONS)
        simulation.context.setVelocitiesToTemperature(args.temperature * unit.kelvin, args.seed)
        _advance(simulation, args)
    simulation.context.setTime(0.0)
    simulation.context.setStepCount(0)
    return simulation.context.getState(positions=True, velocities=True, parameters=True)


def _advance(simulation: Any, args: argparse.Namespace) -> None:
    step = simulation.integrator.getStepSize().value_in_unit(unit.picosecond)
    steps = round(args.equilibration / step)
    tell = Progress("equilibration", steps, step, args.quiet)
    while (left := steps - simulation.currentStep) > 0:
        simulation.step(min(_CHUNK, left))
        tell(min(_CHUNK, left))
    tell.close()


def _described(job: Run, box: Box, platform: openmm.Platform) -> dict[str, str]:
    """Return what decides start and step, by name."""
    return {
        **job.settings,
        "platform": platform.getName(),
        "System": text_of_system(box.system),
        "start": hash_of(_bytes_of_start(box)),
    }


def _bytes_of_start(box: Box) -> bytes:
    if box.state is not None:
        return str(openmm.XmlSerializer.serialize(box.state)).encode()
    return np.array(box.positions.value_in_unit(unit.nanometer)).tobytes()


def _refuse_others(file: Path, here: dict[str, str], free: Iterable[str]) -> None:
    """Raise ValueError if a file does not describe this run, but for what is free."""
    try:
        there = dict(json.loads(file.read_text()))
    except (ValueError, TypeError):
        raise ValueError(f"{file} is damaged: begin anew in another folder or with --overwrite") from None
    for name, was, now in differences(there, here):
        if name not in free:
            raise ValueError(
                f"{file} is of another command: {name} is {was} in it, but {now} now: give the same again, or begin "
                "anew in another folder or with --overwrite"
            )


def _keep(job: Run, name: str, text: str) -> None:
    with written_whole(job.folder / name) as out:
        out.write(text)
