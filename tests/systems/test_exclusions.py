"""Exclusions within rigid bodies change nothing but a constant of the energy."""

import copy

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.mathematics import quaternions
from places import REFERENCE

EDGE, K = 3.0, 6


def body(rng):
    """Return six places which, with that of the site, are at least 0.15 nm apart."""
    while True:
        x = rng.uniform(-0.25, 0.25, (K, 3))
        every = np.vstack([x, 2.0 * x[0] - x[1]])
        apart = np.linalg.norm(every[:, None] - every[None], axis=2) + np.eye(K + 1)
        if apart.min() > 0.15:
            return x


def mixture(periodic, long_range=False, n=5):
    """Return a System of five bodies of six particles with a site each, and five single ones; positions; the bodies.

    It has a NonbondedForce, two CustomNonbondedForces and a GayBerneForce, with some exceptions of their own.
    """
    rng = np.random.default_rng(2)
    system, x, bodies = openmm.System(), [], []
    pairs = openmm.NonbondedForce()
    formulas = [openmm.CustomNonbondedForce(f) for f in ("0.2*(0.3/r)^6", "0.5*exp(-r)/r")]
    ellipsoids = openmm.GayBerneForce()
    forces = [pairs, *formulas, ellipsoids]
    for force in forces:
        method = force.CutoffPeriodic if periodic else force.NoCutoff
        force.setNonbondedMethod(force.PME if long_range and force is pairs else method)
        force.setCutoffDistance(0.9)
    shape = body(rng)
    for k in range(n):
        Q = quaternions.rotation_matrix(quaternions.random(rng, 1))[0]
        first = system.getNumParticles()
        for place in 0.5 + 1.1 * np.array([k % 2, k // 2 % 2, k // 4]) + shape @ Q.T:
            x.append(place)
            system.addParticle(12.0)
        site = system.addParticle(0.0)
        system.setVirtualSite(site, openmm.TwoParticleAverageSite(first, first + 1, 2.0, -1.0))
        x.append(2.0 * x[first] - x[first + 1])
        x.append(x[first] + 0.55)
        system.addParticle(20.0)
        bodies.append(list(range(first, first + K)))
    for i in range(system.getNumParticles()):
        pairs.addParticle(0.2 * (-1.0) ** i, 0.2, 0.3)
        for formula in formulas:
            formula.addParticle([])
        ellipsoids.addParticle(0.2, 0.2, -1, -1, *[0.1] * 3, *[1.0] * 3)
    for first, *_ in bodies:
        pairs.addException(first + 1, first, 0.1, 0.2, 0.1)
        for formula in formulas:
            formula.addExclusion(first + 1, first)
        ellipsoids.addException(first, first + 1, 0.2, 0.1)
    for force in forces:
        system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*(EDGE * np.eye(3)))
    return system, np.array(x), bodies


@pytest.mark.parametrize(("periodic", "long_range"), [(False, False), (True, False), (True, True)])
def test_forces_and_torques_are_the_same_to_roundoff(periodic, long_range):
    system, x, bodies = mixture(periodic, long_range)
    excluded = copy.deepcopy(system)
    assert rb.exclude_within(excluded, bodies) == len(bodies) * (K + 1) * K // 2
    contexts = [openmm.Context(s, openmm.VerletIntegrator(0.001), REFERENCE) for s in (system, excluded)]
    rng, energies = np.random.default_rng(5), []
    for _ in range(3):
        moved = x.copy()
        for first, *_ in bodies:
            members = range(first, first + K)
            Q = quaternions.rotation_matrix(quaternions.random(rng, 1))[0]
            centre = x[members].mean(axis=0)
            moved[members] = centre + (x[members] - centre) @ Q.T + 0.02 * rng.standard_normal(3)
        found = []
        for context in contexts:
            context.setPositions(moved)
            context.computeVirtualSites()
            state = context.getState(forces=True, energy=True)
            F = state.getForces(asNumpy=True)._value
            total = [F[b].sum(axis=0) for b in bodies]
            torque = [np.cross(moved[b] - moved[b].mean(axis=0), F[b]).sum(axis=0) for b in bodies]
            singles = F[[b[0] + K + 1 for b in bodies]]
            found.append((np.concatenate([total, torque, singles]), state.getPotentialEnergy()._value))
        scale = np.abs(found[0][0]).max()
        np.testing.assert_allclose(found[0][0], found[1][0], rtol=0.0, atol=(1e-6 if long_range else 1e-12) * scale)
        energies.append(found[0][1] - found[1][1])
    assert abs(energies[0]) > 1.0
    np.testing.assert_allclose(energies, energies[0], rtol=1e-5 if long_range else 1e-11)


def test_all_forces_exclude_the_same_pairs_and_a_second_call_changes_nothing():
    system, _, bodies = mixture(True)
    rb.exclude_within(system, bodies)
    text = openmm.XmlSerializer.serialize(system)
    pairs, one, other, ellipsoids = system.getForces()
    sets = [{tuple(sorted(f.getExclusionParticles(i))) for i in range(f.getNumExclusions())} for f in (one, other)]
    for force in (pairs, ellipsoids):
        sets.append({tuple(sorted(force.getExceptionParameters(i)[:2])) for i in range(force.getNumExceptions())})
    assert all(found == sets[0] for found in sets)
    assert (bodies[0][0], bodies[0][0] + K) in sets[0]  # the virtual site belongs to its body
    assert all(pairs.getExceptionParameters(i)[2]._value == 0.0 for i in range(pairs.getNumExceptions()))
    rb.exclude_within(system, bodies)
    assert openmm.XmlSerializer.serialize(system) == text


@pytest.mark.parametrize("method", ["CutoffPeriodic", "PME", "LJPME"])
def test_offsets_of_exceptions_within_go_and_others_stay(method):
    """An energy that depends on a parameter of the Context loses what does so within bodies."""
    system, x, bodies = mixture(True)
    for _ in range(system.getNumForces() - 1):  # which would need the same exceptions
        system.removeForce(1)
    (pairs,) = system.getForces()
    pairs.setNonbondedMethod(getattr(pairs, method))
    outside = pairs.addException(bodies[0][0], bodies[0][0] + K + 1, 0.05, 0.2, 0.1)
    pairs.addGlobalParameter("scale", 0.0)
    for exception in (0, outside):
        pairs.addExceptionParameterOffset("scale", exception, 0.1, 0.02, 0.3)
    changes = []
    for excludes in (False, True):
        if excludes:
            rb.exclude_within(system, bodies)
        context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
        context.setPositions(x)
        context.computeVirtualSites()
        forces = []
        for scale in (0.0, 1.0):
            context.setParameter("scale", scale)
            forces.append(context.getState(forces=True).getForces(asNumpy=True)._value)
        change = forces[1] - forces[0]
        changes.append(np.concatenate([change[bodies[0]].sum(axis=0), change[bodies[0][0] + K + 1]]))
        assert (np.abs(change[bodies[0][1]]).max() < 1e-10) == excludes
    assert np.abs(changes[0]).max() > 0.1
    np.testing.assert_allclose(*changes, rtol=0.0, atol=1e-9)


def test_trial_moves_of_a_barostat_have_the_same_energy_differences():
    """What a barostat asks for: molecules are moved as wholes when the box is scaled, and the energies compared."""
    system, x, bodies = mixture(True)
    bonds = openmm.HarmonicBondForce()
    for first, *others in bodies:
        for other in others:
            bonds.addBond(first, other, float(np.linalg.norm(x[first] - x[other])), 0.0)
    system.addForce(bonds)
    excluded = copy.deepcopy(system)
    rb.exclude_within(excluded, bodies)
    differences = []
    for each in (system, excluded):
        barostat = openmm.MonteCarloBarostat(1.0, 300.0)
        each.addForce(barostat)
        context = openmm.Context(each, openmm.VerletIntegrator(0.001), REFERENCE)
        context.setPositions(x)
        before = context.getState(energy=True).getPotentialEnergy()._value
        molecules = context.getMolecules()
        scaled = x.copy()
        for molecule in map(list, molecules):
            scaled[molecule] += 0.02 * x[molecule].mean(axis=0)
        context.setPeriodicBoxVectors(*(1.02 * EDGE * np.eye(3)))
        context.setPositions(scaled)
        differences.append(context.getState(energy=True).getPotentialEnergy()._value - before)
        assert barostat.computeCurrentPressure(context)._value != 0.0
        differences.append(barostat.computeCurrentPressure(context)._value)
    np.testing.assert_allclose(differences[:2], differences[2:], rtol=1e-6)


def test_a_run_is_the_same():
    system, x, bodies = mixture(True)
    excluded = copy.deepcopy(system)
    rb.exclude_within(excluded, bodies)
    ends = []
    for each in (system, excluded):
        integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", bodies=bodies)
        context = openmm.Context(each, integrator, REFERENCE)
        context.setPositions(x)
        integrator.setVelocitiesToTemperature(300, 1)
        integrator.step(20)
        ends.append(context.getState(positions=True).getPositions(asNumpy=True)._value)
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-10)
