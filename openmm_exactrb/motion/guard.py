"""Numbers that no body can have: noticed in the step that makes them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.state import BodyState, State

#: The speed of light in nm/ps. A body above it is not finite in any useful sense.
LIGHT = 299_792.458
# When the squares of the momenta are this many times those of a state that was found good, the energy is looked at.
_GROWN = 4.0
# A step that adds more energy than this part of the kinetic energy behind it has left the solution.
_GAINED = 0.5


class NonFiniteError(ArithmeticError):
    """A run has blown up: infinite numbers, or energy from nowhere; the Context keeps the last good step."""


class Guard:
    """Looks at the states of a run.

    Parameters
    ----------
    bodies : RigidBodies
    potential : callable
        potential(state) -> float, the potential energy in kJ/mol. It is called only when momenta have grown much.
    """

    def __init__(self, bodies: RigidBodies, potential: Callable[[State], float]) -> None:
        self._bodies, self._potential = bodies, potential
        self._fastest = float(np.min(LIGHT * bodies.mass, initial=np.inf)) ** 2  # no body is, below this sum of P²
        self._good = (0.0, 0.0)
        self._at = (0, 0.0)
        self._before: State | None = None

    def begin(self, state: State, kT: float = 0.0) -> None:
        """Take a state for good; with a bath, momenta may grow to those of kT (kJ/mol) anyway."""
        _, P, _, m = _squares(state)
        inertia = np.broadcast_to(self._bodies.inertia, state.m.shape[:0:-1])
        self._good = max(P, 3.0 * kT * float(self._bodies.mass.sum())), max(m, kT * float(inertia.sum()))

    def enter(self, step: int, time: float, state: State) -> None:
        """Note the number of a step, the time (ps) and the state before it."""
        self._at, self._before = (step, time), state

    def finite(self, flow: Flow[State]) -> Flow[State]:
        """Return a flow that raises NonFiniteError where its result is not fit for OpenMM.

        Squares are looked at, because finite numbers of 1e200 are as useless; places too, because the forces between
        infinite ones may vanish; and speeds, because bodies that were thrown apart may never meet again.
        """

        def guarded(state: State, tau: float) -> State:
            after = flow(state, tau)
            self._measured(after)
            return after

        return guarded

    def outside(self, flow: Flow[State]) -> Flow[State]:
        """Return a flow whose energy is not held against a step: that of a bath."""

        def allowed(state: State, tau: float) -> State:
            self._before = flow(self.leave(state), tau)
            return self._before

        return allowed

    def leave(self, state: State) -> State:
        """Return the state at the end of a step, or raise NonFiniteError if it was a bad one."""
        _, P, _, m = self._measured(state)
        if max(P - _GROWN * self._good[0], m - _GROWN * self._good[1]) <= 0.0:
            return state
        assert self._before is not None
        energies = [(sum(self._bodies.kinetic_energies(s.rounded)), self._potential(s)) for s in (self._before, state)]
        (kinetic_before, potential_before), (kinetic, potential) = energies
        gain = kinetic + potential - kinetic_before - potential_before
        if not gain <= _GAINED * kinetic and kinetic > _GROWN * kinetic_before:
            raise NonFiniteError(
                self._complaint(
                    f"the kinetic energy rose from {kinetic_before:.3g} to {kinetic:.3g} kJ/mol, and "
                    f"{gain:.3g} kJ/mol of it came from nowhere",
                    state,
                )
            )
        self._good = max(P, self._good[0]), max(m, self._good[1])
        return state

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
            pair, distance = closest_pair(self._before.rounded)
            closest = f"The closest before it were the bodies {pair[0]} and {pair[1]}, {distance:.3g} nm apart. "
        return (
            f"step {number}, after {time:.6g} ps: {what}. {closest}The Context keeps the state before this step: "
            "take a smaller step size, or minimise the energy first"
        )


def _squares(state: State) -> tuple[float, float, float, float]:
    R, P, q, m = (float(np.vdot(x[0], x[0])) for x in state)
    return R, P, q, m


def lost(bodies: RigidBodies, state: BodyState) -> NDArray[np.bool_]:
    """Tell which bodies have numbers without finite squares, or are faster than light, (N,)."""
    found = np.asarray(~np.isfinite(state.R * state.R).all(axis=0))
    found |= ~((state.P * state.P).sum(axis=0) <= (LIGHT * bodies.mass) ** 2)  # so that nan is lost
    for x in (state.q, state.m):
        found[: bodies.n_turning] |= ~np.isfinite(x * x).all(axis=0)
    return found


def closest_pair(state: BodyState) -> tuple[tuple[int, int], float]:
    """Return the two bodies whose centres are closest, and their distance in nm."""
    from scipy.spatial import cKDTree  # here, for a short import of the package

    distances, neighbours = map(np.asarray, cKDTree(state.R.T).query(state.R.T, k=2))
    body = int(np.argmin(distances[:, 1]))
    return (body, int(neighbours[body, 1])), float(distances[body, 1])
