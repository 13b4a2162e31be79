"""Flexible molecules in a program: their tables, their state on the device, and the launches of a segment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.engines.device.flexible import constraints, tables
from openmm_exactrb.engines.device.flexible.blocks import Blocks, Group, blocks_of
from openmm_exactrb.engines.device.flexible.inner import InnerSteps, Moves, moves_of, up_to_drifts
from openmm_exactrb.engines.device.library import Device
from openmm_exactrb.engines.device.program import Launch, Operation, Program, Source, copy
from openmm_exactrb.engines.device.segments import Segment, Table
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.moves import Op
from openmm_exactrb.multiple_time_steps.compiled_forces import Terms

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Threads of a block of atoms.
THREADS = 64
# Bits of what a launch does besides its moves, as in kernels/layout.cl.
_MOVES, _PLACES, _PROJECTS, _SHOWS = 1, 2, 4, 8
_CONTEXT = ("posq", "posqCorrection", "velm", "force", "places", "box")
_ATOMS = ("atoms", "bodies", "inverse")
_TABLES = ("blocks", "block_atoms", "clusters", "lengths", "ends", "room", "members", "constants", "patches")


@dataclass(frozen=True)
class Molecules:
    """What flexible molecules consist of.

    Attributes
    ----------
    groups : sequence of Group
        Their clusters, single atoms and atoms without mass included.
    masses : (n_particles,) array
        Of all particles of the System.
    body_of : (n_particles,) array
        The body of each particle, among all; -1 for none.
    terms : Terms
        Their fast forces, of particles of the System.
    inner : InnerSteps or None
        None without fast forces.
    """

    groups: Sequence[Group]
    masses: Array
    body_of: Indices
    terms: Terms
    inner: InnerSteps | None


class FlexiblePart:
    """The part of flexible molecules in a program, with fast forces in single or double `precision`."""

    def __init__(self, molecules: Molecules, demands: Any, precision: type[np.floating[Any]] = np.float64) -> None:
        self._inner, self._demands = molecules.inner, demands
        self.blocks = blocks_of(molecules.groups, tables.particles(molecules.terms), len(molecules.masses))
        self._precision, self._masses, self._body_of = precision, molecules.masses, molecules.body_of
        self._of_clusters, of_clusters = constraints.arrays(self.blocks)
        self._of_terms, of_terms = self._terms(molecules.terms)
        self.n = len(self.blocks.particles)
        self.columns = self._body_of[self.blocks.particles]
        self._open = of_terms["PLACES_IN_ALL"] > self.n
        self._source = self._text(of_clusters | of_terms)
        self._mass = self._masses[self.blocks.particles]

    def _terms(self, terms: Terms) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        return tables.arrays(terms, self.blocks, self._precision)

    def _text(self, constants: dict[str, Any]) -> Source:
        demands = self._demands
        constants |= {"FINE": "float" if self._precision is np.float32 else "double", "STILL": 1e-9}
        constants |= {"MEMORY": demands.memory[0], "PER_STEP": demands.memory[1]}
        constants |= {"SCALES": 1} if demands.scales else {}
        files = ("random.cl", "context.cl", "layout.cl", *constraints.files(self.blocks), "bonded.cl", "inner.cl")
        return Source((*files, "flexible_updates.cl"), tuple(constants.items()))

    # -- declarations and launches ---------------------------------------------------------------------------------

    def declare(self, to: Program) -> None:
        """Declare tables, the state, and what is remembered."""
        for name, values in self.tables().items():
            to.array(name, values.size, element=values.itemsize)
        for name in ("x", "v", *(("shown_x", "shown_v") if self._demands.copied else ())):
            to.array(f"flexible_{name}", 3 * self.n, saved=True)
        for name in ("y", "z"):
            to.array(f"flexible_{name}", 3 * self.n * self._open)
        to.array("flexible_memory", 3 * self.n * self._demands.memory[0], saved=True)

    def launches(self, segment: Segment, table: Table) -> list[Operation]:
        """Return the launches of a segment: one, or one for each drift if blocks have terms in common."""
        moves = moves_of(segment, self._inner)
        x, v = (f"flexible_{'shown_' * (segment.copied and self._demands.copied)}{name}" for name in "xv")
        parts = up_to_drifts(moves) if self._open else [moves]
        drifts = [part for part in parts if self._moves(part)]
        made: list[Operation] = []
        here = x
        for number, part in enumerate(parts):
            last = number == len(parts) - 1
            there = here if not (self._open and self._moves(part)) else self._next(here, x, part is drifts[-1])
            what = _MOVES * self._moves(part) | _PLACES * (bool(drifts) and part is drifts[-1])
            what |= (_PROJECTS | _SHOWS) * (segment.shows and last)
            made.append(self._launch(table.rows(part), what, (here, there, v)))
            here = there
        if here != x:
            made.append(copy(here, x))
        return made

    @staticmethod
    def _moves(part: Moves) -> bool:
        return any(move.op == Op.DRIFT for move in part)

    @staticmethod
    def _next(here: str, x: str, last: bool) -> str:
        """Return the array for positions behind a drift from those in another one: in the end, x if that is not it."""
        if last and here != x:
            return x
        return "flexible_z" if here == "flexible_y" else "flexible_y"

    def _launch(self, rows: tuple[int, int], what: int, state: tuple[str, ...]) -> Launch:
        arguments = (
            *_CONTEXT,
            *state,
            *(f"flexible_{name}" for name in ("memory", *_ATOMS, *_TABLES)),
            *(Table.MOVES, Table.NUMBERS, "factors", *rows, what, "#step", "$key", "$turn"),
        )
        return Launch(self._source, "inner_steps", THREADS * len(self.blocks), arguments, THREADS)

    def copies(self) -> list[Operation]:
        """Return what makes the shown molecules copies of those of the inner coordinates."""
        return [copy(f"flexible_{name}", f"flexible_shown_{name}") for name in "xv"]

    def updates(self, moved: bool) -> list[Operation]:
        """Return what reads velocities that were changed, or positions."""
        if moved:
            arguments: tuple[str, ...] = ("posq", "posqCorrection", "places", "box", "flexible_atoms", "flexible_x")
            return [Launch(self._source, "flexible_moved", self.n, arguments)]
        return [Launch(self._source, "flexible_pushed", self.n, ("velm", "places", "flexible_atoms", "flexible_v"))]

    # -- values ------------------------------------------------------------------------------------------------------

    def tables(self) -> dict[str, NDArray[Any]]:
        """Return what does not change, by the names of arrays."""
        of_atoms = {
            "atoms": self.blocks.particles.astype(np.int32),
            "bodies": self.columns.astype(np.int32),
            "inverse": np.divide(1.0, self._mass, out=np.zeros(self.n), where=self._mass > 0.0),
        }
        return {f"flexible_{name}": values for name, values in (of_atoms | self._of_clusters | self._of_terms).items()}

    def write(self, device: Device, state: BodyState, particles: Array, copied: bool = False) -> None:
        """Write the state of all bodies to the device, and the positions of particles (n_particles, 3) without mass."""
        massive = self._mass > 0.0
        x, v = particles[self.blocks.particles], np.zeros((self.n, 3))
        x[massive] = state.R[:, self.columns[massive]].T
        v[massive] = state.P[:, self.columns[massive]].T / self._mass[massive, None]
        for name, values in zip("xv", (x, v), strict=True):
            device.upload(self._named(name, copied), values)

    def read(self, device: Device, out: BodyState, copied: bool = False) -> None:
        """Read the state of these bodies into that of all."""
        massive = self._mass > 0.0
        x, v = (device.download(self._named(name, copied), np.empty((self.n, 3)))[massive] for name in "xv")
        out.R[:, self.columns[massive]] = x.T
        out.P[:, self.columns[massive]] = (v * self._mass[massive, None]).T

    def _named(self, name: str, copied: bool) -> str:
        return f"flexible_{'shown_' if copied and self._demands.copied else ''}{name}"

    def change(self, device: Device, terms: Terms) -> None:
        """Write other numbers of the same terms."""
        arrays, _ = self._terms(terms)
        for name in ("constants", "patches"):
            device.upload(f"flexible_{name}", arrays[name])
