"""The output files of a run, each with its reporter."""

from __future__ import annotations

import contextlib
import inspect
import io
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from openmm import app

from openmm_exactrb.runs.identity import setting_text
from openmm_exactrb.runs.trajectories import begin_with_the_start, check_lost_frames
from openmm_exactrb.support.files import sync, written_whole
from openmm_exactrb.support.messages import shown

#: Name of the file with the topology and the initial positions, which is written once.
TOPOLOGY = "topology.pdb"

# Bytes at the beginning of a file that may change while it grows: a DCD file stores its number of frames there.
_HEAD = 128


class Outputs:
    """The output files in the folder of a run, and their reporters."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._factories: dict[str, tuple[Callable[..., Any], int]] = {}
        self._reporters: dict[str, Any] = {}  # by file name, while the files are open

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the files."""
        return tuple(self._factories)

    def add(self, factory: Callable[..., Any], name: str, interval: int, options: Mapping[str, Any]) -> None:
        """Add a file; see `Run.add_reporter`."""
        if not callable(factory):
            raise ValueError(f"a reporter must be a class such as openmm.app.DCDReporter, not {shown(factory)}")
        if name in self._factories:
            raise ValueError(
                f"another reporter already writes the file {name}: choose another file name for the new reporter"
            )
        parameters = inspect.signature(factory).parameters
        if "append" not in parameters and not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
            raise ValueError(
                f"{_name_of(factory)} cannot resume a file, because this class has no argument append=: use a "
                "reporter with append=, such as DCDReporter, or append this reporter to simulation.reporters"
            )
        try:
            inspect.signature(factory).bind(name, interval, append=False, **options)
        except TypeError as error:
            raise ValueError(f"{_name_of(factory)} does not accept these options: {error}") from None
        self._factories[name] = partial(factory, **options) if options else factory, interval

    def identity(self) -> dict[str, str]:
        """Return the reporter of each file with its options and interval, as text."""
        return {
            f"file {name}": f"{_described(factory)} every {n} steps" for name, (factory, n) in self._factories.items()
        }

    def open(self, simulation: Any, files: Mapping[str, tuple[int, str]], first: int) -> None:
        """Open the files, truncated to their lengths at a checkpoint; write the initial state to new files."""
        requests = {}
        for name, (factory, interval) in self._factories.items():
            length, head = files.get(name, (0, ""))
            file, append = self._folder / name, length > 0
            if append:
                with file.open("r+b") as content:
                    content.write(bytes.fromhex(head))
                    content.truncate(length)
            file.parent.mkdir(parents=True, exist_ok=True)
            reporter = self._reporters[name] = factory(str(file), interval, append=append)
            begin_with_the_start(reporter, simulation, first - first % interval, interval, append)
            request = reporter.describeNextReport(simulation)  # raises an error for an unsuitable reporter
            if not append:
                requests[name] = request
        if simulation.currentStep == first and not files:
            self._write_topology(simulation)
        for name, request in requests.items():
            self._reporters[name].report(simulation, _state(simulation, request))
        simulation.reporters.extend(self._reporters.values())

    def sync(self) -> dict[str, tuple[int, str]]:
        """Flush the files to disk; return their lengths and their first bytes, in hexadecimal."""
        for name, reporter in self._reporters.items():
            for file in _files_of(reporter):
                file.flush()
            check_lost_frames(reporter, self._folder / name)
            sync(self._folder / name)
        return {name: _extent(self._folder / name) for name in self._reporters}

    def close(self, simulation: Any) -> None:
        """Remove the reporters from the Simulation and close their files."""
        for reporter in self._reporters.values():
            if reporter in simulation.reporters:
                simulation.reporters.remove(reporter)
            for file in _files_of(reporter):
                with contextlib.suppress(OSError):  # for example on a full disk
                    file.close()
        self._reporters.clear()

    def _write_topology(self, simulation: Any) -> None:
        if simulation.topology.getNumAtoms() != simulation.system.getNumParticles():
            return  # OpenMM does not require a matching Topology
        wrapped = simulation.system.usesPeriodicBoundaryConditions()
        positions = simulation.context.getState(positions=True, enforcePeriodicBox=wrapped).getPositions()
        with written_whole(self._folder / TOPOLOGY) as file:
            app.PDBFile.writeFile(simulation.topology, positions, file)


def _name_of(factory: Callable[..., Any]) -> str:
    """Return the name of the class or function that creates a reporter."""
    function = getattr(factory, "func", factory)
    return str(getattr(function, "__name__", function))


def _described(factory: Callable[..., Any]) -> str:
    """Return the name of a factory, with the options of a `functools.partial`."""
    options = [*getattr(factory, "args", ()), getattr(factory, "keywords", {})]
    return _name_of(factory) + (
        f" with {setting_text(options, f'the options of {_name_of(factory)}')}" if any(options) else ""
    )


def _state(simulation: Any, request: Any) -> Any:
    """Return a State with all data; positions are wrapped if the request (dict or tuple) of a reporter requires it."""
    wrapped = request.get("periodic") if isinstance(request, dict) else (*request, None)[5]
    if wrapped is None:
        wrapped = simulation.system.usesPeriodicBoundaryConditions()
    everything = dict.fromkeys(("positions", "velocities", "forces", "energy", "parameters"), True)
    groups = simulation.integrator.getIntegrationForceGroups()
    return simulation.context.getState(groups=groups, enforcePeriodicBox=wrapped, **everything)


def _files_of(reporter: Any) -> Iterator[Any]:
    """Yield the open files of a reporter; reporters have no common method to flush and close them."""
    for value in vars(reporter).values():
        if isinstance(value, io.IOBase) and value not in (sys.stdout, sys.stderr) and not value.closed:
            yield value


def _extent(file: Path) -> tuple[int, str]:
    with file.open("rb") as content:
        return file.stat().st_size, content.read(_HEAD).hex()
