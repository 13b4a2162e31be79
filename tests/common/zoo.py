"""A System with bodies of every kind that moves, and Contexts of both engines for the same start."""

import copy

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.openmm_access.platforms import DEVICES
from places import device_platform

_T = 0.1 / 3**0.5
METHANE = [(0, 0, 0), (_T, _T, _T), (_T, -_T, -_T), (-_T, _T, -_T), (-_T, -_T, _T)]
AMMONIA = [(0, 0, 0), (0.09, 0.03, 0), (-0.045, 0.03, 0.078), (-0.045, 0.03, -0.078)]
CARBON_DIOXIDE = [(-0.12, 0, 0), (0, 0, 0), (0.12, 0, 0)]


def every_kind(seed=3):
    """Return a System, positions and bodies by hand.

    Linear bodies by a constraint and by hand, spherical, symmetric and asymmetric tops, asymmetric ones of a shape of
    their own each, bodies of 17 and 40 particles, single particles, and one that does not move.
    """
    rng, L = np.random.default_rng(seed), 3.2
    system, force = openmm.System(), openmm.NonbondedForce()
    system.setDefaultPeriodicBoxVectors(*(L * np.eye(3)))
    force.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
    force.setCutoffDistance(1.0)
    force.setUseSwitchingFunction(True)
    force.setSwitchingDistance(0.8)
    places = rng.permutation(np.stack(np.meshgrid(*[np.arange(4) * 0.8 + 0.3] * 3), axis=-1).reshape(-1, 3)).tolist()
    positions, named = [], []

    def add(sites, masses):
        first, attitude = len(positions), np.linalg.qr(rng.standard_normal((3, 3)))[0]
        attitude *= np.sign(np.linalg.det(attitude))
        centre = places.pop()
        for site, mass in zip(sites, masses, strict=True):
            system.addParticle(mass)
            force.addParticle(0.3 * rng.choice([-1, 1]) if len(sites) > 1 else 0.0, 0.25, 0.5)
            positions.append(centre + attitude @ np.array(site))
        members = list(range(first, len(positions)))
        for i in members:
            for j in range(first, i):
                force.addException(j, i, 0.0, 0.1, 0.0)
        if len(members) > 1:
            named.append(members)

    for _ in range(4):
        add([(0, 0, 0), (0.11, 0, 0)], [14, 14])
        system.addConstraint(*named.pop(), 0.11)
        add(METHANE, [12, 1, 1, 1, 1])
        add(AMMONIA, [14, 1, 1, 1])
        add([(0, 0, 0)], [40])
    for _ in range(3):
        add(rng.uniform(-0.08, 0.08, (6, 3)), rng.uniform(5, 20, 6))
        add(CARBON_DIOXIDE, [16, 12, 16])
    for size, width in ((17, 0.2), (40, 0.25)):
        add(rng.uniform(-width, width, (size, 3)), rng.uniform(5, 20, size))
    system.addParticle(0.0)
    force.addParticle(0.0, 0.2, 0.1)
    positions.append(places.pop())
    system.addForce(force)
    return system, np.array(positions), named


def water(n=27, model="tip3p", method=app.CutoffPeriodic):
    """Return a periodic System of rigid water, and positions."""
    cutoff = 0.45 * 0.3104 * np.ceil(n ** (1 / 3))
    _, system, positions = rb.rigid_water(n, model=model, nonbondedMethod=method, nonbondedCutoff=cutoff)
    return system, np.array(positions._value)


def context_of(system, positions, integrator, *, precision="double", kelvin=300.0, platform=None):
    """Return a Context of a copy of a System, with bodies at a temperature."""
    platform = platform or device_platform()
    properties = {"Precision": precision} if platform.getName() in DEVICES else {}
    context = openmm.Context(copy.deepcopy(system), integrator, platform, properties)
    context.setPositions(positions)
    context.computeVirtualSites()
    if kelvin is not None:
        integrator.setVelocitiesToTemperature(kelvin, 1)
    return context


def pair(system, positions, make, **options):
    """Return Contexts of integrators make(engine=...) of host and kernels, from one start on one platform."""
    host, device = (
        context_of(system, positions, make(engine=engine), kelvin=None, **options) for engine in ("host", "native")
    )
    host.getIntegrator().setVelocitiesToTemperature(300.0, 1)
    start = host.getState(positions=True, velocities=True)
    device.setPositions(start.getPositions())
    device.setVelocities(start.getVelocities())
    return host, device


def held(context):
    """Return positions and velocities."""
    state = context.getState(positions=True, velocities=True)
    return np.array([state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value])


def apart(one, other):
    """Return how far positions (nm) of two Contexts are apart at most."""
    return np.abs(held(one)[0] - held(other)[0]).max()


def twice_from(checkpoint, context, n):
    """Return where n steps from a checkpoint end, twice."""
    ends = []
    for _ in range(2):
        context.loadCheckpoint(checkpoint)
        context.getIntegrator().step(n)
        ends.append(held(context))
    return ends
