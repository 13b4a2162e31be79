"""The program of an integrator, which this package writes: a user's own computations raise an error."""

from __future__ import annotations

import functools
from typing import Any

import openmm


def _refused(name: str) -> Any:
    """Return a method of CustomIntegrator that raises ValueError once the integrator is made."""
    method = getattr(openmm.CustomIntegrator, name)

    @functools.wraps(method)
    def refuse(self: Any, *arguments: Any, **options: Any) -> Any:
        if self._made:
            raise ValueError(
                f"{type(self).__name__} has no {name}(): its steps are made by a Scheme and not by a program, so put a "
                "Substep of your own into the sequence of a Scheme (docs: For contributors, A substep)"
            )
        return method(self, *arguments, **options)

    return refuse


class OwnProgram:
    """Methods of openmm.CustomIntegrator that write programs; only the making of an integrator may call them."""

    _made = False

    addComputeGlobal = _refused("addComputeGlobal")
    addComputePerDof = _refused("addComputePerDof")
    addComputeSum = _refused("addComputeSum")
    addConstrainPositions = _refused("addConstrainPositions")
    addConstrainVelocities = _refused("addConstrainVelocities")
    addGlobalVariable = _refused("addGlobalVariable")
    addPerDofVariable = _refused("addPerDofVariable")
    addTabulatedFunction = _refused("addTabulatedFunction")
    addUpdateContextState = _refused("addUpdateContextState")
    beginIfBlock = _refused("beginIfBlock")
    beginWhileBlock = _refused("beginWhileBlock")
    endBlock = _refused("endBlock")
