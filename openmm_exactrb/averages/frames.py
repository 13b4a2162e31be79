"""The quantities of a frame that determine the step-size error of averages.

The symbols are those of `openmm_exactrb.averages.correction`: f is the generalised force due to all forces, and f_s is
the generalised force due to the forces in the kicks. The slopes of observables are their derivatives along the velocity
field w = M⁻¹f_s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.averages.dynamics import Dynamics
from openmm_exactrb.averages.virial import check_virial
from openmm_exactrb.context.dipole_boxes import DipoleBoxes
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.openmm_access.molecules import molecule_of
from openmm_exactrb.openmm_access.units import gas_constant_times
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array

#: An observable of the positions (n_particles, 3) of all particles, in nm.
Observable = Callable[[Array], float]

# The largest relative change of lengths in the difference quotients for the pressure.
_STRETCH = 1e-3
# The largest displacement of a particle (nm) in the difference quotients for slopes of observables.
_SHIFT = 1e-4
#: bar per kJ/mol/nm³.
BAR = 16.605390671738466


class Generalised(NamedTuple):
    """A generalised force: forces (3, N), projected onto the constraints of clusters, and body-frame torques (3, K)."""

    force: Array
    torque: Array

    def less(self, other: Generalised) -> Generalised:
        """Return this force minus another."""
        return Generalised(self.force - other.force, self.torque - other.torque)


class Frames:
    """The frames of a Simulation with given dynamics."""

    def __init__(
        self, simulation: Any, dynamics: Dynamics, pressure: bool, around: tuple[Sequence[int], float] | None
    ) -> None:
        self._dynamics, self._context, self.bodies = dynamics, simulation.context, dynamics.bodies
        self._kT = gas_constant_times(dynamics.temperature)
        self._excerpt = None if dynamics.fast is None else _FastContext(dynamics.fast)
        self._around = around
        #: A mask (N,) of the bodies with inner steps, whose steps end at the heat exchange.
        self._inner = np.zeros(len(self.bodies), dtype=bool)
        if dynamics.fast is not None and dynamics.fast.excerpt is not None:
            self._inner[dynamics.fast.excerpt.part.columns] = True
        self._scaled = _ScaledContext(simulation, dynamics, self._kT) if pressure else None
        self._sites = _VirtualSites(simulation.system)
        #: The number of molecules with frozen particles, which are not counted in the pressure; 0 without pressure.
        self.frozen = 0 if self._scaled is None else self._scaled.frozen

    def row(self, state: openmm.State, observables: Mapping[str, Observable]) -> list[float]:
        """Return the values of the columns that follow the time, for a State with energy, forces and positions."""
        x = arrays.positions(state)
        of_bodies = self._dynamics.state(x)
        total = self._generalised(of_bodies, arrays.forces(state))
        slow = total if self._excerpt is None else total.less(self._generalised(of_bodies, self._fast_forces(x)))
        work, square = self._products(total, slow), self._products(slow, slow)
        values = [state.getPotentialEnergy()._value, state.getPeriodicBoxVolume()._value]
        values += [*self._split(square), *self._split(work), _sum(work, self._dynamics.damping)]
        if self._dynamics.chords is not None:
            values.append(self._dynamics.chords.mean(x, self._kT))
        if self._around is not None:
            values.append(_sum(square, self._near(x, state)))
        if not observables and self._scaled is None:
            return values
        fields = [self._field(x, of_bodies, slow, chosen) for chosen in (~self._inner, self._inner)]
        if self._scaled is not None:
            values += self._scaled.pressure(state, of_bodies, total, fields, self._generalised)
        for name, observable in observables.items():
            value = partial(_value, name, observable)
            values += [value(x), *(_slope(value, x, field.particles) for field in fields)]
        return values

    def _generalised(self, state: BodyState, forces: Array) -> Generalised:
        force, torque = self.bodies.forces(state, forces)
        return Generalised(self.bodies.tangent(state._replace(P=force)).P, torque)

    def _fast_forces(self, x: Array) -> Array:
        assert self._excerpt is not None
        return self._excerpt.forces(self._context, x)

    def _products(self, one: Generalised, other: Generalised) -> Generalised:
        """Return f·M⁻¹g of each body for forces f and g: for translation (N,) and for rotation (K,)."""
        translation = (one.force * other.force).sum(axis=0) / self.bodies.mass
        return Generalised(translation, (one.torque * other.torque / self.bodies.inertia.T).sum(axis=0))

    def _split(self, product: Generalised) -> tuple[float, float]:
        """Return the sums of a product over bodies without inner steps and over bodies with inner steps."""
        both = (~self._inner, self._inner)
        one, other = (_sum(product, (of.astype(float), of[: self.bodies.n_turning].astype(float))) for of in both)
        return one, other

    def _near(self, x: Array, state: openmm.State) -> tuple[Array, Array]:
        """Return weights (N,) and (K,): 1 for bodies with a particle near a selected particle, 0 for other bodies."""
        assert self._around is not None
        particles, distance = self._around
        gaps = x[:, None] - x[None, list(particles)]
        if self._context.getSystem().usesPeriodicBoundaryConditions():
            box = np.reshape(arrays.box(state), (3, 3))
            gaps -= np.round(gaps @ np.linalg.inv(box)) @ box
        near = (np.linalg.norm(gaps, axis=2) <= distance).any(axis=1)
        bodies, owner = np.zeros(len(self.bodies)), self.bodies.owner
        bodies[owner[near & (owner >= 0)]] = 1.0
        return bodies, bodies[: self.bodies.n_turning]

    def _field(self, x: Array, state: BodyState, slow: Generalised, chosen: NDArray[np.bool_]) -> Field:
        """Return the velocity field M⁻¹f_s of selected bodies, which is zero for all others."""
        turning = chosen[: self.bodies.n_turning]
        own = Generalised(slow.force * chosen, slow.torque * turning)
        particles = np.zeros((self.bodies.n_particles, 3))
        self.bodies.velocities(state._replace(P=own.force, m=own.torque), particles)
        self._sites.follow(x, particles)
        return Field(Generalised(own.force / self.bodies.mass, own.torque / self.bodies.inertia.T), particles)


class Field(NamedTuple):
    """A velocity field, given for bodies and for all particles (n_particles, 3)."""

    bodies: Generalised
    particles: Array


def _sum(product: Generalised, weights: tuple[Array, Array] | None = None) -> float:
    if weights is None:
        return float(product.force.sum() + product.torque.sum())
    return float(product.force @ weights[0] + product.torque @ weights[1])


def _value(name: str, observable: Observable, x: Array) -> float:
    """Return the value of a user's observable at a copy of x, because the observable may change its argument."""
    value = observable(x.copy())
    return float(value) if isinstance(value, bool | np.bool_) else checks.number(value, f"the observable {name!r}")


def _slope(observable: Observable, x: Array, field: Array) -> float:
    """Return the slope of an observable along a field of velocities (n_particles, 3)."""
    if not field.any():
        return 0.0
    shift = _shift(field)
    return (observable(x + shift * field) - observable(x - shift * field)) / (2.0 * shift)


def _shift(field: Array) -> float:
    """Return the time in which the largest displacement along a field of velocities is `_SHIFT`."""
    return _SHIFT / float(np.abs(field).max())


class _VirtualSites:
    """The virtual sites of a System, in a Context in double precision."""

    def __init__(self, system: openmm.System) -> None:
        self._system = system
        self._places = np.array([i for i in range(system.getNumParticles()) if system.isVirtualSite(i)], dtype=np.intp)

    @cached_property
    def _own(self) -> openmm.Context:
        platform = openmm.Platform.getPlatform("Reference")
        return openmm.Context(self._system, openmm.VerletIntegrator(0.001), platform)

    def follow(self, x: Array, field: Array) -> None:
        """Write the velocities of virtual sites, which follow from those of other particles, into a field."""
        if len(self._places) and field.any():
            shift = _shift(field)
            field[self._places] = (self._at(x + shift * field) - self._at(x - shift * field)) / (2.0 * shift)

    def _at(self, x: Array) -> Array:
        self._own.setPositions(x)
        self._own.computeVirtualSites()
        return arrays.positions(self._own.getState(positions=True))[self._places]


class _FastContext:
    """The fast forces, which act in the inner steps and not in the kicks."""

    def __init__(self, fast: FastForces) -> None:
        self._fast = fast
        if fast.excerpt is not None:
            platform = openmm.Platform.getPlatform("Reference")
            self._own = openmm.Context(fast.excerpt.system, openmm.VerletIntegrator(0.001), platform)

    def forces(self, context: Any, x: Array) -> Array:
        """Return the forces (n_particles, 3) at the positions of the Context."""
        excerpt = self._fast.excerpt
        if excerpt is None:
            return arrays.forces(context.getState(forces=True, groups=self._fast.groups))
        arrays.take_surroundings(self._own, context.getState(parameters=True))
        self._own.setPositions(x[excerpt.particles])
        forces = np.zeros_like(x)
        forces[excerpt.particles] = arrays.forces(self._own.getState(forces=True))
        return forces


#: A potential energy, generalised forces and torques.
_Scaled = tuple[Any, ...]


class _ScaledContext:
    """Energies and forces in boxes of other sizes, with molecules moved as a barostat would move them.

    A molecule's centre is the mean position of its particles, as for OpenMM's barostats. The centre of a molecule with
    frozen particles is the mean position of these. Such a molecule has no kinetic pressure.
    """

    def __init__(self, simulation: Any, dynamics: Dynamics, kT: float) -> None:
        context, system = simulation.context, simulation.system
        self._context = context
        if not system.usesPeriodicBoundaryConditions():
            raise ValueError(
                "a System without a periodic box has no pressure: create the AverageReporter with pressure=False"
            )
        self._molecule = molecule_of(context, dynamics.named)
        held = _frozen(system)
        frozen = np.bincount(self._molecule, held) > 0.0
        weights = np.where(frozen[self._molecule], held, 1.0)
        self._weights = weights / np.bincount(self._molecule, weights)[self._molecule]
        self._of_bodies = self._molecule[dynamics.bodies.first_particle]
        self.molecules = len(frozen)
        self.frozen = int(np.count_nonzero(frozen))
        self._ideal = (self.molecules - self.frozen) * kT
        check_virial(context, self._molecule, self._centres)
        platform = context.getPlatform()
        properties = {name: platform.getPropertyValue(context, name) for name in platform.getPropertyNames()}
        kept = {name: value for name, value in properties.items() if name in ("Precision", "Threads", "DeviceIndex")}
        self._own = openmm.Context(system, openmm.VerletIntegrator(0.001), platform, kept)
        self._boxes = DipoleBoxes(system)
        self._may_shrink = True

    def _centres(self, x: Array) -> Array:
        """Return the means (molecules, 3) of vectors x (n_particles, 3) over the particles that define the centres."""
        return np.stack([np.bincount(self._molecule, self._weights * column) for column in x.T], axis=1)

    def pressure(
        self,
        state: openmm.State,
        of_bodies: BodyState,
        total: Generalised,
        fields: Sequence[Field],
        generalised: Callable[[BodyState, Array], Generalised],
    ) -> list[float]:
        """Return the molecular pressure and its slopes along fields, in bar and bar/ps².

        Let l scale the box and the centres of the molecules. By the chain rule, the slope of dU/dl along a field w is
        -w·df/dl - sum F·c, where f is the generalised force, F is the force on a molecule, and c is the velocity of its
        centre in the field.
        """
        volume = state.getPeriodicBoxVolume()._value
        arrays.take_parameters(self._own, self._context.getState(parameters=True))

        def at(scale: float) -> _Scaled:
            return self._at(state, of_bodies, scale, generalised)

        of_energy, *of_forces = self._derivatives((state.getPotentialEnergy()._value, *total), at)
        per_length = BAR / (3.0 * volume)
        force = np.zeros((self.molecules, 3))
        np.add.at(force, self._of_bodies, total.force.T)
        slopes = []
        for field in fields:
            change = sum(float((w * f).sum()) for w, f in zip(field.bodies, of_forces, strict=True))
            slopes.append(per_length * (change + float((force * self._centres(field.particles)).sum())))
        return [BAR * self._ideal / volume - per_length * of_energy, *slopes]

    def _derivatives(self, here: _Scaled, at: Callable[[float], _Scaled]) -> _Scaled:
        """Return the derivatives by the scale at 1 of a potential energy, forces and torques.

        They are known at the scale 1. If half the edges of a smaller box are less than a cutoff, the box only grows.
        """
        if self._may_shrink:
            try:
                down = at(1.0 - _STRETCH)
            except (openmm.OpenMMException, ValueError):  # errors with another cause recur in the larger boxes
                self._may_shrink = False
            else:
                up = at(1.0 + _STRETCH)
                return tuple((u - d) / (2.0 * _STRETCH) for u, d in zip(up, down, strict=True))
        near, far = at(1.0 + 0.5 * _STRETCH), at(1.0 + _STRETCH)
        return tuple((4.0 * n - 3.0 * h - f) / _STRETCH for h, n, f in zip(here, near, far, strict=True))

    def _at(
        self,
        state: openmm.State,
        of_bodies: BodyState,
        scale: float,
        generalised: Callable[[BodyState, Array], Generalised],
    ) -> _Scaled:
        """Return the potential energy and the generalised force in a box with scaled lengths."""
        x = arrays.positions(state)
        self._own.setPeriodicBoxVectors(*(scale * np.reshape(arrays.box(state), (3, 3))))
        self._boxes.check(self._own)
        self._own.setPositions(x + (scale - 1.0) * self._centres(x)[self._molecule])
        self._own.computeVirtualSites()
        found = self._own.getState(energy=True, forces=True)
        return found.getPotentialEnergy()._value, *generalised(of_bodies, arrays.forces(found))


def _frozen(system: openmm.System) -> Array:
    """Return 1 for each frozen particle, which has no mass and is no virtual site, and 0 for others (n_particles,)."""
    masses = parameters.masses(system)
    return np.array([float(not mass and not system.isVirtualSite(i)) for i, mass in enumerate(masses)])
