"""A Simulation with its files in one folder."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NoReturn

from openmm import app

from openmm_exactrb.checks import not_negative, whole
from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.motion.guard import NonFiniteError
from openmm_exactrb.runs import checkpoint, options
from openmm_exactrb.runs.checkpoint import CHECKPOINT, Checkpoint
from openmm_exactrb.runs.identity import identity_of
from openmm_exactrb.runs.lock import only_process
from openmm_exactrb.runs.options import IN_SCRIPT, Words
from openmm_exactrb.runs.outputs import TOPOLOGY, Outputs
from openmm_exactrb.runs.signals import Signals
from openmm_exactrb.runs.text import text_of

# What all of a run has in common, whatever changes between two calls of advance().
_COMMON = ("platform", "System", "bodies")
# Steps between two looks at signals and the clock: as many as Simulation.step takes at once.
_CHUNK = 10


class Run:
    """A Simulation with its files in one folder, which goes on after any accident as if nothing had happened.

    At intervals the state and the lengths of all output files are saved, whole or not at all. A run that is resumed
    cuts the files back to these lengths, loads the state and goes on, so that no frame is lost or doubled; on the
    Reference platform every file ends in the same bits as without the accident.

    Parameters
    ----------
    folder : str or path
        Made when the run begins.
    resume : bool, optional
        Go on from the checkpoint in the folder; begin if there is neither a checkpoint nor a file of a run.
    overwrite : bool, optional
        Replace the files of an earlier run that is not resumed.
    every : float, optional
        Seconds between two checkpoints; infinite for none before the end.
    settings : mapping, optional
        What else must be the same for a run to be resumed, beside System, integrator, platform and reporters.
    words : Words, optional
        What messages tell a user to add; `from_options` names the options of the command line.

    Raises
    ------
    FileExistsError
        If the folder holds an earlier run that is neither to be resumed nor to be overwritten.
    ValueError
        If the checkpoint is damaged or of another version, `every` is negative or no number, or `settings` no mapping.

    Attributes
    ----------
    folder : path
    resuming : bool
        Whether there is a checkpoint to go on from.
    wall : float
        Seconds that the run took up to now, without what an accident lost.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        resume: bool = False,
        overwrite: bool = False,
        every: float = 60.0,
        settings: Mapping[str, Any] | None = None,
        words: Words = IN_SCRIPT,
    ) -> None:
        never = every == math.inf
        self._every = every if never else not_negative(every, "the time between checkpoints", "seconds")
        self.folder = Path(folder)
        self._may_replace = overwrite
        self._words = words
        if settings is not None and not isinstance(settings, Mapping):
            raise ValueError(f"settings must be a mapping from names to values, not {settings!r}")
        self._settings = {f"setting {name}": text_of(value) for name, value in (settings or {}).items()}
        self._outputs = Outputs(self.folder)
        self._last = checkpoint.read(self._file, words.overwrite) if resume and self._file.exists() else None
        self._chapter = 0  # of those that the checkpoint has
        self._chapters = self._last.chapters if self._last else []
        self._first = self._last.first if self._last else 0
        self._held = False
        self.resuming = self._last is not None
        self.wall = self._last.wall if self._last else 0.0
        for name in (CHECKPOINT, TOPOLOGY):
            self.path(name)

    @staticmethod
    def add_options(parser: argparse.ArgumentParser, folder: str = "out") -> None:
        """Give a command line the options --out, --overwrite, --resume and --checkpoint."""
        options.add_options(parser, folder)

    @classmethod
    def from_options(
        cls,
        args: argparse.Namespace,
        subfolder: str = "",
        *,
        free: Iterable[str] = (),
        settings: Mapping[str, Any] | None = None,
    ) -> Run:
        """Make a run from the options of `add_options`.

        Parameters
        ----------
        args : argparse.Namespace
            All options beside those of `add_options` must be the same for the run to be resumed.
        subfolder : str, optional
            Of --out.
        free : iterable of str, optional
            Options that may change.
        settings : mapping, optional
            What must be the same beside the options.

        Raises
        ------
        FileExistsError, ValueError
            As the class does.
        """
        return cls(**options.arguments_of(args, subfolder, free, settings))

    def path(self, name: str) -> Path:
        """Return the path of a file in the folder that this run may write.

        Raises
        ------
        FileExistsError
            If it is there, and the run may neither resume nor overwrite.
        """
        file = self.folder / name
        if file.exists() and not (self.resuming or self._may_replace):
            raise FileExistsError(
                f"{file} is of an earlier run: choose another folder, add {self._words.resume} where there is a "
                f"checkpoint to go on from, or add {self._words.overwrite}"
            )
        return file

    def add_reporter(self, reporter: Callable[..., Any], name: str, interval: int) -> None:
        """Add an output file.

        Parameters
        ----------
        reporter : callable
            Makes the reporter from the path, the interval and ``append=``, as `EnergyReporter` and OpenMM's DCDReporter
            and StateDataReporter do; with further options as a `functools.partial`.
        name : str
            Of the file in the folder.
        interval : int
            Steps between two reports; the start is reported too.

        Raises
        ------
        FileExistsError
            As `path` does.
        ValueError
            If the interval is no whole number of at least 1, the reporter takes no ``append=``, or the file is that of
            another reporter or of the run itself.
        """
        if name in (CHECKPOINT, TOPOLOGY):
            raise ValueError(f"{name} is a file of the run itself: give the reporter another one")
        self.path(name)
        self._outputs.add(reporter, name, whole(interval, "interval", of="steps"))

    def advance(self, simulation: Any, until: int, progress: Callable[[int], object] | None = None) -> None:
        """Bring a Simulation to a step, from its start or from the checkpoint.

        On SIGINT (Ctrl-C), SIGTERM and SIGHUP it finishes the steps under way, saves a checkpoint, says how to go on
        and raises SystemExit with the usual status, 128 + the number of the signal. A second signal acts at once.

        Where a run is refused before its first step, by a reporter or the integrator, it leaves no file behind.

        Parameters
        ----------
        simulation : openmm.app.Simulation
            At its start. Where a run is resumed the state does not matter, unless bodies are named by hand: their shape
            is that of the first positions, which must be the same again.
        until : int
            Number of the last step.
        progress : callable, optional
            Is told how many steps were made since it was called last; first how many the checkpoint had.

        Raises
        ------
        ValueError
            If the checkpoint is of another System, platform, version, integrator or setting, or a file is shorter than
            it says: nothing was changed then. If `until` is no whole number, or `simulation` no Simulation.
        BlockingIOError
            If another process is at work in the folder.
        NonFiniteError
            If a force or momentum became infinite or nan: all before it is on disk, with a checkpoint of the last good
            step.
        OSError
            If a file cannot be written, for example on a full disk. What is there can be resumed.
        SystemExit
            After a signal.
        """
        if not isinstance(simulation, app.Simulation):
            raise ValueError(f"advance() takes an openmm.app.Simulation, not {type(simulation).__name__}")
        until = whole(until, "until, the number of the last step,", least=0)
        tell = progress or (lambda steps: None)
        self._choose_engine(simulation.integrator)
        identity = self._identity_of(simulation)
        with self.alone(), Signals() as signals:
            begins, first = self._last is None, simulation.currentStep
            try:
                goes_on = self._begin(simulation, identity, until)
                tell(simulation.currentStep)
                if goes_on:
                    self._step(simulation, until, tell, signals)
                    self._save(simulation)
            except NonFiniteError as error:
                self._save(simulation)
                raise NonFiniteError(f"{error}. All before it is on disk: {self._files()}") from error
            except OSError as error:
                self._explain(error)
            except Exception:
                if begins and simulation.currentStep == first:  # refused before the first step: no file is left
                    self._forget()
                raise
            finally:
                self._outputs.close(simulation)
        if signals.caught:
            self._leave(simulation.currentStep, until, signals.caught)

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Keep all other processes out of the folder, for files that a script prepares there; `advance` does so itself.

        Raises
        ------
        BlockingIOError
            If another process is at work in the folder.
        FileExistsError
            If there is an earlier run by now that may neither be resumed nor overwritten.
        ValueError
            If another process went on with this run since.
        """
        if self._held:
            yield
            return
        if self.folder.exists() and not self.folder.is_dir():
            raise FileExistsError(f"{self.folder} is a file: choose another folder")
        self.folder.mkdir(parents=True, exist_ok=True)
        with only_process(self.folder):
            self._held = True
            try:
                self._look_again()
                yield
            finally:
                self._held = False

    def discard(self) -> None:
        """Delete the files of an earlier run that is to be overwritten; nothing where the run goes on.

        The checkpoint goes first, so that nobody resumes what is half gone.
        """
        if self._last is not None or not self._may_replace:
            return
        old: Iterable[str] = ()
        with contextlib.suppress(ValueError, OSError):  # a damaged one is overwritten too
            old = checkpoint.read(self._file).files
        self._file.unlink(missing_ok=True)
        for name in (*old, TOPOLOGY):
            (self.folder / name).unlink(missing_ok=True)

    @property
    def settings(self) -> dict[str, str]:
        """What must be the same for the run to be resumed, beside System, integrator, platform and reporters."""
        return dict(self._settings)

    @property
    def _file(self) -> Path:
        return self.folder / CHECKPOINT

    def _look_again(self) -> None:
        """Take note of what other processes did in the folder before it was held."""
        if self.resuming:
            self._last = checkpoint.read(self._file, self._words.overwrite)
            self._chapters, self._first, self.wall = self._last.chapters, self._last.first, self._last.wall
        elif self._last is None:
            for name in (CHECKPOINT, TOPOLOGY, *self._outputs.names):
                self.path(name)
        elif checkpoint.read(self._file).state != self._last.state:
            raise ValueError(f"another process went on with the run in {self.folder}: go on with {self._again}")

    def _choose_engine(self, integrator: Any) -> None:
        """Have a run go on with the engine that it began with."""
        if self.resuming and self._last is not None and isinstance(integrator, ExactRigidBodyIntegrator):
            integrator.preferEngine(self._last.identity.get("engine", "host"))

    def _identity_of(self, simulation: Any) -> dict[str, str]:
        files = {f"file {name}": kind for name, kind in self._outputs.kinds().items()}
        return identity_of(simulation) | files | self._settings

    def _begin(self, simulation: Any, identity: dict[str, str], until: int) -> bool:
        """Begin the run or the next chapter of it, or load the checkpoint; return whether there is anything to do.

        A script that calls `advance` more than once, with other settings each time, goes on with those of the chapter
        that the checkpoint is of: the chapters before it are over.
        """
        if self._last is None:
            self.discard()
            self._first, self._chapters = simulation.currentStep, [identity]
            self._save(simulation)  # before there is a file: what is found beside a checkpoint is of its run
        elif self.resuming:
            self._chapter = self._last.chapter_of(identity, self._chapter, self._file)
            over = self._chapter < len(self._chapters) - 1
            if over and until > self._last.step:
                raise ValueError(
                    f"{self._file} is of step {self._last.step}, but the run had other settings there than it has now "
                    f"on its way to step {until}: bring it to the same steps as before"
                )
            if not over:
                self._last.refuse_cut_files(self.folder)
            _load(simulation, self._last.state)
            _set_timings(simulation.integrator, self._last.timings)
            if over:
                return False
        else:
            checkpoint.refuse_others(self._last.identity, identity, self._file, _COMMON)
            if identity != self._chapters[-1]:
                self._chapters = [*self._chapters, identity]
        self.resuming = False
        self._outputs.open(simulation, self._last.files if self._last else {}, self._first)
        return True

    def _forget(self) -> None:
        """Delete what a run wrote that has not made a step."""
        self._last = None
        self._outputs.remove()
        self._file.unlink(missing_ok=True)

    def _step(self, simulation: Any, until: int, tell: Callable[[int], object], signals: Signals) -> None:
        now = time.monotonic()
        due = now + self._every
        while simulation.currentStep < until and not signals.caught:
            steps = min(_CHUNK, until - simulation.currentStep)
            simulation.step(steps)
            self.wall += time.monotonic() - now
            now = time.monotonic()
            tell(steps)
            if now >= due:
                self._save(simulation)
                due = time.monotonic() + self._every

    def _save(self, simulation: Any) -> None:
        """Write all files through to the disk, then a checkpoint that knows their lengths."""
        present = Checkpoint(
            step=simulation.currentStep,
            first=self._first,
            wall=self.wall,
            timings=_timings(simulation.integrator),
            files=self._outputs.secured(),
            chapters=self._chapters,
            state=simulation.context.createCheckpoint(),
        )
        checkpoint.write(self._file, present)
        self._last = present

    @property
    def _again(self) -> str:
        """What to start so that the run goes on."""
        return f"the same {'script' if self._words is IN_SCRIPT else 'command'} and {self._words.resume}"

    def _files(self) -> str:
        return f"{self.folder}: " + ", ".join([*self._outputs.kinds(), TOPOLOGY, CHECKPOINT])

    def _explain(self, error: OSError) -> NoReturn:
        step = self._last.step if self._last else 0
        self.resuming = self._last is not None
        raise OSError(
            f"{error.strerror or error} (writing to {self.folder}). The run is safe up to step {step}: "
            f"put it right and go on with {self._again}"
        ) from error

    def _leave(self, step: int, until: int, number: int) -> NoReturn:
        name = signal.Signals(number).name
        print(f"\n{name}: stopped at step {step} of {until}. Go on with {self._again}", file=sys.stderr)
        raise SystemExit(128 + number)


def _load(simulation: Any, state: bytes) -> None:
    """Load a checkpoint of OpenMM, and again where it is one of a program that an integrator gets only then."""
    simulation.context.loadCheckpoint(state)
    if isinstance(simulation.integrator, ExactRigidBodyIntegrator) and simulation.integrator.getEngine() == "device":
        simulation.integrator.degreesOfFreedom()
        simulation.context.loadCheckpoint(state)


def _timings(integrator: Any) -> dict[str, float]:
    """Return the timings of the integrator by name; none of another one."""
    return asdict(integrator.timings) if isinstance(integrator, ExactRigidBodyIntegrator) else {}


def _set_timings(integrator: Any, timings: Mapping[str, float]) -> None:
    for name, value in timings.items():
        setattr(integrator.timings, name, value)
