"""Programs for the integrator of program_integrator.cpp: a typed description that is written as text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

#: The folder of the text of kernels.
KERNELS = Path(__file__).parent / "kernels"


@dataclass(frozen=True)
class Array:
    """An array on the device; `saved` arrays belong to checkpoints, and are restored if a call fails."""

    name: str
    size: int
    element: int = 8
    saved: bool = False


@dataclass(frozen=True)
class Source:
    """Kernel text in OpenMM's common dialect, compiled as one program.

    Parameters
    ----------
    pieces : tuple of str
        Names of files in the folder `kernels` (NAME.cl), or texts, in order.
    defines : tuple of (str, object)
        Definitions that precede the pieces.
    """

    pieces: tuple[str, ...]
    defines: tuple[tuple[str, object], ...] = ()

    @property
    def text(self) -> str:
        """The text that is compiled."""
        defines = [f"#define {name} {value}\n" for name, value in self.defines]
        return "\n".join(["".join(defines), *map(_piece, self.pieces)])


def _piece(piece: str) -> str:
    return (KERNELS / piece).read_text(encoding="utf-8") if piece.endswith(".cl") else piece


@dataclass(frozen=True)
class Launch:
    """A kernel with its arguments.

    These are "posq", "posqCorrection", "velm", "force", "places" (int4 of each atom: its slot, and by how many vectors
    of the box it was moved), "box" (nine numbers; zero without one), the names of arrays, "$name" for a scalar, "$h"
    for the step size, "#step" for the number of steps before (long long), and whole numbers (int).
    """

    source: Source
    function: str
    threads: int
    arguments: tuple[str | int, ...]
    block: int = -1

    def __str__(self) -> str:
        """Return the text that follows the name in the line of the kernel."""
        return " ".join(map(str, (self.function, self.threads, self.block, *self.arguments)))


def forces(groups: int) -> str:
    """Return the operation that evaluates forces of groups (bits; -1: all active) at the present positions."""
    return f"forces {groups if groups < 1 << 31 else groups - (1 << 32)}"


def clock(part: float) -> str:
    """Return the operation that sets the time to that of a fraction of the step."""
    return f"clock {part!r}"


def add(scalar: str, value: float) -> str:
    """Return the operation that adds to a scalar."""
    return f"add {scalar} {value!r}"


def copy(array: str, to: str) -> str:
    """Return the operation that copies an array to another of the same size."""
    return f"copy {array} {to}"


#: Operations: OpenMM computes virtual sites; reorders atoms, if it is time; and a step is complete.
SITES, REORDER, STEP = "sites", "reorder", "step"

# Scalars of the integrator.
_COUNTS = ("interval", "removal", "calls")

#: A launch, or an operation as a line.
Operation = Launch | str


@dataclass
class Program:
    """Arrays, scalars and sequences of operations.

    All scalars are saved. The integrator reads "interval" and "removal", the numbers of steps between actions of
    barostats or thermostats of the System, and between removals of motion; 0 is never. It counts steps since OpenMM
    last updated the Context in "calls".
    """

    arrays: dict[str, Array] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=lambda: dict.fromkeys(_COUNTS, 0.0))
    sequences: dict[str, list[Operation]] = field(default_factory=dict)

    def array(self, name: str, size: int, element: int = 8, saved: bool = False) -> str:
        """Declare an array with elements of a given size in bytes (at least one element), and return its name."""
        self.arrays[name] = Array(name, max(size, 1), element, saved)
        return name

    def sequence(self, name: str, operations: Iterable[Operation]) -> None:
        """Define a sequence."""
        self.sequences[name] = list(operations)

    @property
    def launches(self) -> list[Launch]:
        """All distinct launches, grouped by source."""
        every = (o for operations in self.sequences.values() for o in operations if isinstance(o, Launch))
        by_source: dict[Source, dict[Launch, None]] = {}
        for launch in every:
            by_source.setdefault(launch.source, {})[launch] = None
        return [launch for some in by_source.values() for launch in some]

    @property
    def text(self) -> str:
        """The text that program_integrator.cpp reads."""
        lines = [
            f"array {a.name} {a.element} {a.size} {'saved' if a.saved else 'scratch'}" for a in self.arrays.values()
        ]
        lines += [f"scalar {name} {value!r}" for name, value in self.scalars.items()]
        names: dict[Launch, str] = {}
        source = None
        for launch in self.launches:
            if launch.source != source:
                source = launch.source
                text = source.text
                lines.append(f"source {len(text.encode())}\n{text}")
            names[launch] = f"k{len(names)}"
            lines.append(f"kernel {names[launch]} {launch}")
        for name, operations in self.sequences.items():
            lines.append(f"sequence {name}")
            lines += [f"run {names[o]}" if isinstance(o, Launch) else o for o in operations]
        return "\n".join(lines) + "\n"
