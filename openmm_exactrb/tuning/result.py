"""What a user gets: all that was measured, asked, printed, kept and drawn."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass
from typing import Any

from openmm_exactrb.checks import positive
from openmm_exactrb.tuning import answers, picture, text
from openmm_exactrb.tuning.record import Choice, Record


@dataclass(frozen=True)
class Tuning(Record):
    """What was measured, and the advice that follows; its attributes are those of `Record`."""

    def best(self, target: float | None = None) -> Choice:
        """Return the cheapest scheme and its step for an energy error.

        Parameters
        ----------
        target : float, optional
            Standard deviation of the total energy in kJ/mol per body within a run as long as the horizon. For the
            target that was tuned for, and without one, the choice was confirmed by a run over all of the horizon;
            others are interpolated with `cheapest`.

        Raises
        ------
        UnreachableError
            With the smallest error that was found.
        """
        target = self.target if target is None else positive(target, "target", "kJ/mol per body")
        if target is None:
            raise ValueError("give best() a target: tune() was called without one")
        if target != self.target:
            return self.cheapest(target)
        if self.chosen is None:
            raise answers.UnreachableError(answers.unreachable(self, target))
        return self.chosen

    def cheapest(self, target: float, method: str | None = None) -> Choice:
        """Return the cheapest setting for an energy error, between those measured.

        Parameters
        ----------
        target : float
            As for `best`.
        method : str, optional
            A scheme, or "VerletIntegrator"; all schemes unless given.

        Raises
        ------
        UnreachableError
            With the smallest error that was found.
        ValueError
            If the method was not measured or the target is not positive.
        """
        return answers.cheapest(self, positive(target, "target", "kJ/mol per body"), method)

    def error_at(self, cost: float, method: str | None = None) -> Choice:
        """Return the setting with the least energy error at a cost, and the error with it.

        Parameters
        ----------
        cost : float
            Wall time in s per ps.
        method : str, optional
            As for `cheapest`.

        Raises
        ------
        UnreachableError
            If every stable setting costs more.
        ValueError
            If the method was not measured or the cost is not positive.
        """
        return answers.least_error(self, positive(cost, "cost", "s per ps"), method)

    def largest_stable_step(self, method: str) -> float:
        """Return the largest step in ps of a scheme that kept its energy to a tenth of the kinetic energy.

        Steps were tried up to the first unstable one, 19 % above it or less, or as far as free bodies turn by a radian
        between two forces.

        Raises
        ------
        ValueError
            If the method was not measured, or no step of it was stable.
        """
        (name,) = self.methods(method)
        step = self.largest_stable(name)
        if step is None:
            raise answers.UnreachableError(f"no step of {name} that was tried is stable")
        return step

    def __str__(self) -> str:
        return text.summary(self)

    def table(self) -> str:
        """Return the errors of all methods over the time a force evaluation, as text."""
        return text.table(self)

    def as_dict(self) -> dict[str, Any]:
        """Return all of it as plain numbers, strings and lists.

        Errors of unstable runs are None, and costs where nothing was stable, so that nothing was timed.
        """
        content = asdict(self)
        for point in content["points"]:
            point |= {name: _finite(point[name]) for name in ("error", "cost")}
        content["largest_stable_steps"] = {name: self.largest_stable(name) for name in self.seconds}
        content["units"] = {"error": "kJ/mol per body", "step": "ps", "cost": "s per ps", "seconds": "s"}
        return content

    def to_json(self) -> str:
        """Return all of it as JSON."""
        return json.dumps(self.as_dict(), indent=1, allow_nan=False)

    def draw(self, file: str | os.PathLike[str]) -> None:
        """Draw energy error over cost; needs matplotlib.

        Parameters
        ----------
        file : str or path
            With the ending of a format that matplotlib writes.

        Raises
        ------
        ModuleNotFoundError
            Without matplotlib.
        """
        picture.draw(self, file)


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None
