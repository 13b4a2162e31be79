"""The first step after any change begins with virtual sites at their places, and every call shows them there."""

from contextlib import nullcontext

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
import starts
from places import REFERENCE, no_library, platform_for
from products import in_pairs
from starts import energy_of, positions_of

PLACES = ["host", "no library", "kernels", pytest.param("OpenCL", marks=pytest.mark.opencl)]
SHAPE = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [-0.02, 0.09, 0.0]])
SITES = {
    "two": lambda i: openmm.TwoParticleAverageSite(i, i + 1, 0.7, 0.3),
    "three": lambda i: openmm.ThreeParticleAverageSite(i, i + 1, i + 2, 0.6, 0.2, 0.2),
    "out of plane": lambda i: openmm.OutOfPlaneSite(i, i + 1, i + 2, 0.3, 0.3, 4.0),
    "local": lambda i: openmm.LocalCoordinatesSite(
        *(i, i + 1, i + 2, openmm.Vec3(1, 0, 0), openmm.Vec3(-1, 1, 0), openmm.Vec3(-1, 0, 1)),
        openmm.Vec3(0.02, 0.01, 0.05),
    ),
}


def molecules(make):
    """Return a System of three charged molecules, each with a virtual site as its last particle, and positions."""
    system, force = openmm.System(), openmm.NonbondedForce()
    for k in range(3):
        for mass, charge in ((16.0, 0.0), (1.0, 0.4), (1.0, 0.4), (0.0, -0.8)):
            system.addParticle(mass)
            force.addParticle(charge, 0.2, 0.3 if mass > 1.0 else 0.0)
        for i, j in ((0, 1), (0, 2), (1, 2)):
            system.addConstraint(4 * k + i, 4 * k + j, float(np.linalg.norm(SHAPE[i] - SHAPE[j])))
        for i, j in np.ndindex(4, 4):
            if i < j:
                force.addException(4 * k + i, 4 * k + j, 0.0, 1.0, 0.0)
        system.setVirtualSite(4 * k + 3, make(4 * k))
    system.addForce(force)
    shifts = np.array([[0.35 * k, 0.05 * k, 0.1] for k in range(3)])
    return system, (SHAPE[[0, 1, 2, 0]] + shifts[:, None]).reshape(-1, 3)


def made(place, scheme):
    with no_library() if place == "no library" else nullcontext():
        engine = "native" if place in ("kernels", "OpenCL") else "host"
        return rb.ExactRigidBodyIntegrator(0.002, scheme, engine=engine)


def at_their_places(context):
    """Return the positions and the energy of a new Context with virtual sites computed from other particles."""
    other = openmm.Context(context.getSystem(), openmm.VerletIntegrator(0.001), REFERENCE)
    other.setPositions(positions_of(context))
    other.computeVirtualSites()
    return positions_of(other), energy_of(other)


def elsewhere(context, x, rng):
    """Set positions with virtual sites anywhere."""
    x = x.copy()
    x[3::4] = rng.uniform(-1.0, 1.0, (3, 3))
    context.setPositions(x)


def redefined(context, x, rng):
    system = context.getSystem()
    for i in range(3, system.getNumParticles(), 4):
        system.setVirtualSite(i, openmm.TwoParticleAverageSite(i - 3, i - 1, 0.4, 0.6))
    context.reinitialize(preserveState=True)


def state_without_sites(context, x, rng):
    other = openmm.Context(context.getSystem(), openmm.VerletIntegrator(0.001), REFERENCE)
    elsewhere(other, x, rng)
    context.setState(other.getState(positions=True))


@in_pairs(
    {
        "kind": SITES,
        "change": [elsewhere, redefined, state_without_sites],
        "scheme": ["S2_2", "V2_drift", "W2_1"],
        "place": PLACES,
    }
)
def test_sites_are_at_their_places(kind, change, scheme, place, rng):
    system, x = molecules(SITES[kind])
    integrator = made(place, scheme)
    platform, properties = platform_for("native" if place == "OpenCL" else "host")
    context = starts.context_of(system, integrator, x, kelvin=300.0, platform=platform, properties=properties)
    for steps in (0, 3):  # the first call of a Context, and a later one
        elsewhere(context, x, rng)
        integrator.step(steps)
        change(context, x, rng)
        integrator.step(0)
        places, energy = at_their_places(context)
        np.testing.assert_allclose(positions_of(context), places, rtol=0.0, atol=1e-12)
        assert energy_of(context) == pytest.approx(energy, abs=1e-6)
    before = integrator.totalEnergy()._value
    integrator.step(5)
    np.testing.assert_allclose(positions_of(context), at_their_places(context)[0], rtol=0.0, atol=1e-12)
    assert integrator.totalEnergy()._value == pytest.approx(before, abs=0.3)
