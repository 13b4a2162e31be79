"""Programs for the integrator of program_integrator.cpp: a typed description that becomes its lines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

#: The folder of the text of kernels.
KERNELS = Path(__file__).parent / "kernels"


@dataclass(frozen=True)
class Array:
    """An array on the device; what is `saved` belongs to checkpoints, and is kept in case a call fails."""

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
        Names of files in the folder `kernels` (NAME.cl), or text, in their order.
    defines : tuple of (str, object)
        Written in front of them.
    """

    pieces: tuple[str, ...]
    defines: tuple[tuple[str, object], ...] = ()

    @property
    def text(self) -> str:
        """The text as it is compiled."""
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
        """Return what the line of its kernel has behind the name."""
        return " ".join(map(str, (self.function, self.threads, self.block, *self.arguments)))


def forces(groups: int) -> str:
    """Return the operation that evaluates forces of groups (bits, -1: all that act) at the present positions."""
    return f"forces {groups if groups < 1 << 31 else groups - (1 << 32)}"


def clock(part: float) -> str:
    """Return the operation that sets the time to that of a part of the step."""
    return f"clock {part!r}"


def add(scalar: str, value: float) -> str:
    """Return the operation that adds to a scalar."""
    return f"add {scalar} {value!r}"


def copy(array: str, to: str) -> str:
    """Return the operation that copies an array to another one of its size."""
    return f"copy {array} {to}"


#: Operations: OpenMM computes virtual sites; reorders atoms, if it is time; and a step is complete.
SITES, REORDER, STEP = "sites", "reorder", "step"

# Scalars of the integrator.
_COUNTS = ("interval", "waiting", "removal", "calls")

#: A launch, or an operation as a line.
Operation = Launch | str


@dataclass
class Program:
    """Arrays, scalars and sequences of operations.

    All scalars are saved. The integrator reads "interval", the number of steps after which barostats or thermostats of
    the System act, and "removal", of which a step's number is a multiple where its removers do; 0 is never. It counts
    steps since then in "waiting", and since OpenMM last updated the Context in "calls".
    """

    arrays: dict[str, Array] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=lambda: dict.fromkeys(_COUNTS, 0.0))
    sequences: dict[str, list[Operation]] = field(default_factory=dict)

    def array(self, name: str, size: int, element: int = 8, saved: bool = False) -> str:
        """Declare an array of elements of so many bytes (at least one), and return its name."""
        self.arrays[name] = Array(name, max(size, 1), element, saved)
        return name

    def sequence(self, name: str, operations: Iterable[Operation]) -> None:
        """Define a sequence."""
        self.sequences[name] = list(operations)

    @property
    def launches(self) -> list[Launch]:
        """All launches, each once, those of one source together."""
        every = (o for operations in self.sequences.values() for o in operations if isinstance(o, Launch))
        by_source: dict[Source, dict[Launch, None]] = {}
        for launch in every:
            by_source.setdefault(launch.source, {})[launch] = None
        return [launch for some in by_source.values() for launch in some]

    @property
    def text(self) -> str:
        """The lines, as program_integrator.cpp reads them."""
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
