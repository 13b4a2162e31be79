"""All errors and warnings of the package, except those of invalid arguments, which are ValueErrors and TypeErrors.

``except openmm.OpenMMException`` also catches errors of runs, as it catches those of OpenMM's own integrators.
"""

from __future__ import annotations

import openmm


class IntegrationError(openmm.OpenMMException, ArithmeticError):
    """A run has diverged, usually because the step is too large or bodies overlap initially."""


class NonFiniteError(IntegrationError):
    """Positions, momenta or forces are not finite, or a body is faster than light."""


class MinimisationError(openmm.OpenMMException, ArithmeticError):
    """OpenMM's minimiser violates or does not support the constraints."""


class MissingLibraryError(openmm.OpenMMException, RuntimeError):
    """The library of the native engine is not available; the message states the reason and the remedy."""


class UnreachableError(ValueError):
    """Raised if no measured setting reaches the target."""


class BudgetSpentError(RuntimeError):
    """Raised if the budget does not allow the next run."""


# Warnings


class StepSizeWarning(UserWarning):
    """A step is too long for correct averages: it is near a resonance, or the temperature stays too high."""


class ShapeWarning(UserWarning):
    """Positions deviated slightly from the shapes of bodies and were corrected, or a shape is ambiguous."""


class MinimisationWarning(UserWarning):
    """A minimisation ended with forces above its tolerance."""


class RemovedMotionWarning(UserWarning):
    """The removal of momentum transferred by frozen particles causes energy errors of first order in the step size."""


class NotConvergedWarning(RuntimeWarning):
    """The iteration of the discrete Moser-Veselov algorithm failed for some bodies, whose results are nan."""


# What one room raises and another catches


class NotServedError(Exception):
    """Raised if the kernels do not support some molecules or forces; the message names these and states the remedy."""


class DivergedError(Exception):
    """Steps have diverged: the kind of the error, and its description without the step."""

    def __init__(self, kind: type[IntegrationError], what: str) -> None:
        super().__init__(what)
        self.kind, self.what = kind, what
