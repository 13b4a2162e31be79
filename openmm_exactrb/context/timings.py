"""Where the time of a run goes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any


@dataclass
class Timings:
    """Wall time in seconds, and force evaluations, since the integrator was made or `reset` was called.

    Attributes
    ----------
    forces : float
        Inside OpenMM: setPositions, computeVirtualSites, getState.
    rotor : float
        The free rotation of the bodies.
    total : float
        Everything inside step().
    evaluations : int
        Force evaluations, but for those of nested forces.
    fast_evaluations : int
        Evaluations of the forces that are nested in the drifts.
    """

    forces: float = 0.0
    rotor: float = 0.0
    total: float = 0.0
    evaluations: int = 0
    fast_evaluations: int = 0

    def reset(self) -> None:
        """Begin again at zero."""
        self.forces = self.rotor = self.total = 0.0
        self.evaluations = self.fast_evaluations = 0

    def count(self, counter: str) -> None:
        """Add one to a number of evaluations, given by its name."""
        setattr(self, counter, getattr(self, counter) + 1)

    @contextmanager
    def measuring(self) -> Iterator[None]:
        """Add the time within a block to `total`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.total += time.perf_counter() - start

    def of_rotor(self, rotation: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose time is added to `rotor`."""

        def timed(*arguments: Any) -> Any:
            start = time.perf_counter()
            result = rotation(*arguments)
            self.rotor += time.perf_counter() - start
            return result

        return timed
