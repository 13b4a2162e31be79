"""A System with bodies of every kind that moves, and periodic water."""

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb

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
