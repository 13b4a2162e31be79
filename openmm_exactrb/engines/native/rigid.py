"""Rigid bodies of all kinds in a program: their tables, their state in the machine, and the launches of a segment."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.engines.native.constants import HAS_FORCES, IS_DISPLACED, MOVES_PARTICLES, SHOWS_VELOCITIES
from openmm_exactrb.engines.native.program import Launch, Operation, Program, Source
from openmm_exactrb.engines.native.segments import Segment, Table, merged
from openmm_exactrb.library.library import Machine
from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.mechanics.bodies import Kind, RigidBodies
from openmm_exactrb.mechanics.divergence import LIGHT
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.rotors.exact import constants
from openmm_exactrb.steps.moves import MOVE, Op
from openmm_exactrb.support.types import Array, Indices

Values = Mapping[str, NDArray[Any]]

#: Bodies with more particles than the first number are each processed by the second number of threads.
LARGE, LANES = 16, 64
#: Number of threads per block, and largest number of blocks in a sum of kinetic energies.
BLOCK, GROUPS = 64, 256
#: The number of sums, and the arrays to which they are added; see kernels/sums.cl.
SUMS, TOTALS = 4, ("totals", "thermostat")
#: A body counts as unmoved if a barostat displaced it by less than this distance (nm).
STILL = 1e-9
#: The kernel that performs a segment.
SEGMENT = "segment"
_STATE = ("R", "P", "q", "L")
_ROWS = {"R": 3, "P": 3, "q": 4, "L": 3}
_TABLES = ("kind", "kinds", "atoms", "sites", "masses", "constants")
_CONTEXT = ("posq", "posqCorrection", "velm", "places", "box")
# Pattern of a function in the source of a user's move; the group is the name of the function.
_FUNCTION = re.compile(r"\bDEVICE\s+(?:inline\s+)?\w+\s+(\w+)\s*\(")


@dataclass(frozen=True)
class Demands:
    """The features that a scheme and its thermostat require of the kernels.

    Attributes
    ----------
    memory : tuple of int
        The numbers of stored forces, in total and per step.
    differences : tuple of int
        The numbers of stored differences between displaced and undisplaced forces, in total and per step.
    copied : bool
        Whether the Context shows a copy of the bodies, as for processed schemes.
    displaces : bool
        Whether the scheme contains force-gradient kicks.
    exchanges : bool
        Whether the scheme contains heat exchanges.
    scales : bool
        Whether heat exchanges multiply all momenta by common factors.
    heat : int
        The index of the heat among the persistent numbers of the thermostat, or -1.
    own : tuple of str
        Source texts of the users' moves, in the order of their numbers.
    pairs : bool
        Whether numbers of the state have low parts, as on processors.
    single : bool
        Whether increments of the state are in single precision, as on a device unless all of OpenMM's numbers are in
        double precision.
    """

    memory: tuple[int, int] = (0, 1)
    differences: tuple[int, int] = (0, 1)
    copied: bool = False
    displaces: bool = False
    exchanges: bool = False
    scales: bool = False
    heat: int = -1
    own: tuple[str, ...] = ()
    pairs: bool = False
    single: bool = False

    @property
    def defines(self) -> tuple[tuple[str, object], ...]:
        """The macros of the kernels for the precision, for stored forces and for heat exchanges."""
        (forces, per_step), (differences, of_differences) = self.memory, self.differences
        return (
            ("FINE", "float" if self.single else "double"),
            ("MEMORY", max(forces, 1)),
            ("PER_STEP", per_step),
            ("DIFFERENCES", max(differences, 1)),
            ("DIFFERENCES_PER_STEP", of_differences),
            ("KEEPS_DIFFERENCES", int(differences > 0)),
            ("GRADIENTS", int(self.displaces)),
            ("SCALES", int(self.scales)),
            ("HEAT", self.heat),
        )

    @property
    def state_element(self) -> int:
        """The number of bytes of a number of the state."""
        return 16 if self.pairs else 8

    def upload(self, machine: Machine, name: str, values: Array) -> None:
        """Write double-doubles (2, ...) to an array of the state."""
        machine.upload(name, np.stack((values[0], values[1]), axis=-1) if self.pairs else values[0])

    def download(self, machine: Machine, name: str, shape: tuple[int, int]) -> Array:
        """Read double-doubles (2, ...) from an array of the state with this shape."""
        if self.pairs:
            return np.moveaxis(machine.download(name, np.empty((*shape, 2))), -1, 0)
        return exactly(machine.download(name, np.empty(shape)))


def parts_of(bodies: RigidBodies, demands: Demands, others: Indices) -> list[RigidPart]:
    """Return the parts of a program for all bodies except `others` (k,): one each for small and for large bodies."""
    chosen = np.ones(len(bodies), dtype=bool)
    chosen[others] = False
    small = [kind for kind in bodies.kinds if kind.particles.shape[1] <= LARGE]
    large = [kind for kind in bodies.kinds if kind.particles.shape[1] > LARGE]
    if demands.pairs:  # on a processor, a thread moves a body of any size
        small, large = small + large, []
    made = (RigidPart(bodies, small, chosen, demands), RigidPart(bodies, large, chosen, demands, "large_", LANES))
    return [part for part in made if part.n]


class RigidPart:
    """The part of a program that moves kinds of rigid bodies with `lanes` threads each; array names have a prefix."""

    def __init__(
        self,
        bodies: RigidBodies,
        kinds: Sequence[Kind],
        chosen: NDArray[np.bool_],
        demands: Demands,
        prefix: str = "",
        lanes: int = 1,
    ) -> None:
        self._demands, self._prefix, self.lanes = demands, prefix, lanes
        some = [kind for kind in kinds if chosen[kind.bodies].any()]
        self._kinds = [kind.only(chosen[kind.bodies]) for kind in some]
        ranges = [np.arange(kind.bodies.start, kind.bodies.stop)[chosen[kind.bodies]] for kind in some]
        self.columns = np.concatenate([np.zeros(0, dtype=np.intp), *ranges])  # indices of the bodies among all bodies
        self.n = len(self.columns)
        self._turning = self.columns < bodies.n_turning
        self.source = self._text()

    # -- declarations and launches ---------------------------------------------------------------------------------

    def _text(self) -> Source:
        demands = self._demands
        own = [_own(number, text) for number, text in enumerate(demands.own)]
        sizes = {kind.particles.shape[1] for kind in self._kinds}
        defines: list[tuple[str, object]] = [
            ("BODIES", self.n),
            ("LANES", self.lanes),
            *([("SITES", *sizes)] if len(sizes) == 1 and self.lanes == 1 else []),
            *demands.defines,
            ("STILL", STILL),
            ("LIGHT", LIGHT),
            ("BLOCK", BLOCK),
            ("GROUPS", GROUPS),
            ("OWN_MOVES", " ".join(case for _, case in own)),
        ]
        body = "precision.cl", "random.cl", "context.cl", "nodes.cl", "rotation.cl", "body.cl"
        return Source(
            "rigid",
            (*body, *(text for text, _ in own), "rigid.cl", "rigid_updates.cl", "sums.cl", "kinetic.cl"),
            tuple(defines),
        )

    def _named(self, *names: str) -> tuple[str, ...]:
        return tuple(self._prefix + name for name in names)

    def state(self, copied: bool) -> tuple[str, ...]:
        """Return the names of the arrays of a state."""
        inner = self._demands.copied and not copied
        return self._named(*(f"inner_{name}" if inner else name for name in _STATE))

    def declare(self, to: Program) -> None:
        """Declare the arrays of the tables, of the state and of stored forces."""
        tables = self.tables()
        for name, values in tables.items():
            to.array(name, values.size, element=values.itemsize)
        for copied in (False, True)[: 1 + self._demands.copied]:
            for name, of in zip(self.state(copied), _STATE, strict=True):
                to.array(name, _ROWS[of] * self.n, self._demands.state_element, saved=True)
        memory, differences, here = self._named("last", "differences", "here")
        to.array(memory, 6 * self.n * self._demands.memory[0], saved=True)
        to.array(differences, 6 * self.n * self._demands.differences[0], saved=True)
        to.array(here, 6 * self.n * self._demands.displaces)
        exchanged, heat, kinetic = self._named("exchanged", "heat", "kinetic")
        to.array(exchanged, 12 * self.n * self._demands.exchanges)
        to.array(heat, self.n * self._demands.exchanges, saved=True)
        to.array(kinetic, SUMS * GROUPS)

    def launches(self, segment: Segment, table: Table) -> list[Operation]:
        """Return the launch that performs a segment."""
        moves = merged(move for move in segment.moves if move.bodies != "inner")
        displaced = segment.has(Op.DISPLACED_KICK)
        what = HAS_FORCES * any(move.groups for move in moves)
        what |= HAS_FORCES * segment.has(Op.REMEMBER)
        what |= MOVES_PARTICLES * (segment.places or displaced or any(move.displaces for move in moves))
        what |= SHOWS_VELOCITIES * segment.shows | IS_DISPLACED * displaced
        arguments: tuple[str | int, ...] = (
            *_CONTEXT,
            "force",
            *self._named(*_TABLES),
            *self.state(segment.copied),
            *self._named("index", "last", "differences", "here", "exchanged", "heat"),
            *(Table.MOVES, Table.NUMBERS, "factors"),
            *table.rows(moves),
            *(what, "#step", "$key", "$turn"),
        )
        return [self._launch(SEGMENT, arguments)]

    def _launch(self, function: str, arguments: tuple[str | int, ...], threads: int | None = None) -> Launch:
        lanes = self.lanes
        return Launch(self.source, function, threads or self.n * lanes, arguments, lanes if lanes > 1 else BLOCK)

    def reductions(self, copied: bool, adds: bool) -> list[Operation]:
        """Return operations that write the kinetic energies to "totals" or, if `adds`, add the energies to "totals"."""
        threads, (heat, sums) = min(self.n, BLOCK * GROUPS), self._named("heat", "kinetic")
        tables = self._named("kind", "kinds", "constants")
        kinetic = Launch(self.source, "kinetic", threads, (*tables, *self.state(copied), heat, sums), BLOCK)
        return [kinetic, Launch(self.source, "total", BLOCK, (sums, *TOTALS, int(adds)), BLOCK)]

    def kinetic_by_kind(self, machine: Machine) -> Array:
        """Return the kinetic energies that the last reductions found: of translation, rotation and other particles."""
        sums = machine.download(self._named("kinetic")[0], np.empty((GROUPS, SUMS))).sum(axis=0)
        return np.array([sums[0], sums[1], 0.0])

    def pushed(self, copied: bool, to_copy: bool) -> list[Operation]:
        """Return operations that add to state(to_copy) the change of the Context's velocities since state(copied)."""
        _, P, _, L = self.state(to_copy)
        states = *self.state(copied), P, L
        arguments = *_CONTEXT, *self._named(*_TABLES), *states, *self._named("heat"), "$removes"
        return [self._launch("pushed", arguments)]

    def moved(self, copied: bool) -> list[Operation]:
        """Return the operations that read positions changed by OpenMM."""
        return [self._launch("moved", (*_CONTEXT, *self._named(*_TABLES), *self.state(copied)))]

    # -- values ------------------------------------------------------------------------------------------------------

    def tables(self) -> dict[str, NDArray[Any]]:
        """Return the constant arrays by name; the flags of flexible molecules in "index" are zero."""
        rows, atoms, sites, masses, of_bodies = [], [], [], [], []
        kind_of = np.concatenate([np.full(len(k.particles), number) for number, k in enumerate(self._kinds)])
        first = counts = n_sites = n_masses = n_constants = 0
        for kind in self._kinds:
            count, size = kind.particles.shape
            own = len(kind.sites) > 1
            rows.append((first, count, size, counts, n_sites, n_masses, int(own), n_constants))
            atoms.append(kind.particles.T.ravel())
            sites.append(kind.sites.transpose(1, 0, 2).reshape(-1, 3))
            masses.append(kind.masses)
            of_bodies.append(np.array(list(_constants(kind))))
            first, counts = first + count, counts + count * size
            n_sites, n_masses, n_constants = n_sites + len(sites[-1]), n_masses + size, n_constants + len(of_bodies[-1])
        index = np.stack([self.columns, np.zeros(self.n, dtype=np.intp)])
        values: dict[str, NDArray[Any]] = {
            "kind": kind_of.astype(np.int32),
            "kinds": np.array(rows, dtype=np.int32),
            "atoms": np.concatenate(atoms).astype(np.int32),
            "sites": np.concatenate(sites),
            "masses": np.concatenate(masses),
            "constants": np.concatenate(of_bodies),
            "index": index.astype(np.int32),
        }
        return {self._prefix + name: array for name, array in values.items()}

    def flag(self, machine: Machine, flexible: NDArray[np.bool_]) -> None:
        """Write the flags (N,) of bodies in flexible molecules to the machine."""
        index = np.stack([self.columns, flexible[self.columns]])
        machine.upload(self._prefix + "index", index.astype(np.int32))

    def write(self, machine: Machine, state: State, copied: bool = False) -> None:
        """Write the part of a state for these bodies to the machine."""
        turning, columns = self._turning, self.columns
        q, L = np.zeros((2, 4, self.n)), np.zeros((2, 3, self.n))
        q[0, 0] = 1.0
        q[:, :, turning], L[:, :, turning] = state.q[:, :, columns[turning]], state.m[:, :, columns[turning]]
        values = (state.R[:, :, columns], state.P[:, :, columns], q, L)
        for name, array in zip(self.state(copied), values, strict=True):
            self._demands.upload(machine, name, array)

    def read(self, machine: Machine, out: State, copied: bool = False) -> None:
        """Read the state of these bodies from the machine into `out`, the state of all bodies."""
        R, P, q, L = (
            self._demands.download(machine, name, (_ROWS[of], self.n))
            for name, of in zip(self.state(copied), _STATE, strict=True)
        )
        turning, columns = self._turning, self.columns
        out.R[:, :, columns], out.P[:, :, columns] = R, P
        out.q[:, :, columns[turning]], out.m[:, :, columns[turning]] = q[:, :, turning], L[:, :, turning]

    def read_exchange(self, machine: Machine, around: tuple[State, State]) -> None:
        """Read the momenta of these bodies before and after the last heat exchange into two states of all bodies."""
        momenta = machine.download(self._prefix + "exchanged", np.empty((2, 2, 3, self.n)))
        turning, columns = self._turning, self.columns
        for out, (P, L) in zip(around, momenta, strict=True):
            out.P[:, :, columns] = exactly(P)
            out.m[:, :, columns[turning]] = exactly(L[:, turning])


def _constants(kind: Kind) -> Iterator[tuple[float, ...]]:
    """Yield b, rho, sigma, 1/I3, the inverse moments, 1/M, sqrt(M) and the square roots of the moments for a kind."""
    for moments in kind.inertia:
        of_rotor = np.where(kind.linear, moments[2], moments) if kind.turns else np.ones(3)
        inverse = np.divide(1.0, moments, out=np.zeros(3), where=moments > 0.0)
        rotor = constants(of_rotor[:, None])[:4, 0]
        yield (*rotor, *inverse, 1.0 / kind.mass, kind.mass**0.5, *np.sqrt(moments))


def _own(number: int, text: str) -> tuple[str, str]:
    """Return the source of a user's move, with unique function names, and the `case` label that calls it."""
    names = dict.fromkeys(_FUNCTION.findall(text))
    move = MOVE.findall(text)[-1]
    renamed = [f"#define {name} {name}_{number}" for name in names], [f"#undef {name}" for name in names]
    return "\n".join((*renamed[0], text, *renamed[1])), f"case {Op.OWN + number}: {move}_{number}(body, tau); break;"
