"""Errors that ``except openmm.OpenMMException`` also catches, as it catches those of OpenMM's own integrators."""

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
