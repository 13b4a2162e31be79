"""The limit on the processor time of a call of `tune`."""

from __future__ import annotations

import time

from openmm_exactrb.errors import BudgetSpentError

# Fraction of the budget reserved for the last samples of a run and for the result.
_KEPT = 0.03


class Budget:
    """Seconds of processor time of this process, over all threads, counted from the creation of the object."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._begun = time.process_time()

    @property
    def left(self) -> float:
        """Remaining seconds minus the reserve."""
        return (1.0 - _KEPT) * self.seconds - (time.process_time() - self._begun)

    def require(self, seconds: float = 0.0) -> None:
        """Raise BudgetSpentError if less than the given time is left."""
        if self.left < seconds:
            raise BudgetSpentError(
                f"the budget of {self.seconds:g} s of processor time was spent before the first result: use a larger "
                "budget"
            )
