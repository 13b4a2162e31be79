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

from openmm_exactrb.errors import IntegrationError
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.runs import checkpoint
from openmm_exactrb.runs.checkpoint import CHECKPOINT, Checkpoint
from openmm_exactrb.runs.identity import identity_of, setting_text
from openmm_exactrb.runs.outputs import TOPOLOGY, Outputs
from openmm_exactrb.runs.signals import Signals
from openmm_exactrb.support.checks import not_negative, whole
from openmm_exactrb.support.lock import only_process
from openmm_exactrb.support.messages import shown

_OPTIONS = ("out", "overwrite", "resume", "checkpoint")
_RESUME = "resume the run (resume=True or --resume)"
# Number of steps between checks of signals and the clock, equal to the number per call of the integrator in
# Simulation.step.
_CHUNK = 10


class Run:
    """A Simulation with its files in one folder, which can be resumed after any interruption.

    At intervals, checkpoints store the state and the lengths of all output files. A resumed run truncates the files to
    these lengths and loads the state, so that no frame is lost or duplicated. On the Reference platform and without a
    barostat, every file is identical, byte for byte, to that of an uninterrupted run, except for the date in the header
    of a DCD file.

    Parameters
    ----------
    folder : str or path
        Folder of the files, created when the run begins.
    resume : bool, optional
        Whether to continue from the checkpoint in the folder, if it has one.
    overwrite : bool, optional
        Whether to replace the files of an earlier run that is not resumed.
    every : float, optional
        Seconds between two checkpoints; with infinity, checkpoints are written only at the start and at the end.
    settings : mapping, optional
        Values that must be the same when the run is resumed, in addition to System, integrator, platform and reporters.

    Attributes
    ----------
    folder : path
    resuming : bool
        Whether the next `advance` continues the run from a checkpoint.
    wall : float
        Wall time of the run so far in s, excluding the time lost to interruptions.

    Raises
    ------
    FileExistsError
        If the folder contains an earlier run that is neither resumed nor overwritten.
    TypeError, ValueError
        If the checkpoint is damaged or from another version, or an argument is invalid.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        resume: bool = False,
        overwrite: bool = False,
        every: float = 60.0,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        never = every == math.inf
        self._every = every if never else not_negative(every, "the time between checkpoints", "seconds")
        if settings is not None and not isinstance(settings, Mapping):
            raise ValueError(f"settings must be a mapping from names to values, not {shown(settings)}")
        named = {f"setting {name}": value for name, value in (settings or {}).items()}
        self._settings = {name: setting_text(value, name) for name, value in named.items()}
        self._identity: dict[str, str] = {}
        self.folder = Path(folder)
        self._overwrite = overwrite
        self._outputs = Outputs(self.folder)
        self._last = checkpoint.read(self._file) if resume and self._file.exists() else None
        self._locked = False
        self.resuming = self._last is not None
        self.wall = self._last.wall if self._last else 0.0
        self._check_files()

    @staticmethod
    def add_options(parser: argparse.ArgumentParser, folder: str = "out") -> None:
        """Add the options --out, --overwrite, --resume and --checkpoint to a command line."""
        add = parser.add_argument
        add("--out", type=Path, default=Path(folder), metavar="DIR", help="output folder (default: %(default)s)")
        add("--overwrite", action="store_true", help="replace the files of an earlier run")
        add("--resume", action="store_true", help="continue from the last checkpoint of the same command")
        add(
            "--checkpoint",
            type=float,
            default=60.0,
            metavar="S",
            help="seconds between checkpoints (default: %(default)s)",
        )

    @classmethod
    def from_options(cls, args: argparse.Namespace, subfolder: str = "", *, free: Iterable[str] = ()) -> Run:
        """Create a run in --out, or a subfolder of it, from the options of `add_options`.

        All other options, except those in `free`, are settings, which must be the same when the run is resumed.
        """
        settings = {name: value for name, value in vars(args).items() if name not in {*_OPTIONS, *free}}
        options = {"resume": args.resume, "overwrite": args.overwrite, "every": args.checkpoint}
        return cls(args.out / subfolder, settings=settings, **options)

    def path(self, name: str) -> Path:
        """Return the path of a file that this run may write in its folder.

        Raises
        ------
        FileExistsError
            If the file exists, and the run is neither resumed nor allowed to overwrite files.
        """
        file = self.folder / name
        if file.exists() and not (self.resuming or self._overwrite):
            raise FileExistsError(
                f"{file} belongs to an earlier run: use another folder, {_RESUME} if there is a checkpoint, or "
                "overwrite the earlier run (overwrite=True or --overwrite)"
            )
        return file

    def add_reporter(self, reporter: Callable[..., Any], name: str, interval: int, **options: Any) -> None:
        """Add an output file.

        Parameters
        ----------
        reporter : callable
            Class or function that creates the reporter from the path, the interval and ``append=``, for example
            `EnergyReporter` or OpenMM's DCDReporter and StateDataReporter.
        name : str
            Name of the file in the folder, or its path relative to the folder.
        interval : int
            Number of steps between two reports; the initial state is also reported.
        **options
            Further arguments of the reporter, such as ``step=True, density=True`` for StateDataReporter.

        Raises
        ------
        FileExistsError
            If the file may not be written; see `path`.
        ValueError
            If the interval is not a positive whole number, the reporter takes no ``append=`` or not one of the options,
            or the file is outside the folder or belongs to another reporter or to the run itself.
        """
        name = os.path.normpath(name)
        if Path(name).is_absolute() or Path(name).parts[:1] in ((), (os.pardir,)):
            raise ValueError(f"{name} is outside the folder of the run, {self.folder}: use the name of a file in it")
        if name.removesuffix(".part") in (CHECKPOINT, TOPOLOGY):
            raise ValueError(f"{name} is a file of the run itself: choose another file name for the reporter")
        self.path(name)
        steps = whole(interval, "interval", of="steps")
        if steps >= 2**31:  # trajectories store 32 bits
            raise ValueError(f"interval must be below {2**31} steps, not {steps}: use a shorter interval")
        self._outputs.add(reporter, name, steps, options)

    def advance(self, simulation: Any, until: int, progress: Callable[[int], object] | None = None) -> None:
        """Advance a Simulation to step `until`, from its initial state or from the checkpoint.

        On SIGINT (Ctrl-C), SIGTERM and SIGHUP the run finishes the steps in progress, writes a checkpoint and raises
        SystemExit with the status 128 + the number of the signal. A second signal ends the process immediately. If a
        run fails before its first step for another reason than those named below, its files are deleted.

        Parameters
        ----------
        simulation : openmm.app.Simulation
            A Simulation in its initial state. When a run is resumed, the state of the Simulation is ignored, except for
            its positions. The positions define the shapes of the bodies in `bodies`, and must be those from which the
            run began.
        until : int
            Number of the last step.
        progress : callable, optional
            Function that is called first with the number of steps at the start or the checkpoint, and then with the
            number of steps since its last call.

        Raises
        ------
        ValueError
            If the checkpoint belongs to another System, platform, version, integrator or setting, a file has become
            shorter, or the Simulation has left the last step of the run. Nothing is changed in these cases.
        BlockingIOError
            If another process is running in the folder.
        IntegrationError
            If the integration diverges. The checkpoint contains the last valid step.
        OSError
            If a file cannot be written, for example on a full disk. The run can be resumed.
        SystemExit
            After SIGINT, SIGTERM or SIGHUP.
        """
        if not isinstance(simulation, app.Simulation):
            raise ValueError(f"advance() takes an openmm.app.Simulation, not {type(simulation).__name__}")
        until = whole(until, "until, the number of the last step,", least=0)
        tell = progress or (lambda steps: None)
        self._identity = identity_of(simulation) | self._outputs.identity() | self._settings
        with self.lock(), Signals() as signals:
            begins, first = self._last is None, simulation.currentStep
            try:
                self._begin(simulation)
                tell(simulation.currentStep)
                self._step(simulation, until, tell, signals)
                self._save(simulation)
            except IntegrationError as error:
                self._save(simulation)
                files = ", ".join([*self._outputs.names, TOPOLOGY, CHECKPOINT])
                raise type(error)(f"{error}. All output up to this error is in {self.folder}: {files}") from error
            except OSError as error:
                self._explain(error)
            except Exception:
                if begins and simulation.currentStep == first:
                    self._last = None
                    self._delete(self._outputs.names)
                raise
            finally:
                self._outputs.close(simulation)
        if signals.caught:
            name = signal.Signals(signals.caught).name
            print(f"\n{name}: stopped at step {simulation.currentStep} of {until}; {_RESUME}", file=sys.stderr)
            raise SystemExit(128 + signals.caught)

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the folder while a script prepares files there; `advance` locks it automatically.

        Raises
        ------
        BlockingIOError
            If another process is running in the folder.
        FileExistsError, ValueError
            If another process has meanwhile started a run in the folder, or continued this one.
        """
        if self._locked:
            yield
            return
        if self.folder.exists() and not self.folder.is_dir():
            raise FileExistsError(f"{self.folder} is a file: use another folder")
        self.folder.mkdir(parents=True, exist_ok=True)
        with only_process(self.folder):
            self._locked = True
            try:
                self._refresh()
                yield
            finally:
                self._locked = False

    def discard(self) -> None:
        """Delete the files of an earlier run that is overwritten; do nothing if the run is resumed."""
        if self._last is not None or not self._overwrite:
            return
        old: Iterable[str] = ()
        with contextlib.suppress(ValueError, OSError):  # a damaged checkpoint is overwritten too
            old = checkpoint.read(self._file).files
        self._delete(old)

    def _delete(self, names: Iterable[str]) -> None:
        """Delete files of the run, the checkpoint first, so that an incomplete run is never resumed."""
        for name in (CHECKPOINT, TOPOLOGY, *names):
            (self.folder / name).unlink(missing_ok=True)

    @property
    def _file(self) -> Path:
        return self.folder / CHECKPOINT

    def _refresh(self) -> None:
        """Account for changes by other processes in the folder before it was locked."""
        if self.resuming:
            self._last = checkpoint.read(self._file)
            self.wall = self._last.wall
        elif self._last is None:
            self._check_files()
        elif checkpoint.read(self._file).state != self._last.state:
            raise ValueError(f"another process has continued the run in {self.folder}: {_RESUME}")

    def _check_files(self) -> None:
        for name in (CHECKPOINT, TOPOLOGY, *self._outputs.names):
            self.path(name)

    def _begin(self, simulation: Any) -> None:
        """Write the first checkpoint or load the last one, and open the output files."""
        if self._last is None:
            self.discard()
            self._save(simulation)  # before all other files, which then belong to this run
            self._outputs.open(simulation, {}, simulation.currentStep)
            return
        self._last.check_same_run(self._identity, self._file)
        if self.resuming:
            self._last.check_cut_files(self.folder)
            _load(simulation, self._last)
        elif simulation.currentStep != self._last.step:
            raise ValueError(
                f"the Simulation is at step {simulation.currentStep}, but the run is at step {self._last.step}: resume "
                "the run (resume=True or --resume), and move the Simulation only with advance()"
            )
        self.resuming = False
        self._outputs.open(simulation, self._last.files, self._last.first)

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
        """Flush all files to disk, then write a checkpoint with their lengths."""
        integrator = simulation.integrator
        own = isinstance(integrator, ExactRigidBodyIntegrator)
        present = Checkpoint(
            step=simulation.currentStep,
            first=self._last.first if self._last else simulation.currentStep,
            wall=self.wall,
            timings=asdict(integrator.timings) if own else {},
            files=self._outputs.sync(),
            identity=self._identity,
            state=simulation.context.createCheckpoint(),
        )
        checkpoint.write(self._file, present)
        self._last = present

    def _explain(self, error: OSError) -> NoReturn:
        step = self._last.step if self._last else 0
        self.resuming = self._last is not None
        raise OSError(
            f"{error.strerror or error} (writing to {self.folder}). The run is safe up to step {step}: correct the "
            f"cause and {_RESUME}"
        ) from error


def _load(simulation: Any, last: Checkpoint) -> None:
    integrator = simulation.integrator
    if isinstance(integrator, ExactRigidBodyIntegrator):
        integrator.degreesOfFreedom()  # on a device, this call creates the variables that the checkpoint contains
    simulation.context.loadCheckpoint(last.state)
    for name, value in last.timings.items():
        setattr(integrator.timings, name, value)
