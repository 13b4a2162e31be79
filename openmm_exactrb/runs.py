"""Runs that survive accidents: checkpoints, and output files that are cut back to them before a run goes on."""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from types import FrameType
from typing import IO, Any, NamedTuple, NoReturn

import openmm
from openmm import app, unit

from openmm_exactrb import kernels
from openmm_exactrb.integrator import ExactRigidBodyIntegrator, NonFiniteError

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

#: Names of the files that a run always writes.
CHECKPOINT, TOPOLOGY = "checkpoint", "topology.pdb"

_MAGIC, _FORMAT = b"openmm-exactrb checkpoint", b"2"
# Steps between two looks at signals and the clock: as many as Simulation.step takes at once.
_CHUNK = 10
# Bytes at the beginning of a file that may change while it grows: a DCD file counts its frames there.
_HEAD = 128
# What an integrator of all forces says: 32 bits.
_EVERY_GROUP = -1
_OPTIONS = ("out", "overwrite", "resume", "checkpoint")
_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


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
        Seconds between two checkpoints.
    settings : mapping, optional
        What else must be the same for a run to be resumed, beside System, integrator, platform and reporters.

    Raises
    ------
    FileExistsError
        If the folder holds an earlier run that is neither to be resumed nor to be overwritten.
    ValueError
        If the checkpoint is damaged or of another version, or `every` is negative or no number.

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
    ) -> None:
        if not every >= 0.0:
            raise ValueError(f"the time between checkpoints must be a number of seconds of at least 0, not {every}")
        self.folder = Path(folder)
        self._may_replace = overwrite
        self._every = every
        self._settings = {name: str(value) for name, value in (settings or {}).items()}
        self._outputs: dict[str, tuple[Callable[..., Any], int]] = {}
        self._reporters: dict[str, Any] = {}
        self._last = _read(self._file) if resume and self._file.exists() else None
        self.resuming = self._last is not None
        self.wall = self._last.wall if self._last else 0.0
        for name in (CHECKPOINT, TOPOLOGY):
            self.path(name)

    @staticmethod
    def add_options(parser: argparse.ArgumentParser, folder: str = "out") -> None:
        """Give a command line the options --out, --overwrite, --resume and --checkpoint."""
        add = parser.add_argument
        add("--out", type=Path, default=Path(folder), metavar="DIR", help="output folder (%(default)s)")
        add("--overwrite", action="store_true", help="replace the files of an earlier run")
        add("--resume", action="store_true", help="go on from the last checkpoint of the same command")
        add("--checkpoint", type=float, default=60.0, metavar="S", help="seconds between checkpoints (%(default)s)")

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
        kept = {name: value for name, value in vars(args).items() if name not in {*_OPTIONS, *free}}
        return cls(
            args.out / subfolder,
            resume=args.resume,
            overwrite=args.overwrite,
            every=args.checkpoint,
            settings=kept | dict(settings or {}),
        )

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
                f"{file} is of an earlier run: choose another folder, add --resume where there is a checkpoint to go "
                "on from, or add --overwrite"
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
        """
        self.path(name)
        self._outputs[name] = reporter, interval

    def advance(self, simulation: Any, until: int, progress: Callable[[int], object] | None = None) -> None:
        """Bring a Simulation to a step, from its start or from the checkpoint.

        On SIGINT (Ctrl-C), SIGTERM and SIGHUP it finishes the steps under way, saves a checkpoint, says how to go on
        and raises SystemExit with the usual status, 128 + the number of the signal. A second signal acts at once.

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
            it says: nothing was changed then.
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
        tell = progress or (lambda steps: None)
        identity = self._identity(simulation)
        self.folder.mkdir(parents=True, exist_ok=True)
        with _only_process(self.folder), _Signals() as signals:
            try:
                self._begin(simulation, identity)
                tell(simulation.currentStep)
                self._step(simulation, until, tell, signals)
                self._save(simulation)
            except NonFiniteError as error:
                self._save(simulation)
                raise NonFiniteError(f"{error}. All before it is on disk: {self._files()}") from error
            except OSError as error:
                self._explain(error)
            finally:
                self._close(simulation)
        if signals.caught:
            self._leave(simulation.currentStep, until, signals.caught)

    # -- the parts of advance ---------------------------------------------------------------------------------------

    @property
    def _file(self) -> Path:
        return self.folder / CHECKPOINT

    def _begin(self, simulation: Any, identity: dict[str, str]) -> None:
        """Load the checkpoint and cut the files back to it, or save the first one and begin the files."""
        if self._last is None:
            self._last = _Checkpoint(0, 0.0, {}, {}, identity, b"")
            self._save(simulation)  # before there is a file: what is found beside a checkpoint is of its run
        elif self.resuming:
            self._check(self._last, identity)
            simulation.context.loadCheckpoint(self._last.state)
            _timings(simulation.integrator).update(self._last.timings)
        self.resuming = False
        lengths = {name: length for name, (length, _) in self._last.files.items()}
        for name, (length, head) in self._last.files.items():
            if length:
                _cut(self.folder / name, length, bytes.fromhex(head))
        for name, (reporter, interval) in self._outputs.items():
            append = lengths.get(name, 0) > 0
            self._reporters[name] = reporter(str(self.folder / name), interval, append=append)
        if not any(lengths.values()):
            self._report_start(simulation)
        simulation.reporters.extend(self._reporters.values())

    def _report_start(self, simulation: Any) -> None:
        state = simulation.context.getState(
            positions=True,
            velocities=True,
            energy=True,
            groups=simulation.integrator.getIntegrationForceGroups(),
            enforcePeriodicBox=simulation.system.usesPeriodicBoundaryConditions(),
        )
        with written_whole(self.folder / TOPOLOGY) as file:
            app.PDBFile.writeFile(simulation.topology, state.getPositions(), file)
        for reporter in self._reporters.values():
            reporter.report(simulation, state)

    def _step(self, simulation: Any, until: int, tell: Callable[[int], object], signals: _Signals) -> None:
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
        assert self._last is not None
        files = {}
        for name, reporter in self._reporters.items():
            with contextlib.suppress(AttributeError):  # reporters of OpenMM and ours call their file so
                reporter._out.flush()
            files[name] = _secure(self.folder / name)
        checkpoint = self._last._replace(
            step=simulation.currentStep,
            wall=self.wall,
            timings=dict(_timings(simulation.integrator)),
            files=files,
            state=simulation.context.createCheckpoint(),
        )
        _write(self._file, checkpoint)
        self._last = checkpoint

    def _close(self, simulation: Any) -> None:
        for reporter in self._reporters.values():
            if reporter in simulation.reporters:
                simulation.reporters.remove(reporter)
            with contextlib.suppress(OSError, AttributeError):  # what a full disk did not take is not needed
                reporter._out.close()
        self._reporters.clear()

    def _identity(self, simulation: Any) -> dict[str, str]:
        """Return what must be the same for a run to be resumed, by name."""
        integrator, system = simulation.integrator, simulation.system
        step_size = integrator.getStepSize().value_in_unit(unit.picosecond)
        identity = {
            "openmm": openmm.__version__,
            "openmm-exactrb": _version(),
            "kernels": "compiled" if kernels.available() else "numpy",  # they round differently
            "platform": simulation.context.getPlatform().getName(),
            "System": f"{system.getNumParticles()} particles, {_hash(openmm.XmlSerializer.serialize(system).encode())}",
            "integrator": f"{type(integrator).__name__}, step {step_size!r} ps",
        }
        if (groups := integrator.getIntegrationForceGroups()) != _EVERY_GROUP:
            identity["integrator"] += f", force groups {groups & 0xFFFFFFFF:#b}"
        if isinstance(integrator, ExactRigidBodyIntegrator):
            identity["integrator"] += f", {integrator.getScheme().name}, {integrator.getRotor()}"
            if integrator.hasNamedBodies():
                # This fixes their shape to that of the start, before a checkpoint is loaded.
                bodies, _ = integrator.bodyState()
                shapes = b"".join(kind.particles.tobytes() + kind.sites.tobytes() for kind in bodies.kinds)
                identity["bodies"] = f"{len(bodies)}, {_hash(shapes)}"
        for name, (reporter, interval) in self._outputs.items():
            kind = getattr(reporter, "func", reporter)
            identity[name] = f"{getattr(kind, '__name__', kind)} every {interval} steps"
        return identity | {f"setting {name}": value for name, value in self._settings.items()}

    def _check(self, last: _Checkpoint, identity: Mapping[str, str]) -> None:
        """Refuse a checkpoint of another run, or one whose files are gone, before anything is changed."""
        for name in {**last.identity, **identity}:
            there, here = last.identity.get(name, "not there"), identity.get(name, "not there")
            if there != here:
                raise ValueError(f"{self._file} is of another run: {name} is {there} in it, but {here} now")
        for name, (length, _) in last.files.items():
            file = self.folder / name
            found = file.stat().st_size if file.exists() else 0
            if found < length:
                raise ValueError(f"{file} has {found} bytes, but had {length} at the checkpoint: it was changed since")

    def _files(self) -> str:
        return f"{self.folder}: " + ", ".join([*self._outputs, TOPOLOGY, CHECKPOINT])

    def _explain(self, error: OSError) -> NoReturn:
        step = self._last.step if self._last else 0
        self.resuming = True
        raise OSError(
            f"{error.strerror or error} (writing to {self.folder}). The run is safe up to step {step}: "
            "put it right and go on with the same command and --resume"
        ) from error

    def _leave(self, step: int, until: int, number: int) -> NoReturn:
        name = signal.Signals(number).name
        print(f"\n{name}: stopped at step {step} of {until}. Go on with the same command and --resume", file=sys.stderr)
        raise SystemExit(128 + number)


class _Checkpoint(NamedTuple):
    """What a checkpoint file holds."""

    step: int
    wall: float
    timings: dict[str, float]
    files: dict[str, tuple[int, str]]  # length, and the first bytes in hexadecimal
    identity: dict[str, str]
    state: bytes  # OpenMM's


def _write(file: Path, checkpoint: _Checkpoint) -> None:
    """Write a checkpoint: a line with format and checksum, a line of JSON, the state of OpenMM."""
    about = json.dumps({name: value for name, value in checkpoint._asdict().items() if name != "state"})
    body = about.encode() + b"\n" + checkpoint.state
    with written_whole(file, "wb") as out:
        out.write(b" ".join([_MAGIC, _FORMAT, hashlib.sha256(body).hexdigest().encode()]) + b"\n" + body)


def _read(file: Path) -> _Checkpoint:
    """Read a checkpoint, if it is whole."""
    head, _, body = file.read_bytes().partition(b"\n")
    words = head.rsplit(b" ", 2)
    if len(words) != 3 or words[0] != _MAGIC:
        raise ValueError(f"{file} is no checkpoint, or a damaged one: begin anew in another folder or with --overwrite")
    if words[1] != _FORMAT:
        raise ValueError(f"{file} was written by another version of openmm-exactrb, in format {words[1].decode()}")
    if words[2] != hashlib.sha256(body).hexdigest().encode():
        raise ValueError(f"{file} is truncated or damaged: begin anew in another folder or with --overwrite")
    about, _, state = body.partition(b"\n")
    return _Checkpoint(**json.loads(about), state=state)


@contextlib.contextmanager
def written_whole(file: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[Any]]:
    """Open a file that appears, or replaces another, only when all of it is on disk.

    Parameters
    ----------
    file : str or path
    mode : str, optional
        "w" or "wb".

    Yields
    ------
    file object

    Raises
    ------
    OSError
        If it cannot be written; what was there before is there still.
    """
    path = Path(file)
    part = path.with_name(path.name + ".part")
    try:
        with part.open(mode) as out:
            yield out
            out.flush()
            os.fsync(out.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    _sync(path.parent)


def _secure(file: Path) -> tuple[int, str]:
    """Bring a file to the disk; return its length and its first bytes."""
    _sync(file)
    with file.open("rb") as content:
        return file.stat().st_size, content.read(_HEAD).hex()


def _sync(path: Path) -> None:
    if path.is_dir() and os.name != "posix":
        return
    descriptor = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _cut(file: Path, length: int, head: bytes) -> None:
    """Bring a file back to the length and the first bytes that it had."""
    with file.open("r+b") as content:
        content.write(head)
        content.truncate(length)


@contextlib.contextmanager
def _only_process(folder: Path) -> Iterator[None]:
    """Hold a lock on a folder, which the system drops with the process."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        _lock(descriptor, folder)
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, folder: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise BlockingIOError(f"another process is at work in {folder}") from None
    except OSError:  # some network file systems have no locks
        return


class _Signals:
    """Note the first signal that asks the process to end, instead of ending it."""

    def __init__(self) -> None:
        self.caught = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Signals:
        if threading.current_thread() is threading.main_thread():  # no other one may set handlers
            for number in _SIGNALS:
                if signal.getsignal(number) != signal.SIG_IGN:  # as nohup sets it
                    self._before[number] = signal.signal(number, self._catch)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def _catch(self, number: int, frame: FrameType | None) -> None:
        self.caught = number
        self.__exit__()


def _timings(integrator: Any) -> dict[str, float]:
    """Return the timings of the integrator themselves; empty for another one."""
    return vars(integrator.timings) if isinstance(integrator, ExactRigidBodyIntegrator) else {}


def _hash(content: bytes) -> str:
    return f"hash {hashlib.sha256(content).hexdigest()[:16]}"


def _version() -> str:
    try:
        return metadata.version("openmm-exactrb")
    except metadata.PackageNotFoundError:
        return "not installed"
