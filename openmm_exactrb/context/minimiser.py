"""What OpenMM's minimiser needs, and the Systems on which it fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import openmm

from openmm_exactrb.context.solver import joined_by_constraints, mended, satisfied, solvable
from openmm_exactrb.errors import MinimisationError
from openmm_exactrb.openmm_access import arrays

#: OpenMM's minimiser, which the package may replace later.
OPENMM = openmm.LocalEnergyMinimizer.minimize
_INSTEAD = "call integrator.minimizeEnergy() instead"
#: The message after a minimisation by OpenMM that violates the constraints.
VIOLATED = (
    "OpenMM's minimiser could not satisfy the constraints{}: relax the positions before by short steps at high "
    "friction with checkDivergence=False"
)


def prepare(context: openmm.Context, named: Sequence[Sequence[int]] | None) -> None:
    """Prepare a Context for OpenMM's minimiser, which pulls together the parts of molecules that the box has split.

    Raises
    ------
    MinimisationError
        If there are bodies passed as `bodies`, which OpenMM's minimiser would deform, or redundant constraints, with
        which it may return NaN or crash.
    """
    if named:
        raise MinimisationError(f"OpenMM's minimiser would deform the bodies passed as bodies=: {_INSTEAD}")
    mended(context)
    system, x = context.getSystem(), arrays.positions(context.getState(positions=True))
    whole = joined_by_constraints(context, x)
    if not solvable(system, whole):
        raise MinimisationError(f"OpenMM's minimiser fails on constraints that follow from others: {_INSTEAD}")
    if whole is not x:
        context.setPositions(whole)


def check(context: openmm.Context) -> None:
    """Raise MinimisationError if positions that OpenMM's minimiser left violate the constraints."""
    if not satisfied(context.getSystem(), arrays.positions(context.getState(positions=True))):
        raise MinimisationError(VIOLATED.format(""))


def minimise(original: Callable[..., None], context: Any, *arguments: Any, **options: Any) -> None:
    """Minimise the energy of a Context with an integrator of this package by OpenMM's method `original`."""
    context.getIntegrator()._expect_minimisation(context)  # noqa: SLF001
    original(context, *arguments, **options)
    check(context)
