"""Synchronisation of bodies with their Context: a user's changes are pulled, and the results of steps are pushed."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context import variables
from openmm_exactrb.context.inner import Inner, has_saved_forces, save_forces
from openmm_exactrb.context.outside_forces import reports_changes
from openmm_exactrb.context.watch import watch
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.mathematics.compensated import add
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.fit import fit, off_constraints, refit
from openmm_exactrb.mechanics.images import Shapes
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.support.types import Array, Indices

# Mixed precision rounds the positions (nm) and velocities (nm/ps) of the Context. A saved state is restored in full
# precision if the values in the Context differ from the saved values by at most _SAME plus _SAME_PART times the value.
_SAME, _SAME_PART = 1e-13, 3e-14
# Particles farther than this distance (nm) from their rigid-body positions are also moved in the Context.
_RIGID = 1e-9
# An inner state is kept if a user changes centres (nm), orientations, velocities (nm/ps) and angular velocities (1/ps)
# by at most this number.
_SMALL = 1e-8
# Negative coordinates of at most this size (nm), which are roundoff, are set to zero, because in a periodic box
# OpenMM's Reference platform would miss pairs of such particles.
_LOST = 1e-14


class Positions:
    """The positions of bodies in a Context, which only this object writes, and the version of what forces depend on.

    The object does not keep the Context alive. Every change of positions, box or parameters increases `version`, so
    that results of earlier versions are recomputed. Which positions the Context contains is known from the arrays of
    the state that was written last, because flows return new arrays for positions that they change. The array x
    (n_particles, 3) contains the positions of all particles. In this array, `placed` replaces the positions of
    particles in bodies.
    """

    def __init__(self, context: Any, bodies: RigidBodies, x: Array) -> None:
        self._context, self.bodies, self.particles = weakref.ref(context), bodies, x
        self.version = 0
        self._written: tuple[Array, Array] | None = None  # R and q of the bodies in the Context, if known
        periodic = context.getSystem().usesPeriodicBoundaryConditions()
        self._loses_pairs = periodic and context.getPlatform().getName() == "Reference"

    @property
    def context(self) -> Any:
        """The Context."""
        return self._context()

    def write(self, state: State) -> None:
        """Write the positions of any state into the Context, unless they are there already."""
        if self._written is not None and state.R is self._written[0] and state.q is self._written[1]:
            return
        self._written = None
        context, x = self.context, self.placed(state)
        if self._loses_pairs:
            x[(x < 0.0) & (x > -_LOST)] = 0.0
        context.setPositions(x)
        context.computeVirtualSites()
        self._written = state.R, state.q

    def placed(self, state: State) -> Array:
        """Return the positions (n_particles, 3) for any state of the bodies; virtual sites are not moved."""
        return self.bodies.positions(state.rounded, self.particles)

    def moved(self) -> None:
        """Record a change of positions, box or parameters that this object did not make."""
        self.version += 1
        self._written = None


class Synchronisation:
    """The bodies of a Context and their state.

    The object holds only weak references to the Context and the integrator, which own the object. Checkpoints, and
    States with integratorParameters=True, contain the full state in the integrator's variables. A ValueError is raised
    if there are no positions, no particle can move, or bodies are not supported or do not match the positions. The
    argument `pairs` is passed to `find_bodies`; `bodies` is the result of this function, if known. The function
    storage(integrator, bodies) returns where the integrator stores the state.

    Attributes
    ----------
    bodies : RigidBodies
    state : State
        The state whose positions and velocities the Context contains.
    inner : Inner or None
        The inner state of a processed scheme, or None if steps continue from `state`.
    particles : (n_particles, 3) array
        Positions of all particles (nm); `Positions.placed` replaces those of particles in bodies.
    positions : Positions
        The writer of the positions into the Context.
    """

    _same, _rigid = (_SAME, _SAME_PART), _RIGID

    def __init__(
        self,
        context: openmm.Context,
        integrator: openmm.CustomIntegrator,
        named: Sequence[Sequence[int]] | None,
        pairs: bool = False,
        bodies: RigidBodies | None = None,
        storage: Callable[[Any, RigidBodies], variables.Storage] = variables.PerDof,
    ) -> None:
        self._context, self._integrator = weakref.ref(context), weakref.ref(integrator)
        x, v = self.held()
        require_positions(context)
        self.bodies = bodies or find_bodies(context.getSystem(), x, named, self.box(), pairs)
        self._shapes, self._storage = Shapes(self.bodies), storage(integrator, self.bodies)
        self.particles, self._v = x.copy(), v.copy()  # arrays that are written to OpenMM
        self.positions = Positions(context, self.bodies, self.particles)
        self._seen: tuple[Array, Array] | None = None  # values in the Context when it last held `state`
        self.state: State
        self.inner: Inner | None = None
        self._outdated = self._written = False
        #: Called when a user has set a State or a step count, or has reinitialised the Context without a seed.
        self.new_trajectory: Callable[[], None] = lambda: None
        #: fingerprint(context) -> the `Inner.fingerprint` of the present settings, box and parameters.
        self.fingerprint: Callable[[Any], float] = lambda context: 0.0
        self._n_forces, self._reports = context.getSystem().getNumForces(), reports_changes(context.getSystem())
        watch(context, "reinitialize", self._write_shown, self._outlive)
        for name in ("setState", "setStepCount"):
            watch(context, name, after=lambda: self.new_trajectory())
        watch(context, "createCheckpoint", self._write, self._withdraw)
        watch(context, "getState", self._write, self._withdraw, _saves)

    @property
    def context(self) -> Any:
        """The Context, or None if it no longer exists."""
        return self._context()

    @property
    def outdated(self) -> bool:
        """Whether the Context was deleted or reinitialised, so that masses, constraints and forces may have changed."""
        return self._outdated or self._context() is None

    def _outlive(self) -> None:
        self._outdated = True
        context: Any = self._context()
        integrator: Any = self._integrator()
        variables.put(integrator, variables.COORDINATES, 0.0)  # the forces of the System may have changed
        if not context.getStepCount() and not integrator.getRandomNumberSeed():  # OpenMM would draw a new seed too
            self.new_trajectory()

    def pull(self) -> bool:
        """Update the state with changes made to the Context since the last push; return whether the state changed.

        Positions that deviate from rigid bodies by more than 1e-9 nm, or that the periodic box has split, are also
        corrected in the Context.

        Raises
        ------
        ValueError
            If values in the Context are not finite, or molecules are not rigid. The state is then unchanged.
        """
        x, v = self.held()
        saved, seen = self.saved(x, v), self._seen
        if saved is not None:
            state = self.compared(saved, self._joined(x), v)
            self._read_inner()
            self._follow(saved, state)
            self._unmark()
        elif seen is None:
            state = State.of(fit(self.bodies, self._joined(x), v))
        elif np.array_equal(seen[0], x) and np.array_equal(seen[1], v):
            return False
        else:
            moved, pushed = (_differs(self.bodies, *pair) for pair in zip((x, v), seen, strict=True))
            state = self._refitted(self.state, self._joined(x), v, moved, pushed)
            self._follow(self.state, state)
        if self._elsewhere(x):
            self.inner = None  # its forces were those of other positions of these particles
        self.state = state
        self.positions.moved()
        self.particles[:], self._v[:] = x, v  # massless particles other than virtual sites do not move
        self._seen = (x, v)
        if len(_differs(self.bodies, x, self.bodies.positions(self.state.rounded, self.particles), self._rigid)):
            self.push()
        return True

    @functools.cached_property
    def _fixed(self) -> NDArray[np.intp]:
        """The indices of the massless particles that are not virtual sites."""
        system = self.context.getSystem()
        return np.array([i for i in np.flatnonzero(self.bodies.owner < 0) if not system.isVirtualSite(int(i))], np.intp)

    def _fixed_moved(self) -> bool:
        """Return whether massless particles have moved since the last synchronisation, as `pull` will notice."""
        return bool(len(self._fixed)) and self._elsewhere(self.held()[0])

    def _elsewhere(self, x: Array) -> bool:
        """Return whether massless particles have other positions than at the last synchronisation."""
        return bool((x != self.particles)[self._fixed].any())

    def _joined(self, x: Array) -> Array:
        """Return positions in which molecules are whole; raise ValueError if a massless particle has no position."""
        lost = self._fixed[~np.isfinite(x[self._fixed]).all(axis=1)]
        if len(lost):
            raise ValueError(f"the position of particle {lost[0]} is not finite: set a finite one before the next step")
        box = self.box()
        return x if box is None else self._shapes.whole(x, box)

    def box(self) -> Array | None:
        """Return the vectors (3, 3) of the periodic box in nm, or None without a box."""
        return arrays.periodic_box(self.context)

    def compared(self, known: State, x: Array, v: Array) -> State:
        """Return a known state, with bodies refitted if their positions, velocities or constraints are now others."""
        bodies, rounded = self.bodies, known.rounded
        moved = _differs(bodies, x, bodies.positions(rounded, x.copy()), *self._same)
        moved = np.union1d(moved, off_constraints(bodies, rounded))
        pushed = _differs(bodies, v, bodies.velocities(rounded, v.copy()), *self._same)
        return self._refitted(known, x, v, moved, pushed)

    def _refitted(self, known: State, x: Array, v: Array, moved: Indices, pushed: Indices) -> State:
        """Return a known state, with bodies refitted that were moved or whose velocities changed."""
        if not len(moved) and not len(pushed):
            return known
        return known.renewed(refit(self.bodies, known.rounded, x, v, moved, pushed))

    def _follow(self, before: State, after: State) -> None:
        """Apply a user's change to the inner state too, by addition if the change is less than the output error.

        After a larger change, the processor recomputes the inner state from the true state.
        """
        if self.inner is None or after is before:
            return
        changes = [(new - old).sum(axis=0) for new, old in zip(after, before, strict=True)]
        atoms = np.arange(len(self.bodies.mass))[self.bodies.clustered]
        atoms = atoms[changes[1][:, atoms].any(axis=0)]  # the projection onto constraints is no change by a user
        changes[1][:, atoms] = (after.rounded.P - self.bodies.tangent(before.rounded).P)[:, atoms]
        sizes = (self.bodies.mass, self.bodies.inertia.T)
        small = all(map(_is_small, changes, (1.0, sizes[0], 1.0, sizes[1])))
        self.inner = self.inner._replace(state=State(*map(add, self.inner.state, changes))) if small else None

    def push(self) -> None:
        """Write the state into the Context; positions are written only if the Context has other positions."""
        self.positions.write(self.state)
        self.write_velocities(self.state)
        self._seen = self.held()

    def valid_inner(self) -> Inner | None:
        """Return the inner state, which is deleted if it does not belong to the present settings, box and forces.

        Steps then continue from the shown state. Afterwards, the Context may contain other positions and another time.
        """
        told, inner = self._told(), self.inner
        if inner is not None and (inner.fingerprint != self.fingerprint(self.context) or inner.outdated(told)):
            self.inner = None
        return self.inner

    def _told(self) -> bool | None:
        """Return whether OpenMM has reported changed forces, or None if they may have changed without a report."""
        told = self._storage.forces_changed()
        return told if told or self._reports else None

    def saved(self, x: Array, v: Array) -> State | None:
        """Return the state from a loaded checkpoint or State, if any, given positions x and velocities v."""
        return variables.read(self._integrator(), self._storage)

    def _read_inner(self) -> None:
        """Read the inner state from the integrator's variables, if they contain one."""
        integrator = self._integrator()
        fingerprint = variables.get(integrator, variables.COORDINATES)
        inner = variables.read(integrator, self._storage, variables.INNER) if fingerprint else None
        self.inner = None
        if inner is not None and has_saved_forces(self.context, integrator):
            self.inner = Inner(inner, fingerprint, variables.read_forces(integrator, self._storage))

    def _write(self) -> None:
        """Write the state, and the inner state if it is valid, to the integrator's variables; see `_write_shown`."""
        self._write_shown()
        if not self._written or self.inner is None:
            return
        integrator = self._integrator()
        here = self.inner.fingerprint == self.fingerprint(self.context)
        if self._fixed_moved() or (here and self._outdated_here(self.inner)):
            self.inner = None
            return
        self._storage.write(self.inner.state, variables.INNER)
        variables.write_forces(integrator, self._storage, self.inner.memory)
        variables.put(integrator, variables.COORDINATES, self.inner.fingerprint)
        save_forces(self.context, integrator)

    def _outdated_here(self, inner: Inner) -> bool:
        """Return whether forces have changed since an inner state was computed; the Context is not modified."""
        context: Any = self._context()
        if context.getSystem().getNumForces() != self._n_forces:  # OpenMM cannot evaluate forces before `reinitialize`
            return True
        x, time, number = self.held()[0], context.getTime(), context.getStepCount()
        try:
            return inner.outdated(self._told())
        finally:
            context.setPositions(x)
            context.setTime(time)
            openmm.Context.setStepCount(context, number)
            self.positions.moved()

    def _write_shown(self) -> None:
        """Write the state to the integrator's variables, unless they hold a loaded state that was not yet pulled."""
        integrator = self._integrator()
        self._written = self._seen is not None and not variables.marked(integrator)
        if self._written:
            self._storage.write(self.state)
            variables.put(integrator, variables.COORDINATES, 0.0)
            variables.mark(integrator, self._storage.mark)

    def _unmark(self) -> None:
        """Remove the mark, so that only loaded variables have a mark."""
        variables.mark(self._integrator(), variables.NOTHING)

    def _withdraw(self) -> None:
        """Remove the mark that `_write` set."""
        if self._written:
            self._unmark()

    def write_velocities(self, state: State) -> None:
        """Write the velocities of the particles into the Context."""
        self.context.setVelocities(self.bodies.velocities(state.rounded, self._v))

    def held(self) -> tuple[Array, Array]:
        """Return positions (nm) and velocities (nm/ps) of all particles in the Context."""
        context: Any = self._context()
        state = context.getState(positions=True, velocities=True)
        return arrays.positions(state), arrays.velocities(state)

    def replace(self, state: State) -> None:
        """Replace the state of the bodies and push it."""
        self.state, self.inner = state, None
        self.positions.moved()
        self.push()


def require_positions(context: openmm.Context) -> None:
    """Raise ValueError if positions were never set.

    OpenMM performs this check when forces are requested, even if no force group is selected.
    """
    try:
        context.getState(forces=True, groups=0)
    except openmm.OpenMMException as error:
        if "positions" not in str(error):
            raise
        raise ValueError("the Context has no positions yet: call setPositions first") from None


def _is_small(change: Array, size: Any) -> bool:
    """Return whether a change of an array of the state is at most `_SMALL` times a size, such as a mass."""
    return bool((np.abs(change) <= _SMALL * size).all())


def _differs(bodies: RigidBodies, actual: Array, expected: Array, same: float = 0.0, part: float = 0.0) -> Indices:
    """Return the bodies in which a particle differs from its expected value by more than the tolerances, or is nan."""
    different = np.zeros(len(bodies), dtype=bool)
    for kind in bodies.kinds:
        known = expected[kind.particles]
        offset = np.abs(actual[kind.particles] - known) - part * np.abs(known)
        different[kind.bodies] = ~(offset.max(axis=(1, 2)) <= same)
    return np.flatnonzero(different)


def _saves(*arguments: Any, **options: Any) -> bool:
    """Return whether arguments of `Context.getState` request the integrator's variables."""
    return len(arguments) > 6 or bool(options.get("integratorParameters") or options.get("getIntegratorParameters"))
