"""Expressions that several parts of the program need."""

from __future__ import annotations

from collections.abc import Sequence

from openmm_exactrb.device import names
from openmm_exactrb.device.program import Program
from openmm_exactrb.device.rows import Table

#: The axes about which a body can turn, as numbers that are 1 or 0.
AXES = "vector(_x(shape),1-_y(shape),1-_y(shape))"
#: 1 where a body is a single particle, else 0.
ALONE = "_y(shape)"
#: The inverse principal moments of inertia.
INVERSE_INERTIA = "vector(_x(inverse)+_x(abc),_x(inverse)+_x(abc)*_z(abc),_x(inverse))"
_ROW = "floor((_x(at)+0.5)*_z(shape))"
#: 1 in the first turn of a row, else 0.
BEGINS = f"step(_z(shape)-(_x(at)+0.5)*_z(shape)+{_ROW})"


def turned(q: str, w: str, vector: str) -> str:
    """Return the expression of a vector of the body in space, for the attitude (w, q)."""
    return f"({vector}+2*cross({q},cross({q},{vector})+{w}*{vector}))"


def turned_back(q: str, w: str, vector: str) -> str:
    """Return the expression of a vector of space in the body."""
    return f"({vector}+2*cross({q},cross({q},{vector})-{w}*{vector}))"


def times(program: Program, table: Table, name: str, parts: Sequence[tuple[str, str]]) -> None:
    """Write dt times three parts of the present row.

    Parameters
    ----------
    program : Program
    table : Table
    name : str
        The per-DOF variable that gets them; "p" is changed too.
    parts : sequence of (str, str)
        Each part with the turns of the row that have it: "begins" is the first one, "ends" the last one, "1" any.
    """
    n = len(table.rows)
    entries = (f"{table.column(part) * n}+select({turn},row,{n - 1})" for part, turn in parts)
    program.let(
        "p",
        f"vector({','.join(entries)});"
        "begins=step(_z(shape)-within);ends=step(within-1+_z(shape));within=(_x(at)+0.5)*_z(shape)-row;"
        f"row={_ROW}",
    )
    program.let(name, f"dt*({'+'.join(f'{function}(p)' for function in names.TABLES)})")
