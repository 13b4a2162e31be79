"""Detection of unphysical states, in the step that produces them, and of temperatures that stay too high."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.errors import IntegrationError, NonFiniteError, StepSizeWarning
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.images import closest_pair
from openmm_exactrb.mechanics.state import BodyState, State
from openmm_exactrb.support.types import Array
from openmm_exactrb.support.warn import warn

#: The speed of light in nm/ps. Forces are not evaluated if a body is faster.
LIGHT = 299_792.458
#: Energies are compared if the sum of squared momenta exceeds its largest accepted value by more than this factor.
GROWN = 1.5
# A run has diverged if the total energy rises by more than this fraction of the kinetic energy before or after the
# step, whichever is larger. A long step may remove most of the kinetic energy of a vibration.
_GAINED = 0.5
#: Largest mean kinetic energy of bonded bodies in kJ/mol. A fifth of this energy breaks a bond.
HOTTEST = 2500.0
# BLAS distributes sums of more than this many numbers over threads, which costs milliseconds on a busy processor.
_FEW = 10_000
# Relative rounding error of energies in single precision, and the energy in kJ/mol per body below which a rise is
# insignificant, even for a run that starts at rest.
_ROUNDED, _NOTHING = 1e-4, 1e-6
# The largest number of invalid bodies that an error message names, and the number of bodies whose names are searched.
_NAMED, _SEARCHED = 3, 60
#: What the Context holds after a step that diverged, and what to do.
ADVICE = (
    "The Context keeps the state before this step: use a smaller step size (numbers without a unit are in ps), or "
    "minimise the energy first"
)

# Number of samples in a mean, at least one relaxation time of the thermostat apart, and number of relaxation times
# omitted at the start. A few relaxation times suffice to remove the initial heat.
_SAMPLES, _LEFT_OUT = 100, 20
# A warning requires a mean that is too high by this fraction plus this number of standard errors.
_TOO_HOT, _ERRORS = 0.05, 4.0


class DivergenceCheck:
    """Checks the states of a run for non-finite numbers and for a rise of the total energy.

    `potential` is a function that returns the potential energy (kJ/mol) of a state. The function is called only if
    squared momenta have grown by the factor `GROWN`. `box` is a function that returns the vectors (3, 3) of the
    periodic box in nm, or None. `conserves` states whether energies are compared, which requires that forces are known
    to conserve energy and that the user has not disabled the comparison.
    """

    def __init__(
        self,
        bodies: RigidBodies,
        potential: Callable[[State], float],
        box: Callable[[], Array | None] = lambda: None,
        conserves: bool = True,
    ) -> None:
        self._bodies, self._potential, self._box, self._conserves = bodies, potential, box, conserves
        self._fastest = float(np.min(LIGHT * bodies.mass, initial=np.inf)) ** 2  # if P² is smaller, no body is too fast
        #: Mean kinetic energy of bodies within inner steps, in kJ/mol, above which a step has diverged.
        self.hottest = HOTTEST if conserves else np.inf
        self._good = 0.0, 0.0  # squares of linear and angular momenta
        self._number, self._time = 0, 0.0
        self._before: State | None = None  # the state before the step
        self._since: State | None = None  # the state whose energy is the reference

    def begin(self, state: State) -> None:
        """Accept a state as valid."""
        self._good = _square(state.P), _square(state.m)

    def keep_from(self, state: State) -> None:
        """Store the state with whose energy later energies are compared."""
        self._since = state

    def enter(self, number: int, time: float, state: State) -> None:
        """Store the number of a step, and the time (ps) and the state before it."""
        self._number, self._time, self._before = number, time, state

    def finite(self, state: State) -> tuple[float, float]:
        """Return the sums of squared linear and angular momenta; raise NonFiniteError if forces cannot be evaluated."""
        if not _square(state.R) + _square(state.q) < np.inf:  # also true for nan
            self._raise_if_lost(state)
        return self.finite_momenta(state)

    def finite_momenta(self, state: State) -> tuple[float, float]:
        """Return the sums of squared linear and angular momenta; raise NonFiniteError if bodies cannot move."""
        P, m = _square(state.P), _square(state.m)
        if not (self._fastest >= P and m < np.inf):
            self._raise_if_lost(state)
        return P, m

    def _raise_if_lost(self, state: State) -> None:
        """Raise NonFiniteError with the names of the bodies that `lost` selects, if there are any."""
        if message := non_finite(self._bodies, state):
            raise NonFiniteError(self._message(message))

    def of_inner_steps(self, bodies: RigidBodies) -> Callable[[State], None]:
        """Return a check of selected bodies after inner steps.

        Without this check, a divergence would be detected only at the end of the outer step, which has thousands of
        inner steps if it is far too long.
        """
        half_mass, half_inertia = 0.5 / bodies.mass, 0.5 / bodies.inertia.T

        def check(state: State) -> None:
            P, m = state.P[0], state.m[0]
            mean = float((P * P).sum(axis=0) @ half_mass + (m * m * half_inertia).sum()) / len(bodies)
            if not mean <= self.hottest:  # also true for nan
                raise IntegrationError(
                    self._message(f"the mean kinetic energy in the inner steps is {mean:.3g} kJ/mol per body")
                )

        return check

    def leave(self, state: State) -> None:
        """Raise IntegrationError if the state at the end of a step shows that the run has diverged."""
        (P, m), (good_P, good_m) = self.finite(state), self._good
        if self._conserves and (GROWN * good_P < P or m > GROWN * good_m):
            assert self._since is not None
            if message := gained(len(self._bodies), self._energies(self._since), self._energies(state)):
                raise IntegrationError(self._message(message))
            self._good = max(P, good_P), max(m, good_m)

    def outside(self, state: State, after: State) -> None:
        """Check the state before a thermostat acts; the energy of the state `after` becomes the reference."""
        if after is not state:
            self.leave(state)
            self._before = self._since = after

    def _energies(self, state: State) -> tuple[float, float]:
        """Return the kinetic and the total energy."""
        kinetic = sum(self._bodies.kinetic_energies(state.rounded))
        return kinetic, kinetic + self._potential(state)

    def _message(self, what: str) -> str:
        return of_step(self._number, self._time, what, self._before, self._box())


def of_step(number: int, time: float, what: str, before: State | None, box: Array | None) -> str:
    """Return the message about a step that diverged, with the time (ps) and the state `before` it."""
    closest = ""
    if before is not None and before.R.shape[2] > 1:
        closest = f"The closest before the step were {closest_pair(before.rounded, box)}. "
    return f"step {number}, after {time:.6g} ps: {what}. {closest}{ADVICE}"


def non_finite(bodies: RigidBodies, state: State) -> str | None:
    """Return a description of the bodies that `lost` selects, or None if there are none."""
    bad = np.flatnonzero(lost(bodies, state.rounded))
    if not len(bad):
        return None
    names = list(dict.fromkeys(map(bodies.name, bad[:_SEARCHED].tolist())))  # the atoms of a cluster have one name
    more = f" and {len(bad) - _NAMED} more" if len(bad) > _NAMED else ""
    return (
        "positions or momenta became non-finite, or speeds exceeded the speed of light (bodies affected: "
        f"{len(bad)}): {'; '.join(names[:_NAMED])}{more}"
    )


def gained(n_bodies: int, then: tuple[float, float], now: tuple[float, float]) -> str | None:
    """Return a description of a jump of the total energy, or None if there is no jump.

    `then` and `now` are pairs of kinetic and total energy in kJ/mol.
    """
    (kinetic_then, energy_then), (kinetic, energy) = then, now
    gain = energy - energy_then
    noise = _ROUNDED * (abs(energy) + abs(energy_then)) + _NOTHING * n_bodies
    if gain < np.inf and gain <= _GAINED * max(kinetic, kinetic_then) + noise:
        return None
    return (
        f"the kinetic energy rose from {kinetic_then:.3g} to {kinetic:.3g} kJ/mol and the total energy by {gain:.3g} "
        "kJ/mol, which no force supplied"
    )


def lost(bodies: RigidBodies, state: BodyState) -> NDArray[np.bool_]:
    """Return a mask (N,) of bodies that are faster than light or have non-finite squares of coordinates or momenta."""
    with np.errstate(all="ignore"):
        which = np.asarray(~np.isfinite((state.R * state.R).sum(axis=0)))
        which |= ~((state.P * state.P).sum(axis=0) <= (LIGHT * bodies.mass) ** 2)  # also true for nan
        which[: bodies.n_turning] |= ~np.isfinite((state.q * state.q).sum(axis=0) + (state.m * state.m).sum(axis=0))
    return which


def _square(x: Array) -> float:
    """Return the sum of the squares of double-doubles (2, k, N), rounded to float64."""
    high = x[0]
    if high.size < _FEW:
        return float(np.vdot(high, high))
    return float(np.einsum("ij,ij", high, high))


class Overheating:
    """Monitors the temperatures of a run with a thermostat, and warns once.

    The translation of rigid bodies, their rotation, and all other particles are monitored separately, because a solute
    may be hotter than its water. `freedom` contains their degrees of freedom. `kT` (kJ/mol) and `relaxation` (ps) are
    the thermal energy and the relaxation time of the thermostat.
    """

    def __init__(self, freedom: tuple[int, int, int], kT: float, relaxation: float) -> None:
        self._freedom, self._kT, self._relaxation = freedom, kT, relaxation
        self._told, self._since = False, 0.0
        self.begin(0.0)

    def begin(self, time: float) -> None:
        """Start a new mean at the time (ps) at which the state was set."""
        self._next, self._sums, self._count = time + _LEFT_OUT * self._relaxation, np.zeros(3), 0

    def see(self, time: float, kinetic: Callable[[], Sequence[float] | Array]) -> None:
        """Sample the kinetic energies (kJ/mol) at a time (ps) if a sample is due; issue at most one StepSizeWarning."""
        if self._told or time < self._next:
            return
        if not self._count:
            self._since = time
        self._next = max(self._next + self._relaxation, time)
        self._sums += kinetic()
        self._count += 1
        if self._count == _SAMPLES:
            self._judge(time - self._since)
            self._sums, self._count = np.zeros(3), 0

    def _judge(self, duration: float) -> None:
        names = "translation of rigid bodies", "rotation of rigid bodies", "particles outside rigid bodies"
        for name, total, freedom in zip(names, self._sums / _SAMPLES, self._freedom, strict=True):
            if not freedom or not self._kT:
                continue
            excess = 2.0 * total / (freedom * self._kT) - 1.0
            if excess > _TOO_HOT + _ERRORS * math.sqrt(2.0 / (freedom * _SAMPLES)):
                self._told = True
                warn(
                    f"averaged over {duration:.3g} ps, the temperature of the {name} is {100.0 * excess:.0f} % above "
                    "that of the thermostat, more than statistical errors explain: use a smaller step size, or a "
                    "higher friction",
                    StepSizeWarning,
                )
                return


def freedom_by_kind(bodies: RigidBodies) -> tuple[int, int, int]:
    """Return the degrees of freedom of translation and rotation of rigid bodies, and of other particles."""
    turning = 3 * bodies.n_turning
    return turning, bodies.rotational_freedom, bodies.translational_freedom - turning


def kinetic_by_kind(bodies: RigidBodies, state: State) -> tuple[float, float, float]:
    """Return the kinetic energies (kJ/mol) of translation and rotation of rigid bodies, and of other particles."""
    rounded, turning = state.rounded, bodies.n_turning
    P = bodies.tangent(rounded).P
    energies = 0.5 * (P * P).sum(axis=0) / bodies.mass
    rotation = 0.5 * float((rounded.m * rounded.m / bodies.inertia.T).sum())
    return float(energies[:turning].sum()), rotation, float(energies[turning:].sum())
