"""The files that grow while a run goes on, each with its reporter."""

from __future__ import annotations

import contextlib
import inspect
import io
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from openmm import app

from openmm_exactrb.files import sync, written_whole
from openmm_exactrb.runs.text import text_of
from openmm_exactrb.runs.trajectories import begin_with_the_start, refuse_lost_frames

#: Name of the file with the start, which is not one of those that grow.
TOPOLOGY = "topology.pdb"

# Bytes at the beginning of a file that may change while it grows: a DCD file counts its frames there.
_HEAD = 128
# What a tuple of OpenMM's older reporters asks for, in its order.
_ASKED = ("positions", "velocities", "forces", "energy")
_SHARED = (sys.stdout, sys.stderr)


class Outputs:
    """The files of a run that grow, each with its reporter.

    Parameters
    ----------
    folder : path
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._makers: dict[str, tuple[Callable[..., Any], int]] = {}
        self._reporters: dict[str, Any] = {}  # while they are open

    @property
    def names(self) -> tuple[str, ...]:
        """The files."""
        return tuple(self._makers)

    def add(self, maker: Callable[..., Any], name: str, interval: int) -> None:
        """Add a file; see `Run.add_reporter`."""
        if not callable(maker):
            raise ValueError(f"give what makes the reporter, such as openmm.app.DCDReporter, not {maker!r}")
        if name in self._makers:
            raise ValueError(f"there is a reporter for {name} already: give this one another file")
        if not _appends(maker):
            raise ValueError(
                f"{_name_of(maker)} cannot go on with a file, since it takes no append=: choose a reporter that does, "
                "such as DCDReporter, XTCReporter or StateDataReporter, or append it to simulation.reporters yourself"
            )
        self._makers[name] = maker, interval

    def kinds(self) -> dict[str, str]:
        """Return by file what is reported how often, as text."""
        return {name: f"{_kind_of(maker)} every {n} steps" for name, (maker, n) in self._makers.items()}

    def open(self, simulation: Any, files: Mapping[str, tuple[int, str]], first: int) -> None:
        """Cut the files back to what they were and have the Simulation report to them; report the start to new ones.

        Parameters
        ----------
        simulation : openmm.app.Simulation
        files : mapping
            Length and first bytes, in hexadecimal, that each file had; what is not in it is new.
        first : int
            Step at which the run began.

        Raises
        ------
        ValueError
            If a reporter does not fit the Simulation.
        """
        for name, (length, head) in files.items():
            if length:
                _cut(self._folder / name, length, bytes.fromhex(head))
        fresh = []
        for name, (maker, interval) in self._makers.items():
            append = files.get(name, (0, ""))[0] > 0
            (self._folder / name).parent.mkdir(parents=True, exist_ok=True)
            reporter = self._reporters[name] = maker(str(self._folder / name), interval, append=append)
            begin = first if append else simulation.currentStep
            begin_with_the_start(reporter, simulation, begin - begin % interval, interval, append)
            wanted = _wanted(reporter.describeNextReport(simulation))  # one that does not fit says so here
            fresh += [] if append else [(reporter, *wanted)]
        if simulation.currentStep == first and not files:
            self._write_topology(simulation)
        for reporter, asked, wrapped in fresh:
            reporter.report(simulation, _state(simulation, asked, wrapped))
        simulation.reporters.extend(self._reporters.values())

    def secured(self) -> dict[str, tuple[int, str]]:
        """Write the files through to the disk; return their lengths and first bytes.

        Raises
        ------
        OSError
            If a file does not have what was written to it.
        """
        for name, reporter in self._reporters.items():
            for file in _files_of(reporter):
                file.flush()
            refuse_lost_frames(reporter, self._folder / name)
        return {name: _secure(self._folder / name) for name in self._reporters}

    def remove(self) -> None:
        """Delete the files."""
        for name in (*self._makers, TOPOLOGY):
            (self._folder / name).unlink(missing_ok=True)

    def close(self, simulation: Any) -> None:
        """Take the reporters from the Simulation and close their files."""
        for reporter in self._reporters.values():
            if reporter in simulation.reporters:
                simulation.reporters.remove(reporter)
            for file in _files_of(reporter):
                with contextlib.suppress(OSError):  # what a full disk did not take is not needed
                    file.close()
        self._reporters.clear()

    def _write_topology(self, simulation: Any) -> None:
        if simulation.topology.getNumAtoms() != simulation.system.getNumParticles():
            return  # OpenMM runs a System without its Topology
        wrapped = simulation.system.usesPeriodicBoundaryConditions()
        positions = simulation.context.getState(positions=True, enforcePeriodicBox=wrapped).getPositions()
        with written_whole(self._folder / TOPOLOGY) as file:
            app.PDBFile.writeFile(simulation.topology, positions, file)


def _name_of(maker: Callable[..., Any]) -> str:
    """Return the name of the class, or function, that makes a reporter."""
    kind = getattr(maker, "func", maker)
    return str(getattr(kind, "__name__", kind))


def _kind_of(maker: Callable[..., Any]) -> str:
    """Return the name of what makes a reporter, with the options that a `functools.partial` gives it."""
    options = [text_of(value) for value in getattr(maker, "args", ())]
    options += [f"{name}={text_of(value)}" for name, value in sorted(getattr(maker, "keywords", {}).items())]
    return _name_of(maker) + (f"({', '.join(options)})" if options else "")


def _appends(maker: Callable[..., Any]) -> bool:
    """Tell whether what makes a reporter takes append=."""
    parameters = inspect.signature(maker).parameters
    return "append" in parameters or any(p.kind is p.VAR_KEYWORD for p in parameters.values())


def _wanted(next_report: Any) -> tuple[list[str], bool | None]:
    """Return what a reporter asks a State for, and whether molecules are to be wrapped into the box: None for both."""
    if isinstance(next_report, dict):
        return list(next_report.get("include", ())), next_report.get("periodic")
    asked = [name for name, wanted in zip(_ASKED, next_report[1:5], strict=False) if wanted]
    return asked, next_report[5] if len(next_report) > 5 else None


def _state(simulation: Any, asked: list[str], wrapped: bool | None) -> Any:
    """Return a State for a reporter, as Simulation does."""
    if wrapped is None:
        wrapped = simulation.system.usesPeriodicBoundaryConditions()
    groups = simulation.integrator.getIntegrationForceGroups()
    return simulation.context.getState(
        groups=groups, enforcePeriodicBox=wrapped, parameters=True, **dict.fromkeys(asked, True)
    )


def _files_of(reporter: Any) -> Iterator[Any]:
    """Yield the files that a reporter has open: reporters have no common way to flush and close them."""
    for value in vars(reporter).values():
        if isinstance(value, io.IOBase) and value not in _SHARED and not value.closed:
            yield value


def _secure(file: Path) -> tuple[int, str]:
    sync(file)
    with file.open("rb") as content:
        return file.stat().st_size, content.read(_HEAD).hex()


def _cut(file: Path, length: int, head: bytes) -> None:
    """Bring a file back to the length and the first bytes that it had."""
    with file.open("r+b") as content:
        content.write(head)
        content.truncate(length)
