"""A CustomIntegrator's program as it is written: statements, and blocks that are closed by themselves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import openmm


class Program:
    """Adds computations to an integrator that has no Context yet.

    Parameters
    ----------
    integrator : openmm.CustomIntegrator
    group : int
        The force group of the sums over bodies.
    """

    def __init__(self, integrator: openmm.CustomIntegrator, group: int) -> None:
        self.integrator, self.group = integrator, group

    def vectors(self, *particles: str) -> None:
        """Declare per-DOF variables, all zero."""
        for name in particles:
            self.integrator.addPerDofVariable(name, 0.0)

    def numbers(self, value: float, *names: str) -> None:
        """Declare global variables of one value."""
        for name in names:
            self.integrator.addGlobalVariable(name, value)

    def table(self, name: str, values: Sequence[float]) -> None:
        """Declare a function of 0, 1, 2, ..."""
        self.integrator.addTabulatedFunction(name, openmm.Discrete1DFunction(list(map(float, values))))

    def let(self, name: str, expression: str) -> None:
        """Compute a per-DOF variable. OpenMM makes one kernel of neighbouring ones that need the same forces."""
        self.integrator.addComputePerDof(name, expression)

    def number(self, name: str, expression: str | float) -> None:
        """Compute a global variable or a parameter of the Context."""
        self.integrator.addComputeGlobal(name, expression if isinstance(expression, str) else repr(float(expression)))

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
