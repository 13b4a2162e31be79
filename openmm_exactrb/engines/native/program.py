"""Programs for the integrator in program_integrator.cpp, described by typed objects and passed as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from openmm_exactrb.library.compilation import definitions

# The kernel texts of the package, which are next to the physics that they describe, by name.
_TEXTS = {path.name: path for path in Path(__file__).parents[2].rglob("*.cl")}


@dataclass(frozen=True)
class Array:
    """An array in the machine; `saved` arrays are stored in checkpoints, and restored if a call fails."""

    name: str
    size: int
    element: int = 8
    saved: bool = False


@dataclass(frozen=True)
class Source:
    """Kernel text in OpenMM's common dialect, compiled as one program.

    Parameters
    ----------
    name : str
        The name of the compiled kernels that the library has for processors.
    pieces : tuple of str
        Names of the package's kernel texts (NAME.cl), or source texts, in this order.
    defines : tuple of (str, object)
        Names and values of macros, which are defined before the pieces.
    """

    name: str
    pieces: tuple[str, ...]
    defines: tuple[tuple[str, object], ...] = ()

    @property
    def text(self) -> str:
        """The source that is compiled for a device: the constants of all rooms, the macros and the pieces."""
        defines = [f"#define {name} {value}\n" for name, value in self.defines]
        return "\n".join([definitions(), "".join(defines), *map(_piece, self.pieces)])

    def with_pieces_of(self, other: Source, *pieces: str) -> Source:
        """Return the source with the kernels of both, and with further pieces that need both."""
        every = dict.fromkeys((*self.pieces, *other.pieces, *pieces))
        return Source(self.name, tuple(every), tuple({**dict(self.defines), **dict(other.defines)}.items()))

    @property
    def lines(self) -> list[str]:
        """The lines of a program for a processor: the name of compiled kernels and their constants."""
        return [f"compiled {self.name} {len(self.defines)}", *(f"{name} {value}" for name, value in self.defines)]


def _piece(piece: str) -> str:
    return _TEXTS[piece].read_text(encoding="utf-8") if piece.endswith(".cl") else piece


@dataclass(frozen=True)
class Launch:
    """The launch of a kernel with its arguments.

    An argument is an integer (int) or a name. The names "posq", "posqCorrection", "velm" and "force" denote OpenMM's
    arrays. The name "places" denotes an array of int4 that contains, for each atom, its slot and the numbers of box
    vectors by which the atom was moved. The name "box" denotes the nine numbers of the box vectors, which are zero
    without a box. "$name" denotes a scalar, "$h" the step size, and "#step" the number of previous steps (long long).
    All other names denote arrays of the program.
    """

    source: Source
    function: str
    threads: int
    arguments: tuple[str | int, ...]
    block: int = -1

    def __str__(self) -> str:
        """Return the text that follows the name of the kernel in its line of the program."""
        return " ".join(map(str, (self.function, self.threads, self.block, *self.arguments)))


def forces(groups: int) -> str:
    """Return the operation that evaluates the forces of groups (bits; -1 for all active groups)."""
    return f"forces {groups if groups < 1 << 31 else groups - (1 << 32)}"


def clock(part: float) -> str:
    """Return the operation that advances the time to a fraction of the step."""
    return f"clock {part!r}"


def add(scalar: str, value: float) -> str:
    """Return the operation that adds a value to a scalar."""
    return f"add {scalar} {value!r}"


def copy(array: str, to: str) -> str:
    """Return the operation that copies an array to another array of the same size."""
    return f"copy {array} {to}"


#: Operations that let OpenMM compute virtual sites, let OpenMM reorder atoms if necessary, and complete a step.
SITES, REORDER, STEP = "sites", "reorder", "step"

# Scalars of the integrator.
_COUNTS = ("interval", "always", "removal", "calls", "held", "settings", "inner", "enough")

#: A launch, or another operation as a line of the program.
Operation = Launch | str


@dataclass
class Program:
    """A program: arrays, scalars and sequences of operations.

    All scalars are saved, like `saved` arrays. The integrator reads "interval", the number of steps between moves of a
    barostat, and "removal", the number of steps between removals of the centre-of-mass motion; 0 means never. If
    "always" is not 0, barostats or thermostats may act after every step. In "calls" the integrator counts the steps
    since OpenMM last updated the Context. "held" is 1 if the last call ended with the sequence "hold".
    "settings" identifies the settings to which the inner state of a processed scheme belongs, "inner" is the
    fingerprint of this state, or 0 without one, and "enough" is the number of steps after which its output is cheap.

    `numbers` contains the name of an array, and the names of the integrator's global variables to which its numbers are
    copied after steps. `parameters` contains the name of an array, and the names of the Context's parameters that it
    receives before steps.
    """

    arrays: dict[str, Array] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=lambda: dict.fromkeys(_COUNTS, 0.0))
    sequences: dict[str, list[Operation]] = field(default_factory=dict)
    numbers: tuple[str, Sequence[str]] = ("", ())
    parameters: tuple[str, Sequence[str]] = ("", ())

    def array(self, name: str, size: int, element: int = 8, saved: bool = False) -> str:
        """Declare an array of at least one element, with `element` bytes per element, and return its name."""
        self.arrays[name] = Array(name, max(size, 1), element, saved)
        return name

    def sequence(self, name: str, operations: Iterable[Operation]) -> None:
        """Define a sequence of operations."""
        self.sequences[name] = list(operations)

    @property
    def launches(self) -> list[Launch]:
        """All distinct launches, grouped by source."""
        every = (o for operations in self.sequences.values() for o in operations if isinstance(o, Launch))
        by_source: dict[Source, dict[Launch, None]] = {}
        for launch in every:
            by_source.setdefault(launch.source, {})[launch] = None
        return [launch for some in by_source.values() for launch in some]

    def text(self, processor: bool) -> str:
        """Return the text that program_integrator.cpp reads, for a processor or for a device."""
        lines = [
            f"array {a.name} {a.element} {a.size} {'saved' if a.saved else 'scratch'}" for a in self.arrays.values()
        ]
        lines += [f"scalar {name} {value!r}" for name, value in self.scalars.items()]
        for what, (array, names_in_order) in (("numbers", self.numbers), ("parameters", self.parameters)):
            if names_in_order:
                lines.append(" ".join((what, array, *names_in_order)))
        names: dict[Launch, str] = {}
        source = None
        for launch in self.launches:
            if launch.source != source:
                source = launch.source
                lines += source.lines if processor else [f"source {len(source.text.encode())}\n{source.text}"]
            names[launch] = f"k{len(names)}"
            lines.append(f"kernel {names[launch]} {launch}")
        for name, operations in self.sequences.items():
            lines.append(f"sequence {name}")
            lines += [f"run {names[o]}" if isinstance(o, Launch) else o for o in operations]
        return "\n".join(lines) + "\n"
