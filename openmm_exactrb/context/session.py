"""The bodies of one Context and their state: what a user changed is taken up, what a step made is published."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context import arrays, ledger
from openmm_exactrb.context.find import find_bodies
from openmm_exactrb.motion.bodies import Indices, RigidBodies
from openmm_exactrb.motion.fit import fit, refit
from openmm_exactrb.motion.images import rejoined
from openmm_exactrb.motion.state import BodyState, State

Array = NDArray[np.float64]

# Positions (nm) and velocities (nm/ps) closer than this to those of the stored bodies are theirs: an integrator that
# finds its Context changed by less goes on from the full float64 state.
_SAME = 1e-9


class Session:
    """The bodies of a Context and their state.

    Holds no strong reference to the Context and its integrator, which own this.

    Parameters
    ----------
    context : openmm.Context
        With positions; `take_up` reads them.
    integrator : openmm.CustomIntegrator
        In whose variables the full state is kept.
    named : sequence of sequences of int, optional
        Particles of bodies beside those that constraints make.

    Raises
    ------
    ValueError
        If there are no positions, nothing can move, bodies cannot be served, or positions do not fit them.
    """

    def __init__(
        self, context: openmm.Context, integrator: openmm.CustomIntegrator, named: Sequence[Sequence[int]] | None
    ) -> None:
        x, v = _positions_and_velocities(context)
        if len(x) > 1 and not x.any():
            raise ValueError("the Context has no positions yet: call setPositions first")
        self._context, self._integrator = weakref.ref(context), weakref.ref(integrator)
        self.bodies = find_bodies(context.getSystem(), x, named, _box(context))
        self._x, self._v = x.copy(), v.copy()  # what is handed to OpenMM
        self._seen: tuple[Array, Array] | None = None  # what the Context held when `state` was last in it
        self.state: State
        self._outdated = False
        #: Called when a user has set a State or a step count.
        self.taken_elsewhere: Callable[[], None] = lambda: None
        _watch(context, "reinitialize", self._outlive)
        for name in ("setState", "setStepCount"):
            _watch(context, name, lambda: self.taken_elsewhere())

    @property
    def context(self) -> Any:
        """The Context, or None when it is gone."""
        return self._context()

    @property
    def outdated(self) -> bool:
        """Whether the Context is gone, or was reinitialised since: masses, constraints and forces may be others."""
        return self.context is None or self._outdated

    def _outlive(self) -> None:
        self._outdated = True

    @property
    def particles(self) -> Array:
        """Positions of all particles (nm), to be overwritten with those of the bodies."""
        return self._x

    def take_up(self) -> None:
        """Bring the state up to date with what was set in the Context since it was published.

        Positions that were not quite rigid, or split by the periodic box, are put right in the Context too.

        Raises
        ------
        ValueError
            If that is not finite, or no rigid bodies. The state stays what it was.
        """
        x, v = self.held()
        if self._seen is None or not all(map(np.array_equal, self._seen, (x, v))):
            known, whole = self.stored(x), self._joined(x)
            self.state = State.of(fit(self.bodies, whole, v)) if known is None else self.compared(known, whole, v)
            self._x[:], self._v[:] = x, v  # particles without mass that are no virtual sites stay where they are
            self._seen = (x, v)
            if len(_differs(self.bodies, x, self.bodies.positions(self.state.rounded, self._x))):
                self.publish()

    def _joined(self, x: Array) -> Array:
        """Return positions without what the periodic box split."""
        box = self.box()
        return x if box is None else rejoined(x, self.bodies, box)

    def box(self) -> Array | None:
        """Return the vectors (3, 3) of the periodic box in nm, or None without one."""
        return _box(self.context)

    def compared(self, known: State, x: Array, v: Array) -> State:
        """Return a known state, but for the bodies whose particles are not where it says."""
        rounded = known.rounded
        moved = _differs(self.bodies, x, self.bodies.positions(rounded, x.copy()))
        pushed = _differs(self.bodies, v, self.bodies.velocities(rounded, v.copy()))
        if not len(moved) and not len(pushed):
            return known
        return known.renewed(refit(self.bodies, rounded, x, v, moved, pushed))

    def publish(self) -> None:
        """Write the state into the Context, as particles and in full."""
        self.context.setPositions(self.bodies.positions(self.state.rounded, self._x))
        self.write_velocities(self.state)
        self.context.computeVirtualSites()
        self.store()
        self._seen = self.held()

    def stored(self, x: Array) -> State | None:
        """Return the state that the integrator's variables hold, if any; positions x are those of the Context."""
        return ledger.read(self._integrator(), self.bodies)

    def store(self) -> None:
        """Write the state to the integrator's variables."""
        ledger.write(self._integrator(), self.bodies, self.state)

    def write_velocities(self, state: State) -> None:
        """Write the velocities of the particles into the Context."""
        self.context.setVelocities(self.bodies.velocities(state.rounded, self._v))

    def held(self) -> tuple[Array, Array]:
        """Return positions (nm) and velocities (nm/ps) of all particles, as the Context has them."""
        return _positions_and_velocities(self.context)

    def replace(self, rounded: BodyState) -> None:
        """Give the bodies another state and publish it."""
        self.state = self.state.renewed(rounded)
        self.publish()


def _positions_and_velocities(context: openmm.Context) -> tuple[Array, Array]:
    """Return positions (nm) and velocities (nm/ps) of all particles."""
    state = context.getState(positions=True, velocities=True)
    return arrays.positions(state), arrays.velocities(state)


def _box(context: openmm.Context) -> Array | None:
    """Return the vectors of the periodic box in nm, or None where there is none."""
    if not context.getSystem().usesPeriodicBoundaryConditions():
        return None
    return np.reshape(arrays.box(context.getState()), (3, 3))


def _differs(bodies: RigidBodies, actual: Array, expected: Array) -> Indices:
    """Return the bodies with a particle that is not where it is expected; nan differs."""
    different = np.zeros(len(bodies), dtype=bool)
    for kind in bodies.kinds:
        offset = np.abs(actual[kind.particles] - expected[kind.particles])
        different[kind.bodies] = ~(offset.max(axis=(1, 2)) <= _SAME)
    return np.flatnonzero(different)


def _watch(context: openmm.Context, name: str, notice: Callable[[], None]) -> None:
    """Have it noticed when a method of the Context was called, since OpenMM does not tell."""
    method = getattr(type(context), name)
    reference = weakref.ref(context)

    @functools.wraps(method)
    def noticing(*arguments: Any, **options: Any) -> None:
        try:
            method(reference(), *arguments, **options)
        finally:
            notice()

    setattr(context, name, noticing)
