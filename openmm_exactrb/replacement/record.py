"""What was replaced while `replace_integrators` was in progress, and what it changes."""

from __future__ import annotations

import contextlib
import threading
import weakref
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import openmm

from openmm_exactrb.context.updates import BAROSTATS, frequency
from openmm_exactrb.integrators.step_sizes import described, femtoseconds
from openmm_exactrb.replacement.clock import SharedClock
from openmm_exactrb.replacement.integrators import Replacement
from openmm_exactrb.support import checks

_SAME = 1e-9  # relative difference of steps that are equal


class Replaced:
    """What was replaced, as numbers.

    Attributes
    ----------
    interval : float or None
        The step in ps of all integrators, or None if they have the steps of the script.
    integrators : Counter
        The number of integrators that were created instead of OpenMM's, by the name of the class in OpenMM.
    others : Counter
        The number of Contexts with integrators that were not replaced, by the name of the class.
    steps, forceEvaluations : int
        The number of steps that were made, and of the force evaluations that they contain.
    time : float
        The simulated time in ps.
    openmmForceEvaluations : float
        The number of force evaluations of OpenMM's integrators, with the steps of the script, over this time.
    """

    def __init__(self, interval: float | None, same_time: bool, tell: Callable[[str], object]) -> None:
        self.interval, self.integrators, self.others = interval, Counter[str](), Counter[str]()
        self.steps, self.forceEvaluations, self.time, self.openmmForceEvaluations = 0, 0, 0.0, 0.0
        self._same_time, self._tell, self._told = same_time, tell, set[str]()
        self._counting = threading.Lock()
        self._clocks: weakref.WeakKeyDictionary[Any, SharedClock] = weakref.WeakKeyDictionary()
        # The System of each integrator with a clock, and the number of forces of which barostats were divided.
        self._systems: weakref.WeakKeyDictionary[Any, openmm.System] = weakref.WeakKeyDictionary()
        self._divided: weakref.WeakKeyDictionary[openmm.System, int] = weakref.WeakKeyDictionary()

    @property
    def gain(self) -> float:
        """The force evaluations of OpenMM's integrators relative to those of this package, over the same time."""
        return self.openmmForceEvaluations / self.forceEvaluations if self.forceEvaluations else 1.0

    def tell_once(self, text: str) -> None:
        """Report a sentence that was not yet reported."""
        if text not in self._told:
            self._told.add(text)
            self._tell(text)

    def add(self, integrator: Any) -> None:
        """Count a new integrator, and report what it is and how long a run becomes."""
        name, h, asked = integrator.replaced.__name__, integrator._h, integrator.scriptStep  # noqa: SLF001
        self.integrators[name] += 1
        ours = next(kind.__name__ for kind in type(integrator).__mro__ if kind.__name__.startswith("ExactRigidBody"))
        step = described(h, integrator.forceEvaluationsPerStep)
        text = f"{ours} ({integrator.getScheme().name}) instead of {name}: {step}"
        if abs(h / asked - 1.0) > _SAME:
            times = f"{h / asked:.6g}"
            text += f", and in the script {femtoseconds(asked)}: " + (
                f"{times} steps of the script are one step, and its run has the same simulated time"
                if self._same_time
                else f"n steps of the script stay n steps, and have {times} times the simulated time"
            )
        self.tell_once(text)

    def clock(self, integrator: Any) -> SharedClock | None:
        """Return how steps of the script are counted if its simulated time is kept, or None."""
        if not self._same_time or not isinstance(integrator, Replacement) or not integrator.scriptStep:
            return None
        if integrator not in self._clocks:
            self._clocks[integrator] = SharedClock(integrator.scriptStep, integrator._h)  # noqa: SLF001
        return self._clocks[integrator]

    def step(self, integrator: Any, steps: int, take: Callable[[int], None]) -> None:
        """Let an integrator take steps, and count them."""
        clock = self.clock(integrator)
        made = checks.whole(steps, "the number of steps", least=0)
        if clock is not None:
            made = clock.steps(made)
            if (system := self._systems.get(integrator)) is not None:
                self._divide_barostats(system, clock)  # which scripts add to a System that already has a Context
        take(made)
        time = made * integrator._h  # noqa: SLF001
        with self._counting:
            self.steps += made
            self.time += time
            self.forceEvaluations += made * integrator.forceEvaluationsPerStep
            self.openmmForceEvaluations += time / (integrator.scriptStep or integrator._h)  # noqa: SLF001

    def enter(self, system: openmm.System, integrators: Sequence[Replacement], alone: bool) -> None:
        """Prepare for a Context with integrators of this package, which are alone or parts of a CompoundIntegrator."""
        for integrator in integrators:
            if (clock := self.clock(integrator)) is None:
                continue
            if not alone:
                raise ValueError(
                    "the steps of a CompoundIntegrator cannot be divided: omit same_time (--same-time), or use its "
                    "integrators separately"
                )
            self._systems[integrator] = system
            self._divide_barostats(system, clock)

    def _divide_barostats(self, system: openmm.System, clock: SharedClock) -> None:
        """Let new barostats of a System act about as often in time as with the steps of the script."""
        seen, self._divided[system] = self._divided.get(system, 0), system.getNumForces()
        for force in [system.getForce(k) for k in range(seen, system.getNumForces())]:
            name = type(force).__name__
            if name in BAROSTATS and (every := int(frequency(force))):
                force.setFrequency(max(1, round(every / clock.ratio)))
                self.tell_once(
                    f"the {name} acts every {force.getFrequency()} steps instead of every {every} steps of the script"
                )

    def step_for(self, integrator: Any, size: float) -> float:
        """Return the step (ps) of an integrator to which the script gives a step."""
        if self.interval is None or not size:
            integrator.scriptStep = size
            return size
        if (clock := self.clock(integrator)) is not None:
            clock.change(size, self.interval, _steps_made(integrator))
            integrator.scriptStep = size
        elif abs(size / self.interval - 1.0) > _SAME:
            integrator.scriptStep = size
            if _steps_made(integrator):
                told = femtoseconds(size), femtoseconds(self.interval)
                self.tell_once(f"setStepSize({told[0]}) has no effect, because the interval of all steps is {told[1]}")
        return self.interval

    def lines(self) -> Iterator[str]:
        """Yield what was replaced and what not, in sentences."""
        if self.integrators:
            kinds = " and ".join(f"{count} {name}" for name, count in self.integrators.items())
            gain = (
                f" of {self.time:.6g} ps together, with {self.forceEvaluations} force evaluations; OpenMM's "
                f"integrators, at the steps of the script, need {self.openmmForceEvaluations:.0f} for this time, "
                f"{self.gain:.1f} times as many"
            )
            yield f"replaced {kinds}, which made {self.steps} steps{gain * (self.steps > 0)}"
        else:
            yield "no integrator was replaced"
        for name, count in self.others.items():
            yield f"not replaced: {name} ({count} Context{'s' * (count > 1)})"


def _steps_made(integrator: Any) -> int:
    """Return the number of steps in the Context of an integrator, or 0 if it has none."""
    with contextlib.suppress(ValueError):
        return int(integrator._found().getStepCount())  # noqa: SLF001
    return 0
