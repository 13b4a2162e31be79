"""Protection of an integrator's program against computations that a user tries to add."""

from __future__ import annotations

import functools
from typing import Any

import openmm


def _closed(name: str) -> Any:
    """Return a method of CustomIntegrator that raises ValueError once the integrator is complete."""
    method = getattr(openmm.CustomIntegrator, name)

    @functools.wraps(method)
    def raising(self: Any, *arguments: Any, **options: Any) -> Any:
        if self._made:
            raise ValueError(
                f"{type(self).__name__} has no {name}(), because its steps are defined by a Scheme: put your own "
                "Substep into the sequence of a Scheme (docs: For contributors, A substep)"
            )
        return method(self, *arguments, **options)

    return raising


class OwnProgram:
    """Methods of openmm.CustomIntegrator that write programs; only the constructor of an integrator may call them."""

    _made = False


for _name in (
    *("addComputeGlobal", "addComputePerDof", "addComputeSum", "addConstrainPositions", "addConstrainVelocities"),
    *("addGlobalVariable", "addPerDofVariable", "addTabulatedFunction", "addUpdateContextState"),
    *("beginIfBlock", "beginWhileBlock", "endBlock", "setKineticEnergyExpression"),
):
    setattr(OwnProgram, _name, _closed(_name))
