"""The preparation of an equilibrated state from positions, with the minimiser and integrator of this package.

OpenMM's own minimiser and integrators fail for redundant constraints, such as all distances within CO2 or CH4.
"""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import openmm

from openmm_exactrb.errors import IntegrationError, MinimisationError, MinimisationWarning, NonFiniteError
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.integrators.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.mechanics.bodies import RigidBodies

# Extent in nm that is assigned to particles without a shape.
_EXTENT = 0.1
# Parameters of Langevin dynamics: step in characteristic times, smallest and largest friction in inverse characteristic
# times, shortest step in times of free bodies, and number of steps after which these times are recomputed.
_STEP, _WEAKEST, _STRONGEST, _SHORTEST, _STEPS = 0.07, 0.2, 1.0, 1e-3, 75
# Largest distance in nm that a body of the mean mass may move in a step, because bodies may collide, and the number of
# times that the step is halved after a divergence.
_FLIGHT, _HALVINGS = 0.003, 4
# Smallest number of momentum relaxation times in dynamics of a given length.
_RELAXED = 10.0
#: Number of parts, of `_STEPS` steps each, that bring a start to a temperature.
PARTS = 16
_ITERATIONS, _TOLERANCE = 100, 10.0  # enough to remove overlaps; the minimiser need not converge


class Characteristics(NamedTuple):
    """Size and characteristic times of a system."""

    #: Number of rigid bodies and other particles.
    n_bodies: int
    #: Kinetic energy in kJ/mol per body.
    kinetic: float
    #: 1/omega in ps, at most `free`. omega², the mean square frequency in equilibrium, is the mean of force²/mass and
    #: torque²/inertia divided by kT.
    time: float
    #: Time in ps in which free bodies turn by a radian, and particles without a shape move by 0.1 nm.
    free: float
    #: Root mean square of a velocity component for the mean mass, in nm/ps.
    speed: float


def characteristics(integrator: ExactRigidBodyIntegrator, context: openmm.Context) -> Characteristics:
    """Return size and characteristic times of the system in a Context; raise ValueError if nothing moves."""
    bodies, state = integrator.bodyState()
    context.computeVirtualSites()
    groups = integrator.getIntegrationForceGroups()
    forces = context.getState(forces=True, groups=groups).getForces(asNumpy=True)._value
    if not np.isfinite(forces).all():
        raise ValueError("the forces at the start are not finite: set positions in which no particles overlap")
    (force, torque), kinetic = bodies.forces(state, forces), sum(bodies.kinetic_energies(state))
    if not kinetic > 0.0:
        raise ValueError("nothing moves, so there is no energy error to measure: set velocities of particles with mass")
    moments = np.broadcast_to(bodies.inertia.T, torque.shape)
    turning = torque[moments > 0.0] ** 2 / moments[moments > 0.0]
    square = float((force**2 / bodies.mass).sum() + turning.sum())
    time = math.sqrt(2.0 * kinetic / square) if square > 0.0 else math.inf
    kT = 2.0 * kinetic / (bodies.translational_freedom + bodies.rotational_freedom)
    free, speed = _free_time(bodies, kT), math.sqrt(kT / bodies.mass.mean())
    return Characteristics(len(bodies), kinetic / len(bodies), min(time, free), free, speed)


def _free_time(bodies: RigidBodies, kT: float) -> float:
    """Return the time in which bodies turn by a radian or cross their extent, from the rms of the inverse times."""
    moments = np.broadcast_to(bodies.inertia, (bodies.n_turning, 3))
    moments = moments[moments > 0.0]
    inverse = np.concatenate([1.0 / moments, 1.0 / (bodies.mass[bodies.n_turning :] * _EXTENT**2)])
    return float(1.0 / math.sqrt(kT * inverse.mean()))


@contextlib.contextmanager
def diverging() -> Iterator[None]:
    """Convert OpenMM's exception for NaN coordinates into NonFiniteError; other exceptions propagate unchanged."""
    try:
        yield
    except openmm.OpenMMException as error:
        if "NaN" not in str(error):
            raise
        raise NonFiniteError(str(error)) from error


def minimise(integrator: ExactRigidBodyIntegrator) -> None:
    """Remove overlaps in the initial state; the first short steps of `heat` remove any that remain."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MinimisationWarning)
        with contextlib.suppress(MinimisationError):  # of molecules that are constrained but not rigid
            integrator.minimizeEnergy(_TOLERANCE, _ITERATIONS)


def heat(
    integrator: ExactRigidBodyLangevinIntegrator,
    context: openmm.Context,
    length: float | None = None,
    may_continue: Callable[[], bool] = lambda: True,
) -> Iterator[float]:
    """Perform Langevin dynamics for a time in ps, by default in `PARTS` parts; yield the kinetic energy after each.

    The step is chosen from the forces, which allows initial states far from equilibrium. The step is halved if the
    dynamics diverges, for example because bodies collide that did not interact before.
    """
    left, least = (math.inf, 0.0) if length is None else (length, _RELAXED / (length or math.inf))
    part, halvings = 0, 0
    while left > 1e-9 and (length is not None or part < PARTS) and may_continue():
        scales = characteristics(integrator, context)
        step = min(max(_STEP * scales.time, _SHORTEST * scales.free), _FLIGHT / scales.speed) / 2**halvings
        steps = math.ceil(min(_STEPS, left / step))
        step = min(step, left / steps)
        integrator.setStepSize(step)
        integrator.setFriction(min(max(_WEAKEST / scales.time, least), _STRONGEST / scales.time))
        try:
            with diverging():
                integrator.step(steps)
        except IntegrationError:  # the Context keeps the last valid step
            if halvings == _HALVINGS:
                raise
            halvings += 1
            continue
        part, left = part + 1, left - steps * step
        yield float(sum(energy._value for energy in integrator.kineticEnergies()))
