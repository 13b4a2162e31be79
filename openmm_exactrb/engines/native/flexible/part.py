"""Flexible molecules in a program: their tables, their state in the machine, and the launches of a segment."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.constraints import tables as clusters
from openmm_exactrb.engines.native.constants import MOVES_ATOMS, PLACES_ATOMS, PROJECTS, SHOWS_ATOMS
from openmm_exactrb.engines.native.flexible import expressions, tables
from openmm_exactrb.engines.native.flexible.blocks import blocks_of
from openmm_exactrb.engines.native.flexible.inner import Moves, moves_of, up_to_drifts
from openmm_exactrb.engines.native.flexible.molecules import Molecules
from openmm_exactrb.engines.native.program import Launch, Operation, Program, Source, copy
from openmm_exactrb.engines.native.rigid import BLOCK, GROUPS, STILL, SUMS, TOTALS, Demands
from openmm_exactrb.engines.native.segments import Segment, Table
from openmm_exactrb.library.library import Machine
from openmm_exactrb.mathematics.compensated import exactly, quotient, times
from openmm_exactrb.mechanics.divergence import LIGHT
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.steps.moves import Op
from openmm_exactrb.support.types import Array, Indices

#: Number of threads per block of atoms.
THREADS = 256
#: The kernel that performs inner steps.
INNER_STEPS = "inner_steps"
_CONTEXT = ("posq", "posqCorrection", "velm", "force", "places", "box")
_FORCES = ("memory", "differences", "here", "push", "seen", "exchanged", "heat")
_ATOMS = ("atoms", "bodies", "inverse")
_TABLES_OF_CLUSTERS = ("blocks", "block_atoms", "clusters", "lengths", "graphs", "room")
_TABLES_OF_TERMS = ("members", "constants", "exact", "customs", "parameters")


class Flexible(NamedTuple):
    """The flexible molecules of a Context.

    Attributes
    ----------
    molecules : Molecules
    particles : (n_particles, 3) array
        Current positions of all particles, which are used for massless particles only.
    """

    molecules: Molecules
    particles: Array


class FlexiblePart:
    """The part of a program for flexible molecules, with a prefix for array names."""

    def __init__(self, flexible: Flexible, demands: Demands, prefix: str) -> None:
        molecules, self._particles = flexible
        self._molecules, self._demands, self._prefix = molecules, demands, prefix
        terms, customs = molecules.particles_of_terms, molecules.customs
        self._parameters = list(expressions.parameters_of(customs))
        self.blocks = blocks_of(molecules.groups, terms, len(molecules.masses), divides=not demands.pairs)
        self._masses, self._body_of = molecules.masses, molecules.body_of
        self._of_clusters, of_clusters = clusters.arrays(
            self.blocks.starts, self.blocks.sizes, self.blocks.groups, shared=demands.pairs
        )
        precision = np.float32 if demands.single else np.float64
        self._of_terms, of_terms = tables.arrays(molecules.terms, self.blocks, precision, customs)
        self.n = len(self.blocks.particles)
        self.columns = self._body_of[self.blocks.particles]
        self._open = of_terms["PLACES_IN_ALL"] > self.n
        self.source = self._text(of_clusters | of_terms)
        self._mass = self._masses[self.blocks.particles]

    def _text(self, constants: dict[str, Any]) -> Source:
        demands = self._demands
        constants |= {"STILL": STILL, "BLOCK": BLOCK, "GROUPS": GROUPS, "LIGHT": LIGHT}
        constants |= dict(demands.defines)
        files: tuple[str, ...] = ("precision.cl", "random.cl", "context.cl", "layout.cl", "fixed_sums.cl")
        files += ("star.cl", "graph.cl")
        forces = (
            *expressions.pieces(self._molecules.customs),
            "bonded.cl",
            "inner.cl",
            "sums.cl",
            "flexible_updates.cl",
        )
        return Source("flexible", (*files, *forces), tuple(constants.items()))

    def _named(self, *names: str) -> tuple[str, ...]:
        return tuple(self._prefix + name for name in names)

    def state(self, copied: bool) -> tuple[str, str]:
        """Return the names of the arrays of a state: positions and velocities."""
        inner = "inner_" if self._demands.copied and not copied else ""
        return f"{self._prefix}{inner}x", f"{self._prefix}{inner}v"

    @property
    def _seen(self) -> str:
        """The name of the array of the projected velocities, which the Context shows."""
        return f"{self._prefix}seen"

    # -- declarations and launches ---------------------------------------------------------------------------------

    def declare(self, to: Program) -> None:
        """Declare the arrays of the tables, of the state and of stored forces."""
        demands = self._demands
        for name, values in self.tables().items():
            to.array(name, values.size, element=values.itemsize)
        for copied in (False, True)[: 1 + demands.copied]:
            for name in self.state(copied):
                to.array(name, 3 * self.n, demands.state_element, saved=True)
        for name in ("y", "z"):
            to.array(f"{self._prefix}{name}", 3 * self.n * self._open, demands.state_element)
        to.array(f"{self._prefix}memory", 3 * self.n * demands.memory[0], saved=True)
        to.array(f"{self._prefix}differences", 3 * self.n * demands.differences[0], saved=True)
        to.array(f"{self._prefix}here", 3 * self.n * demands.displaces)
        for name in ("push", "there"):
            to.array(f"{self._prefix}{name}", 3 * self.n * demands.displaces, demands.state_element)
        to.array(self._seen, 3 * self.n, demands.state_element)
        to.array(f"{self._prefix}exchanged", 12 * self.n * demands.exchanges)
        to.array(f"{self._prefix}heat", self.n * demands.exchanges, saved=True)
        to.array(f"{self._prefix}kinetic", SUMS * GROUPS)
        if self._parameters:
            to.parameters = f"{self._prefix}parameters", self._parameters

    def launches(self, segment: Segment, table: Table) -> list[Operation]:
        """Return the launches of a segment: a single launch, or one for each drift if blocks share terms.

        A displacement ends a segment without drifts. A kick at displaced positions begins a segment, and has a launch
        of its own.
        """
        moves = moves_of(segment, self._molecules.inner)
        x, v = self.state(segment.copied)
        displaced, made = f"{self._prefix}there", list[Operation]()
        if segment.has(Op.DISPLACE):
            return [self._launch(table.rows(moves), MOVES_ATOMS | PLACES_ATOMS, (x, displaced, v))]
        returns = segment.has(Op.DISPLACED_KICK)
        if returns:
            made.append(self._launch(table.rows(moves[:1]), 0, (displaced, displaced, v)))
            moves = moves[1:]
        parts = (self._open and up_to_drifts(moves)) or [moves]
        last_drift = max((k for k, part in enumerate(parts) if _drifts(part)), default=-1)
        here = x
        for k, part in enumerate(parts):
            last = k == len(parts) - 1
            there = self._next(here, x, k == last_drift) if self._open and _drifts(part) else here
            what = MOVES_ATOMS * _drifts(part) | PLACES_ATOMS * (
                k == last_drift or ((segment.places or returns) and last)
            )
            what |= (PROJECTS | SHOWS_ATOMS) * (segment.shows and last)
            made.append(self._launch(table.rows(part), what, (here, there, v)))
            here = there
        if here != x:
            made.append(copy(here, x))
        return made

    def _next(self, here: str, x: str, last: bool) -> str:
        """Return the name of the array for the positions after a drift from the positions in array `here`."""
        if last and here != x:
            return x
        y, z = f"{self._prefix}y", f"{self._prefix}z"
        return z if here == y else y

    def _launch(self, rows: tuple[int, int], what: int, state: tuple[str, ...]) -> Launch:
        arguments: tuple[str | int, ...] = (
            *_CONTEXT,
            *state,
            *self._named(*_FORCES, *_ATOMS, *_TABLES_OF_CLUSTERS, *_TABLES_OF_TERMS),
            *(Table.MOVES, Table.NUMBERS, "factors", *rows, what, "#step", "$key", "$turn", "$hottest"),
        )
        return Launch(self.source, INNER_STEPS, THREADS * len(self.blocks), arguments, THREADS)

    def reductions(self, copied: bool, adds: bool) -> list[Operation]:
        """Return operations that project velocities and write (or, if `adds`, add) the kinetic energy to "totals"."""
        x, v = self.state(copied)
        threads, (inverse, heat, sums) = min(self.n, BLOCK * GROUPS), self._named("inverse", "heat", "kinetic")
        kinetic = Launch(self.source, "flexible_kinetic", threads, (inverse, x, self._seen, heat, sums), BLOCK)
        total = Launch(self.source, "total", BLOCK, (sums, *TOTALS, int(adds)), BLOCK)
        return [self._launch((0, 0), PROJECTS, (x, x, v)), kinetic, total]

    def kinetic_by_kind(self, machine: Machine) -> Array:
        """Return the kinetic energies that the last reductions found: of translation, rotation and other particles."""
        sums = machine.download(f"{self._prefix}kinetic", np.empty((GROUPS, SUMS))).sum(axis=0)
        return np.array([0.0, 0.0, sums[0]])

    def pushed(self, copied: bool, to_copy: bool) -> list[Operation]:
        """Return operations that add to state(to_copy) the change of the velocities that the Context showed last."""
        _, v = self.state(to_copy)
        atoms, inverse, heat = self._named("atoms", "inverse", "heat")
        arguments = "velm", "places", atoms, inverse, self._seen, v, heat, "$removes"
        return [Launch(self.source, "flexible_pushed", self.n, arguments)]

    def moved(self, copied: bool) -> list[Operation]:
        """Return the operations that read positions changed by OpenMM."""
        arguments = "posq", "posqCorrection", "places", "box", f"{self._prefix}atoms", self.state(copied)[0]
        return [Launch(self.source, "flexible_moved", self.n, arguments)]

    # -- values ------------------------------------------------------------------------------------------------------

    def tables(self) -> dict[str, NDArray[Any]]:
        """Return the constant arrays by name."""
        of_atoms = {
            "atoms": self.blocks.particles.astype(np.int32),
            "bodies": self._bodies(np.ones(self.n, dtype=bool)),
            "inverse": np.divide(1.0, self._mass, out=np.zeros(self.n), where=self._mass > 0.0),
        }
        every = of_atoms | self._of_clusters | self._of_terms
        return {
            f"{self._prefix}{name}": values if values.size else np.zeros(1, values.dtype)
            for name, values in every.items()
        }

    def write(self, machine: Machine, state: State, copied: bool = False) -> None:
        """Write the part of a state for these bodies, and the positions of massless particles, to the machine."""
        massive = self._mass > 0.0
        columns, mass = self.columns[massive], self._mass[massive, None]
        x, v = exactly(self._particles[self.blocks.particles]), np.zeros((2, self.n, 3))
        x[:, massive] = state.R[:, :, columns].swapaxes(1, 2)
        v[:, massive] = quotient(state.P[:, :, columns].swapaxes(1, 2), mass)
        for name, values in zip(self.state(copied), (x, v), strict=True):
            self._demands.upload(machine, name, values)

    def read(self, machine: Machine, out: State, copied: bool = False) -> None:
        """Read the state of these bodies from the machine into `out`, the state of all bodies."""
        massive = self._mass > 0.0
        columns, mass = self.columns[massive], self._mass[massive, None]
        shape = (self.n, 3)
        x, v = (self._demands.download(machine, name, shape)[:, massive] for name in self.state(copied))
        out.R[:, :, columns] = x.swapaxes(1, 2)
        out.P[:, :, columns] = np.array(times(mass, (v[0], v[1]))).swapaxes(1, 2)

    def read_exchange(self, machine: Machine, around: tuple[State, State]) -> None:
        """Read positions and momenta before and after the last heat exchange into two states of all bodies."""
        massive = self._mass > 0.0
        columns, mass = self.columns[massive], self._mass[massive, None]
        x, before, after, _ = machine.download(f"{self._prefix}exchanged", np.empty((4, self.n, 3)))[:, massive]
        for out, v in zip(around, (before, after), strict=True):
            out.R[:, :, columns], out.P[:, :, columns] = exactly(x.T), exactly((mass * v).T)

    def flag(self, machine: Machine, flexible: NDArray[np.bool_]) -> None:
        """Write the flags (N,) of bodies in flexible molecules, but not of isolated pairs of atoms, to the machine."""
        machine.upload(f"{self._prefix}bodies", self._bodies(flexible[self.columns] & (self.columns >= 0)))

    def _bodies(self, flexible: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Return the index of the body of each atom, and whether the atom is in a flexible molecule (2, n)."""
        return np.stack([self.columns, flexible]).astype(np.int32)

    @property
    def bodies(self) -> Indices:
        """The sorted indices of these bodies among all bodies."""
        return np.sort(self.columns[self.columns >= 0])


def _drifts(part: Moves) -> bool:
    return any(move.op == Op.DRIFT for move in part)
