"""The files that grow while a run goes on, each with its reporter."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from openmm import app

from openmm_exactrb.files import sync, written_whole

#: Name of the file with the start, which is not one of those that grow.
TOPOLOGY = "topology.pdb"

# Bytes at the beginning of a file that may change while it grows: a DCD file counts its frames there.
_HEAD = 128


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

    def add(self, maker: Callable[..., Any], name: str, interval: int) -> None:
        """Add a file; see `Run.add_reporter`."""
        if not _appends(maker):
            raise ValueError(
                f"{_name_of(maker)} cannot go on with a file, since it takes no append=: choose a reporter that does, "
                "such as DCDReporter, XTCReporter or StateDataReporter, or append it to simulation.reporters yourself"
            )
        self._makers[name] = maker, interval

    def kinds(self) -> dict[str, str]:
        """Return by file what is reported how often, as text."""
        return {name: f"{_name_of(maker)} every {n} steps" for name, (maker, n) in self._makers.items()}

    def open(self, simulation: Any, files: Mapping[str, tuple[int, str]]) -> None:
        """Cut the files back to what they were and have the Simulation report to them; report the start to new ones.

        Parameters
        ----------
        simulation : openmm.app.Simulation
        files : mapping
            Length and first bytes, in hexadecimal, that each file had; what is not in it is new.
        """
        for name, (length, head) in files.items():
            if length:
                _cut(self._folder / name, length, bytes.fromhex(head))
        for name, (maker, interval) in self._makers.items():
            append = files.get(name, (0, ""))[0] > 0
            self._reporters[name] = maker(str(self._folder / name), interval, append=append)
        for reporter in self._reporters.values():
            reporter.describeNextReport(simulation)  # one that does not fit the Simulation says so here
        if not any(length for length, _ in files.values()):
            self._report_start(simulation)
        simulation.reporters.extend(self._reporters.values())

    def secured(self) -> dict[str, tuple[int, str]]:
        """Write the files through to the disk; return their lengths and first bytes."""
        for file in map(_file_of, self._reporters.values()):
            if file is not None:
                file.flush()
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
            file = _file_of(reporter)
            with contextlib.suppress(OSError):  # what a full disk did not take is not needed
                if file is not None:
                    file.close()
        self._reporters.clear()

    def _report_start(self, simulation: Any) -> None:
        state = simulation.context.getState(
            positions=True,
            velocities=True,
            energy=True,
            groups=simulation.integrator.getIntegrationForceGroups(),
            enforcePeriodicBox=simulation.system.usesPeriodicBoundaryConditions(),
        )
        with written_whole(self._folder / TOPOLOGY) as file:
            app.PDBFile.writeFile(simulation.topology, state.getPositions(), file)
        for reporter in self._reporters.values():
            reporter.report(simulation, state)


def _name_of(maker: Callable[..., Any]) -> str:
    """Return the name of the class, or function, that makes a reporter."""
    kind = getattr(maker, "func", maker)
    return str(getattr(kind, "__name__", kind))


def _appends(maker: Callable[..., Any]) -> bool:
    """Tell whether what makes a reporter takes append=."""
    parameters = inspect.signature(maker).parameters
    return "append" in parameters or any(p.kind is p.VAR_KEYWORD for p in parameters.values())


def _file_of(reporter: Any) -> Any:
    """Return the file that a reporter writes to, or None: OpenMM's reporters, and ours, have no public way to flush."""
    return getattr(reporter, "_out", None)


def _secure(file: Path) -> tuple[int, str]:
    sync(file)
    with file.open("rb") as content:
        return file.stat().st_size, content.read(_HEAD).hex()


def _cut(file: Path, length: int, head: bytes) -> None:
    """Bring a file back to the length and the first bytes that it had."""
    with file.open("r+b") as content:
        content.write(head)
        content.truncate(length)
