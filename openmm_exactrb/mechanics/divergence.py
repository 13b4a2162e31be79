"""Divergence and overheating: unphysical states in the step that produces them, and temperatures that stay too high."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.images import closest_pair
from openmm_exactrb.mechanics.state import BodyState, State
from openmm_exactrb.support.types import Array
from openmm_exactrb.support.warn import warn

#: The speed of light in nm/ps: OpenMM need not be asked for forces on bodies that are faster.
LIGHT = 299_792.458
#: Energies are compared when the squares of momenta are this many times those of a state that was found good.
GROWN = 1.5
# A rise of the total energy by this part of the kinetic energy, before or after, is no integration error of a run that
# makes sense. A step of one long vibration may take most of its kinetic energy away.
_GAINED = 0.5
# kJ/mol of kinetic energy in the mean of bodies with bonds between them: bonds break with a fifth of it.
_HOTTEST = 2500.0
# Of more numbers, BLAS shares a sum among threads, which costs milliseconds where others use the processor.
_FEW = 10_000
# Rounding of energies in single precision, and kJ/mol per body that say nothing: a start at rest has less.
_ROUNDED, _NOTHING = 1e-4, 1e-6
#: What the Context holds after a step or call that diverged, and what to do.
ADVICE = (
    "The Context keeps the state before this {}: use a smaller step size (numbers without a unit are ps), or minimise "
    "the energy first"
)

# A mean over so many samples, each a relaxation time of the thermostat or more after the last one, and the times at the
# begin that are left out: heat of the start is gone after a few of them.
_SAMPLES, _LEFT_OUT = 100, 20
# Part by which the mean has to be too high, and by how many standard errors.
_TOO_HOT, _ERRORS = 0.05, 4.0


class IntegrationError(ArithmeticError):
    """A run has diverged: the step is too large, or bodies overlap at the start."""


class NonFiniteError(IntegrationError):
    """Positions, momenta or forces are not finite, or a body is faster than light."""


class StepSizeWarning(UserWarning):
    """A step is too long for correct averages: it is near a resonance, or the run is hotter than its thermostat."""


class DivergenceCheck:
    """Checks the states of a run for non-finite numbers and for a rise of the total energy.

    potential(state) -> kJ/mol is evaluated only if momenta have grown strongly; box() -> the vectors (3, 3) of the
    periodic box in nm, or None. Energies are compared if forces are known to conserve them and the user has not
    disabled the comparison.
    """

    def __init__(
        self,
        bodies: RigidBodies,
        potential: Callable[[State], float],
        box: Callable[[], Array | None] = lambda: None,
        conserves: bool = True,
    ) -> None:
        self._bodies, self._potential, self._box, self._conserves = bodies, potential, box, conserves
        self._fastest = float(np.min(LIGHT * bodies.mass, initial=np.inf)) ** 2  # no body is, below this sum of P²
        #: kJ/mol of kinetic energy in the mean of bodies within inner steps, beyond which a step has diverged.
        self.hottest = _HOTTEST if conserves else np.inf
        self._good = 0.0, 0.0  # squares of linear and angular momenta
        self._number, self._time = 0, 0.0
        self._before: State | None = None  # the step
        self._since: State | None = None  # from which energy is kept

    def begin(self, state: State) -> None:
        """Accept a state as valid."""
        self._good = _square(state.P), _square(state.m)

    def keep_from(self, state: State) -> None:
        """Compare later energies with that of a state."""
        self._since = state

    def enter(self, number: int, time: float, state: State) -> None:
        """Store the number of a step, and the time (ps) and the state before it."""
        self._number, self._time, self._before = number, time, state

    def finite(self, state: State) -> tuple[float, float]:
        """Return the squares of linear and angular momenta; raise NonFiniteError if OpenMM cannot evaluate forces."""
        if not _square(state.R) + _square(state.q) < np.inf:  # so that nan is not
            self._raise_if_lost(state)
        return self.finite_momenta(state)

    def finite_momenta(self, state: State) -> tuple[float, float]:
        """Return the squares of linear and angular momenta; raise NonFiniteError if bodies cannot move with them."""
        P, m = _square(state.P), _square(state.m)
        if not (self._fastest >= P and m < np.inf):
            self._raise_if_lost(state)
        return P, m

    def _raise_if_lost(self, state: State) -> None:
        """Raise NonFiniteError if the squares of a body are not finite, or a body is faster than light."""
        bad = np.flatnonzero(lost(self._bodies, state.rounded))
        if len(bad):
            names = "; ".join(self._bodies.name(int(b)) for b in bad[:3])
            more = f" and {len(bad) - 3} more" if len(bad) > 3 else ""
            raise NonFiniteError(self._message(f"not finite or faster than light: {names}{more}"))

    def of_inner_steps(self, bodies: RigidBodies) -> Callable[[State], None]:
        """Return a check of inner steps on selected bodies; a far too long outer step has thousands of them."""
        half_mass, half_inertia = 0.5 / bodies.mass, 0.5 / bodies.inertia.T

        def check(state: State) -> None:
            P, m = state.P[0], state.m[0]
            mean = float((P * P).sum(axis=0) @ half_mass + (m * m * half_inertia).sum()) / len(bodies)
            self.judge_inner_steps(mean)

        return check

    def judge_inner_steps(self, mean: float) -> None:
        """Raise IntegrationError if the energy of a body in inner steps exceeds that of the hottest ones, in kJ/mol."""
        if not mean <= self.hottest:  # so that nan is too hot
            raise IntegrationError(self._message(f"{mean:.3g} kJ/mol in each body within the inner steps"))

    def leave(self, state: State) -> None:
        """Raise IntegrationError if the state at the end of a step has diverged from that before it."""
        (P, m), (good_P, good_m) = self.finite(state), self._good
        if self._conserves and (GROWN * good_P < P or m > GROWN * good_m):
            assert self._since is not None
            if message := gained(len(self._bodies), self._energies(self._since), self._energies(state)):
                raise IntegrationError(self._message(message))
            self._good = max(P, good_P), max(m, good_m)

    def outside(self, state: State, after: State) -> None:
        """Check a state before a thermostat; energies are compared with the state after it."""
        if after is not state:
            self.leave(state)
            self._before = self._since = after

    def _energies(self, state: State) -> tuple[float, float]:
        """Return the kinetic and the total energy."""
        kinetic = sum(self._bodies.kinetic_energies(state.rounded))
        return kinetic, kinetic + self._potential(state)

    def _message(self, what: str) -> str:
        closest = ""
        if self._before is not None and len(self._bodies) > 1:
            closest = f"The closest before it were {closest_pair(self._before.rounded, self._box())}. "
        return f"step {self._number}, after {self._time:.6g} ps: {what}. {closest}{ADVICE.format('step')}"


def gained(n_bodies: int, then: tuple[float, float], now: tuple[float, float]) -> str | None:
    """Return a description of a jump between two pairs of kinetic and total energy (kJ/mol), or None."""
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
    """Return a mask (N,) of bodies whose squares are not finite, or that are faster than light."""
    which = np.asarray(~np.isfinite((state.R * state.R).sum(axis=0)))
    which |= ~((state.P * state.P).sum(axis=0) <= (LIGHT * bodies.mass) ** 2)  # so that nan is lost
    which[: bodies.n_turning] |= ~np.isfinite((state.q * state.q).sum(axis=0) + (state.m * state.m).sum(axis=0))
    return which


def _square(x: Array) -> float:
    """Return the sum of the squares of double-doubles, rounded."""
    high = x[0]
    if high.size < _FEW:
        return float(np.vdot(high, high))
    return float(np.einsum("ij,ij", high, high))


class Overheating:
    """Monitors the temperatures of a run with a thermostat, and warns once.

    Translation and rotation of rigid bodies, and all other particles, are monitored separately, because a solute may be
    hotter than its water. kT (kJ/mol) is that of the thermostat, and relaxation (ps) the time in which it removes heat.
    """

    def __init__(self, bodies: RigidBodies, kT: float, relaxation: float) -> None:
        self._bodies, self._kT, self._relaxation = bodies, kT, relaxation
        turning, others = bodies.n_turning, bodies.translational_freedom - 3 * bodies.n_turning
        self._freedom = np.array([3 * turning, bodies.rotational_freedom, others])
        self._told, self._since = False, 0.0
        self.begin(0.0)

    def begin(self, time: float) -> None:
        """Start a mean at the time (ps) at which the state was set."""
        self._next, self._sums, self._count = time + _LEFT_OUT * self._relaxation, np.zeros(3), 0

    def see(self, time: float, state: State) -> None:
        """Sample the state at a time (ps) if a sample is due, and issue a StepSizeWarning once."""
        if self._told or time < self._next:
            return
        if not self._count:
            self._since = time
        self._next = max(self._next + self._relaxation, time)
        self._sums += self._kinetic(state)
        self._count += 1
        if self._count == _SAMPLES:
            self._judge(time - self._since)
            self._sums, self._count = np.zeros(3), 0

    def _kinetic(self, state: State) -> list[float]:
        """Return the kinetic energies of translation and rotation of rigid bodies, and of other particles."""
        bodies, rounded = self._bodies, state.rounded
        P, turning = bodies.tangent(rounded).P, bodies.n_turning
        energies = 0.5 * (P * P).sum(axis=0) / bodies.mass
        rotation = 0.5 * float((rounded.m * rounded.m / bodies.inertia.T).sum())
        return [float(energies[:turning].sum()), rotation, float(energies[turning:].sum())]

    def _judge(self, duration: float) -> None:
        names = "translation of rigid bodies", "rotation of rigid bodies", "particles outside rigid bodies"
        for name, total, freedom in zip(names, self._sums / _SAMPLES, self._freedom, strict=True):
            if not freedom or not self._kT:
                continue
            excess = 2.0 * total / (freedom * self._kT) - 1.0
            if excess > _TOO_HOT + _ERRORS * math.sqrt(2.0 / (freedom * _SAMPLES)):
                self._told = True
                warn(
                    f"the temperature of the {name} is {100.0 * excess:.0f} % above that of the thermostat, "
                    f"averaged over {duration:.3g} ps, which its friction does not explain: use a "
                    "smaller step size, or more friction",
                    StepSizeWarning,
                )
                return
