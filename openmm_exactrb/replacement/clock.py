"""The steps that a script counts, if its own step differs from the step that is made and the simulated time is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import Any

from openmm import app

from openmm_exactrb.integrators.step_sizes import femtoseconds

# The largest denominator of a ratio of two steps, and the relative error of the ratio that is due to rounding.
_MOST, _ROUNDING = 1000, 1e-9


class SharedClock:
    """The steps of a script in terms of the steps that an integrator makes.

    Parameters
    ----------
    theirs, own : float
        The step of the script and that of the integrator, in ps.

    Raises
    ------
    ValueError
        If the ratio of the steps is not a ratio of small numbers.

    Attributes
    ----------
    ratio : Fraction
        How many steps of the script take the time of one step of the integrator.
    """

    def __init__(self, theirs: float, own: float) -> None:
        self._left, self._divided = Fraction(0), False
        self._begin = 0, 0  # steps made, and the number of steps that the script counts then
        self.change(theirs, own, 0)

    def change(self, theirs: float, own: float, made: int) -> None:
        """Change the step of the script, after a number of steps that were made."""
        words = femtoseconds(theirs), femtoseconds(own)
        ratio = Fraction(own / theirs).limit_denominator(_MOST)
        if abs(ratio * theirs / own - 1.0) > _ROUNDING:
            raise ValueError(
                f"steps of {words[1]} cannot keep the time of steps of {words[0]}: choose an interval that is a "
                "multiple of the step of the script"
            )
        if made:
            self._begin = made, self.shown(made)
            self._left = Fraction(0)
        self.ratio, self._words = ratio, words

    def steps(self, count: int) -> int:
        """Return the number of steps to make for steps of the script; raise ValueError if it is not whole."""
        if not self._divided:
            self.require_until(count)
        whole, self._left = divmod(self._left + count, self.ratio)
        return int(whole)

    def require(self, count: int | Fraction, what: str) -> None:
        """Raise ValueError if a number of steps of the script is not a whole number of steps here."""
        if count % self.ratio:
            theirs, own = self.ratio.numerator, self.ratio.denominator
            raise ValueError(
                f"{what} cannot be divided, because {theirs} steps of {self._words[0]} are {own} of {self._words[1]}: "
                f"change this number to a multiple of {theirs}, or omit same_time (--same-time)"
            )

    def require_until(self, count: int, what: str = "") -> None:
        """Raise ValueError if a number of further steps of the script does not end with a whole step here."""
        self.require(self._left + count, what or f"step({count})")

    def shown(self, made: int) -> int:
        """Return the number of steps that the script counts after steps that were made."""
        return round(self._begin[1] + (made - self._begin[0]) * self.ratio + self._left)

    def set(self, count: int) -> int:
        """Return the number of steps made for a number of steps that the script sets."""
        self.require(count, f"currentStep = {count}")
        self._begin, self._left = (0, 0), Fraction(0)
        return int(count / self.ratio)

    @contextmanager
    def divided(self) -> Iterator[None]:
        """Accept steps in parts, which are made when they amount to a whole step."""
        self._divided = True
        try:
            yield
        finally:
            self._divided = False


def changes_of_simulation(clock_of: Callable[[Any], SharedClock | None]) -> Iterator[tuple[Any, str, Any]]:
    """Yield changes of app.Simulation with which it counts a script's steps, as (owner, name, attribute).

    clock_of(integrator) returns the SharedClock of an integrator, or None.
    """
    count, simulate, report = (vars(app.Simulation)[name] for name in ("currentStep", "_simulate", "_generate_reports"))

    def current(simulation: Any) -> int:
        clock, made = clock_of(simulation.integrator), int(count.fget(simulation))
        return made if clock is None else clock.shown(made)

    def set_current(simulation: Any, step: int) -> None:
        clock = clock_of(simulation.integrator)
        count.fset(simulation, step if clock is None else clock.set(step))

    def simulating(simulation: Any, endStep: int | None = None, endTime: Any = None) -> None:
        if (clock := clock_of(simulation.integrator)) is None:
            simulate(simulation, endStep, endTime)
            return
        if endStep is not None:
            clock.require_until(endStep - simulation.currentStep)
        for reporter in simulation.reporters:
            every = getattr(reporter, "_reportInterval", None)  # of all reporters of OpenMM
            if isinstance(every, int):
                clock.require(every, f"the interval of {type(reporter).__name__}")
        with clock.divided():
            simulate(simulation, endStep, endTime)

    def reporting(simulation: Any, reports: Any, periodic: bool) -> None:
        if (clock := clock_of(simulation.integrator)) is not None:
            names = " and ".join(type(reporter).__name__ for reporter, _ in reports)
            clock.require_until(0, f"step {simulation.currentStep}, at which {names} reports,")
        report(simulation, reports, periodic)

    yield app.Simulation, "currentStep", property(current, set_current, doc=count.__doc__)
    yield app.Simulation, "_simulate", simulating
    yield app.Simulation, "_generate_reports", reporting
