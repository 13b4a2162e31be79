"""Numbers that no body can have: noticed in the step that makes them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.state import BodyState, State

_T = TypeVar("_T")

#: The speed of light in nm/ps. A body above it is not finite in any useful sense.
LIGHT = 299_792.458
# When the squares of the momenta are this many times those of a state that was found good, the energy is looked at.
_GROWN = 1.5
# More energy than this part of the kinetic energy cannot come from the errors of a run that follows its equations.
_GAINED = 0.5
# kJ/mol of kinetic energy in the mean of bodies with bonds between them: bonds break with a fifth of it.
_HOTTEST = 2500.0
# What single precision may leave of an energy, and kJ/mol per body that say nothing: a start at rest has less.
_ROUNDED, _NOTHING = 1e-4, 1e-6
# What sums in another order may leave of the energy of the same places.
_STEADY = 1e-5


class NonFiniteError(ArithmeticError):
    """A run has blown up: infinite numbers, or energy from nowhere; the Context keeps the last good step."""


class Guard:
    """Looks at the states of a run.

    Parameters
    ----------
    bodies : RigidBodies
    potential : callable
        potential(state) -> float, the potential energy in kJ/mol. It is called only when momenta have grown much.
    at_time : callable, optional
        at_time(state, time) -> the same at another time (ps) than the present one, for forces that look at it.
    box : callable, optional
        box() -> the vectors (3, 3) of the periodic box in nm, or None: what is close may be so across its sides.
    """

    def __init__(
        self,
        bodies: RigidBodies,
        potential: Callable[[State], float],
        at_time: Callable[[State, float], float] | None = None,
        box: Callable[[], NDArray[np.float64] | None] = lambda: None,
    ) -> None:
        self._bodies, self._potential, self._at_time, self._box = bodies, potential, at_time, box
        self._fastest = float(np.min(LIGHT * bodies.mass, initial=np.inf)) ** 2  # no body is, below this sum of P²
        self._good = (0.0, 0.0)
        self._at = (0, 0.0)
        self._before: State | None = None
        self._since: State | None = None
        self._since_time = 0.0

    def begin(self, state: State, kT: float = 0.0, time: float = 0.0) -> None:
        """Take a state at a time (ps) for good, from which the energy is kept.

        A bath of kT (kJ/mol) may bring momenta up to its own: those of the canonical distribution up to
        `canonical_most`.
        """
        bodies = self._bodies
        most = canonical_most(kT, 3.0 * len(bodies))
        _, P, _, m = _squares(state)
        self._good = max(P, most * float(bodies.mass.max())), max(m, most * float(bodies.inertia.max()))
        self._since, self._since_time = state, time

    def enter(self, step: int, time: float, state: State, *, anew: bool = False) -> None:
        """Note the number of a step, the time (ps) and the state before it; `anew` if others changed its energy."""
        self._at, self._before = (step, time), state
        if anew:
            self._since, self._since_time = state, time

    def finite(self, flow: Callable[[State, _T], State]) -> Callable[[State, _T], State]:
        """Return a flow that raises NonFiniteError where its result is not fit for OpenMM.

        Squares are looked at, because finite numbers of 1e200 are as useless; places too, because the forces between
        infinite ones may vanish; and speeds, because bodies that were thrown apart may never meet again.
        """

        def guarded(state: State, tau: _T) -> State:
            after = flow(state, tau)
            self._measured(after)
            return after

        return guarded

    def bearable(self, bodies: RigidBodies, flow: Flow[State]) -> Flow[State]:
        """Return a flow of some bodies that raises NonFiniteError where they are far too hot for any molecule.

        Nested steps need it, of which a drift has thousands where it is far too long.
        """
        most, of_mass, of_inertia = 2.0 * _HOTTEST * len(bodies), 1.0 / bodies.mass, 1.0 / bodies.inertia.T

        def guarded(state: State, tau: float) -> State:
            after = flow(state, tau)
            P, m = after.P[0], after.m[0]
            twice = float((P * P).sum(axis=0) @ of_mass) + float((m * m * of_inertia).sum())
            if not twice <= most:
                raise NonFiniteError(self._complaint(f"{twice / most * _HOTTEST:.3g} kJ/mol in each body", after))
            return after

        return guarded

    def outside(self, flow: Flow[State]) -> Flow[State]:
        """Return a flow whose energy is not held against a step: that of a bath."""

        def allowed(state: State, tau: float) -> State:
            self._before = self._since = flow(self.leave(state), tau)
            self._since_time = self._at[1]
            return self._since

        return allowed

    def leave(self, state: State) -> State:
        """Return the state at the end of a step, or raise NonFiniteError if it was a bad one."""
        _, P, _, m = self._measured(state)
        if not grown((P, m), self._good):
            return state
        assert self._since is not None
        gain = self._gain(self._since, state)
        if gain and self._look_at_time((self._since, state)):  # then energy is kept within a step alone
            assert self._before is not None
            gain = self._gain(self._before, state)
        if gain:
            raise NonFiniteError(self._complaint(gain, state))
        self._good = max(P, self._good[0]), max(m, self._good[1])
        return state

    def _gain(self, then: State, now: State) -> str | None:
        return gained(len(self._bodies), self._energies(then), self._energies(now))

    def _look_at_time(self, states: Sequence[State]) -> bool:
        """Tell whether places of states have had other potential energies since the energy is kept."""
        if self._at_time is None:
            return False
        times, n = instants(self._since_time, self._at[1]), len(self._bodies)
        return any(differ([self._potential(s), *(self._at_time(s, t) for t in times)], n) for s in states)

    def _energies(self, state: State) -> tuple[float, float]:
        """Return the kinetic and the total energy."""
        kinetic = sum(self._bodies.kinetic_energies(state.rounded))
        return kinetic, kinetic + self._potential(state)

    def _measured(self, state: State) -> tuple[float, float, float, float]:
        R, P, q, m = squares = _squares(state)
        if not np.isfinite(R + P + q + m) or (self._fastest < P and lost(self._bodies, state.rounded).any()):
            bad = np.flatnonzero(lost(self._bodies, state.rounded))
            names = "; ".join(self._bodies.name(int(b)) for b in bad[:3])
            more = f" and {len(bad) - 3} more" if len(bad) > 3 else ""
            raise NonFiniteError(self._complaint(f"not finite or faster than light: {names}{more}", state))
        return squares

    def _complaint(self, what: str, state: State) -> str:
        number, time = self._at
        closest = ""
        if self._before is not None and len(self._bodies) > 1:
            closest = f"The closest before it were {closest_pair(self._before.rounded, self._box())}. "
        return f"step {number}, after {time:.6g} ps: {what}. {closest}{advice('step')}"


def canonical_most(kT: float, freedom: float) -> float:
    """Return what twice a kinetic energy at kT (kJ/mol) never is: eight of its widths and forty kT above its mean."""
    return kT * (freedom + 8.0 * math.sqrt(2.0 * freedom) + 40.0)


def grown(sizes: Sequence[float], good: Sequence[float]) -> bool:
    """Tell whether the energy is to be looked at: numbers that go with the kinetic energy grew beyond good ones."""
    return any(size > _GROWN * known for size, known in zip(sizes, good, strict=True))


def gained(n_bodies: int, then: tuple[float, float], now: tuple[float, float]) -> str | None:
    """Say that energy came from nowhere between two instants, or return None.

    Parameters
    ----------
    n_bodies : int
    then, now : (float, float)
        The kinetic and the total energy in kJ/mol.
    """
    (kinetic_then, energy_then), (kinetic, energy) = then, now
    gain = energy - energy_then
    noise = _ROUNDED * (abs(energy) + abs(energy_then)) + _NOTHING * n_bodies
    if gain <= _GAINED * kinetic + noise:
        return None
    return (
        f"the kinetic energy rose from {kinetic_then:.3g} to {kinetic:.3g} kJ/mol, and the total energy by "
        f"{gain:.3g} kJ/mol, which no force did"
    )


def instants(since: float, now: float) -> tuple[float, ...]:
    """Return times (ps) before the present one, at which forces that look at the time have other energies.

    A period that has them all at one phase is far shorter than they are apart.
    """
    return tuple(since + part * (now - since) for part in (0.0, 0.381966, 0.723607))


def differ(energies: Sequence[float], n_bodies: int) -> bool:
    """Tell whether energies (kJ/mol) of the same places differ by more than their rounding."""
    least, most = min(energies), max(energies)
    return not most - least <= _STEADY * (abs(least) + abs(most)) + _NOTHING * n_bodies


def advice(unit: str) -> str:
    """Say what the Context holds after a bad step or call, and what to do."""
    return (
        f"The Context keeps the state before this {unit}: take a smaller step size (numbers without a unit are ps), "
        "or minimise the energy first"
    )


def _squares(state: State) -> tuple[float, float, float, float]:
    return _square(state.R[0]), _square(state.P[0]), _square(state.q[0]), _square(state.m[0])


def _square(x: NDArray[np.float64]) -> float:
    """Return the sum of all squares; not by BLAS, whose threads cost milliseconds where others use the processor."""
    return float(np.einsum("ij,ij", x, x))


def lost(bodies: RigidBodies, state: BodyState) -> NDArray[np.bool_]:
    """Tell which bodies have numbers without finite squares, or are faster than light, (N,)."""
    found = np.asarray(~np.isfinite(state.R * state.R).all(axis=0))
    found |= ~((state.P * state.P).sum(axis=0) <= (LIGHT * bodies.mass) ** 2)  # so that nan is lost
    for x in (state.q, state.m):
        found[: bodies.n_turning] |= ~np.isfinite(x * x).all(axis=0)
    return found


def closest_pair(state: BodyState, box: NDArray[np.float64] | None = None) -> str:
    """Name the two bodies whose centres are closest, across the sides of a periodic box (3, 3) too."""
    from scipy.spatial import cKDTree  # here, for a short import of the package

    R, images = state.R.T, np.zeros((1, 3))
    if box is not None:
        R = R - np.floor(R @ np.linalg.inv(box)) @ box
        images = np.array(list(itertools.product((0.0, 1.0, -1.0), repeat=3))) @ box
    places = (R + images[:, None]).reshape(-1, 3)
    distances, neighbours = map(np.asarray, cKDTree(places).query(R, k=2))
    body = int(np.argmin(distances[:, 1]))
    other = next((int(k) for k in neighbours[body] % len(R) if k != body), body)  # or an image of its own
    return f"the bodies {min(body, other)} and {max(body, other)}, {distances[body, 1]:.3g} nm apart"
