"""On processors, clusters keep lengths and energies as on the host, because numbers of the state have low parts."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from benchmarks.constraints.clusters import CLUSTERS
from places import REFERENCE

pytestmark = pytest.mark.library

EPS = 2.0**-52
FLEXIBLE = [name for name in CLUSTERS if name not in ("water", "XH")]


def free(name, copies, h, away=10.0):
    """Return an integrator of free clusters far from the origin, with velocities at 300 K, and its Context."""
    masses, pairs, x = CLUSTERS[name]
    system, still = openmm.System(), openmm.CustomExternalForce("0*x")
    for first in range(0, copies * len(masses), len(masses)):
        for mass in masses:
            still.addParticle(system.addParticle(mass))
        for i, j in pairs:
            system.addConstraint(first + i, first + j, float(np.linalg.norm(x[i] - x[j])))
    system.addForce(still)
    integrator = rb.ExactRigidBodyIntegrator(h, "V2", fast=None, engine="native")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(np.tile(x, (copies, 1)) + away * np.array([0.31, -0.42, 0.57]))
    integrator.setVelocitiesToTemperature(300.0, 3)
    integrator.step(1)
    return integrator, context


def places_and_momenta(integrator, n):
    """Return positions and momenta (copies, n, 3) of the clusters in extended precision."""
    _, state = integrator.fullState()
    order = np.argsort(integrator._propagator.sync.bodies.first_particle)  # noqa: SLF001
    R, P = (np.asarray(a, np.longdouble).sum(axis=0).T[order].reshape(-1, n, 3) for a in (state.R, state.P))
    return R, P


def energies(p, masses):
    """Return the kinetic energies of clusters."""
    return 0.5 * ((p * p).sum(axis=2) / np.array(masses)).sum(axis=1)


@pytest.mark.parametrize(("h", "rounding"), [(0.0005, 1e-15), (0.004, 1e-15), (0.02, 0.5 * EPS * 500**0.5)])
@pytest.mark.parametrize("name", FLEXIBLE)
def test_five_hundred_steps_keep_energy_and_constraints_to_1e_15(name, h, rounding):
    masses, pairs, x = CLUSTERS[name]
    i, j = np.array(pairs).T
    lengths = np.linalg.norm(x[i] - x[j], axis=1)
    integrator, _context = free(name, 4, h)
    begin, p = places_and_momenta(integrator, len(masses))
    energy = energies(p, masses)
    for _ in range(10):
        integrator.step(50)
        there, p = places_and_momenta(integrator, len(masses))
        apart = np.sqrt(((there[:, i] - there[:, j]) ** 2).sum(axis=2))
        assert np.abs(apart / lengths - 1.0).max() < 1e-15
        assert np.abs(energies(p, masses) / energy - 1.0).max() < rounding
    assert np.abs(there - begin).max() > 0.05
    assert integrator.getEngine() == "native"


@pytest.mark.parametrize("name", ["XH3", "ring"])
def test_the_energy_walks_without_a_direction(name):
    """A bias of the rounding of lengths, which is the same in every step, would give it one."""
    masses, copies, steps = CLUSTERS[name][0], 128, 500
    integrator, _context = free(name, copies, 0.01)
    start = energies(places_and_momenta(integrator, len(masses))[1], masses)
    integrator.step(steps)
    change = (energies(places_and_momenta(integrator, len(masses))[1], masses) / start - 1.0).astype(float)
    assert np.sqrt((change**2).mean()) < 0.25 * EPS * steps**0.5
    assert abs(change.mean()) < 4.0 * change.std() / copies**0.5


@pytest.mark.parametrize("name", FLEXIBLE)
def test_five_hundred_steps_and_back_return_to_1e_14_nm(name):
    n = len(CLUSTERS[name][0])
    integrator, _context = free(name, 4, 0.002)
    start, _ = places_and_momenta(integrator, n)
    integrator.step(500)
    there, _ = places_and_momenta(integrator, n)
    assert np.abs(there - start).max() > 0.05
    _, state = integrator.fullState()
    integrator.setBodyState(state._replace(P=-state.P))
    integrator.step(500)
    back, _ = places_and_momenta(integrator, n)
    assert np.abs(back - start).max() < 1e-14
