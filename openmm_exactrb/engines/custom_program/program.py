"""A CustomIntegrator's program as it is written: statements, blocks that are closed automatically, and expressions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import openmm

from openmm_exactrb.engines.custom_program import names
from openmm_exactrb.engines.custom_program.rows import Table

#: The axes about which a body can turn, as numbers that are 1 or 0.
AXES = "vector(_x(shape),1-_y(shape),1-_y(shape))"
#: 1 where a body is a single particle, else 0.
ALONE = "_y(shape)"
#: The inverse principal moments of inertia.
INVERSE_INERTIA = "vector(_x(inverse)+_x(abc),_x(inverse)+_x(abc)*_z(abc),_x(inverse))"
_ROW = "floor((_x(at)+0.5)*_z(shape))"


@dataclass(frozen=True)
class Layout:
    """What a program is made for.

    Attributes
    ----------
    table : Table
    sums : int
        The force group of the sums over bodies.
    fast : int or None
        The force group of the fast forces.
    slow : tuple of int
        The force groups of the others, where there are fast ones. OpenMM's minimiser and barostats take the groups of
        an integrator, so that these still are all groups that act.
    clusters : bool
        Whether OpenMM's constraints hold particles that are no rigid bodies.
    """

    table: Table
    sums: int
    fast: int | None = None
    slow: tuple[int, ...] = ()
    clusters: bool = False


class Program:
    """Adds computations to an integrator that has no Context yet, where sums over bodies are in a force group."""

    def __init__(self, integrator: openmm.CustomIntegrator, layout: Layout) -> None:
        self.integrator, self.table, self.group = integrator, layout.table, layout.sums
        self.fast, self.slow, self.clusters = layout.fast, layout.slow, layout.clusters

    def vectors(self, *particles: str) -> None:
        """Declare per-DOF variables, all zero."""
        for name in particles:
            self.integrator.addPerDofVariable(name, 0.0)

    def numbers(self, value: float, *names: str) -> None:
        """Declare global variables of one value."""
        for name in names:
            self.integrator.addGlobalVariable(name, value)

    def let(self, name: str, expression: str) -> None:
        """Compute a per-DOF variable. OpenMM makes one kernel of neighbouring ones that need the same forces."""
        self.integrator.addComputePerDof(name, expression)

    def number(self, name: str, expression: str) -> None:
        """Compute a global variable."""
        self.integrator.addComputeGlobal(name, expression)

    def total(self, name: str, expression: str) -> None:
        """Sum over all components of all particles; the device is waited for."""
        self.integrator.addComputeSum(name, expression)

    @contextmanager
    def when(self, condition: str) -> Iterator[None]:
        """Make a block that runs where a condition on numbers holds."""
        self.integrator.beginIfBlock(condition)
        yield
        self.integrator.endBlock()

    @contextmanager
    def loop(self, condition: str) -> Iterator[None]:
        """Make a block that runs while a condition on numbers holds."""
        self.integrator.beginWhileBlock(condition)
        yield
        self.integrator.endBlock()

    def times(self, name: str, parts: Sequence[tuple[str, str]]) -> None:
        """Write dt times three parts of the present row to a per-DOF variable; "p" is changed too.

        Each part comes with the turns of the row that have it: "begins" is the first one, "ends" the last one, "1" any.
        """
        n = len(self.table.rows)
        if self.table.constrained:
            self.let("p", f"vector({','.join(f'{self.table.column(part) * n}+_x(at)' for part, _ in parts)})")
            self.let(name, f"dt*({'+'.join(f'{function}(p)' for function in names.TABLES)})")
            return
        entries = (f"{self.table.column(part) * n}+select({turn},row,{n - 1})" for part, turn in parts)
        self.let(
            "p",
            f"vector({','.join(entries)});"
            "begins=step(_z(shape)-within);ends=step(within-1+_z(shape));within=(_x(at)+0.5)*_z(shape)-row;"
            f"row={_ROW}",
        )
        self.let(name, f"dt*({'+'.join(f'{function}(p)' for function in names.TABLES)})")

    def place(self, expression: str, group: int | None) -> None:
        """Write positions in a kernel that needs the forces of a group, which count as zero; "a" and "n" change.

        Statements before it that need no forces are of this kernel too. The Reference platform knows the force of a
        group in statements without vectors only.
        """
        if group is None:
            self.let("x", expression)
            return
        self.let("a", f"{ALONE}*_x(inverse)")  # zero, for single particles have no moment of inertia
        self.let("n", expression)
        self.let("x", f"n+a*f{group}")

    @property
    def begins(self) -> str:
        """The expression that is 1 in the first turn of a row, else 0."""
        return "1" if self.table.constrained else f"step(_z(shape)-(_x(at)+0.5)*_z(shape)+{_ROW})"

    def is_zero(self, part: str) -> str:
        """Return the expression that is 1 where a part of the present row is zero, else 0."""
        return f"delta({names.TABLES[0]}({names.ROW}+{self.table.column(part) * len(self.table.rows)}))"


def turned(q: str, w: str, vector: str) -> str:
    """Return the expression of a vector of the body in space, for the orientation (w, q)."""
    return f"({vector}+2*cross({q},cross({q},{vector})+{w}*{vector}))"


def turned_back(q: str, w: str, vector: str) -> str:
    """Return the expression of a vector of space in the body."""
    return f"({vector}+2*cross({q},cross({q},{vector})-{w}*{vector}))"
