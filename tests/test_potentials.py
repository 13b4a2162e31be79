"""The soft dipole potential: energy, forces and torques against formulas of their own and finite differences."""

import itertools

import numpy as np
import openmm
import pytest
from openmm import unit
from scipy.spatial.transform import Rotation

import openmm_exactrb as rb


def reference(R, mu, sigma=1.0, epsilon=1.0):
    """Energy, forces (N, 3) and space-frame torques (N, 3) of soft spheres with point dipoles, vector by vector."""
    energy, force, torque = 0.0, np.zeros_like(R), np.zeros_like(R)
    for i, j in itertools.combinations(range(len(R)), 2):
        r = R[i] - R[j]
        d = np.linalg.norm(r)
        energy += 4 * epsilon * (sigma / d) ** 12
        energy += mu[i] @ mu[j] / d**3 - 3 * (mu[i] @ r) * (mu[j] @ r) / d**5
        pull = 48 * epsilon * sigma**12 * r / d**14
        pull += 3 / d**5 * ((mu[i] @ mu[j]) * r + (mu[j] @ r) * mu[i] + (mu[i] @ r) * mu[j])
        pull -= 15 / d**7 * (mu[i] @ r) * (mu[j] @ r) * r
        force[i] += pull
        force[j] -= pull
        field_at_i = 3 * (mu[j] @ r) * r / d**5 - mu[j] / d**3
        field_at_j = 3 * (mu[i] @ r) * r / d**5 - mu[i] / d**3
        torque[i] += np.cross(mu[i], field_at_i)
        torque[j] += np.cross(mu[j], field_at_j)
    return energy, force, torque


@pytest.fixture(params=["paper", "tetrahedron"])
def fluid(request):
    options = (
        {}
        if request.param == "paper"
        else {"inertia": (1.0, 1.5, 2.0), "dipole": (0.3, -0.8, 0.5), "mass": 3.0, "sigma": 0.9, "epsilon": 1.7}
    )
    _, system, positions = rb.dipole_fluid(9, seed=3, perturbation=0.05, **options)
    context = openmm.Context(system, rb.ExactRigidBodyIntegrator(0.01), openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    return context, options


def particles(context):
    return context.getState(positions=True).getPositions(asNumpy=True)._value.reshape(9, -1, 3).copy()


def energy_of(context, x):
    context.setPositions(x.reshape(-1, 3))
    context.computeVirtualSites()
    return context.getState(energy=True).getPotentialEnergy()._value


def forces_and_torques(context):
    """Return total forces and space-frame torques of the bodies."""
    x = particles(context)
    system = context.getSystem()
    mass = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())]).reshape(9, -1)
    F = context.getState(forces=True).getForces(asNumpy=True)._value.reshape(x.shape) * (mass > 0)[..., None]
    centre = np.einsum("ns,nsi->ni", mass, x) / mass.sum(1, keepdims=True)
    return centre, F.sum(1), np.cross(x - centre[:, None], F).sum(1)


def test_energy_forces_and_torques_agree_with_the_vector_formula(fluid):
    context, options = fluid
    x = particles(context)
    centre, tip = x[:, -2], x[:, -1]
    strength = np.linalg.norm(options.get("dipole", (0.0, 1.0, 1.0)))
    mu = (tip - centre) * (strength / np.linalg.norm(tip - centre, axis=1, keepdims=True))
    energy, force, torque = reference(centre, mu, options.get("sigma", 1.0), options.get("epsilon", 1.0))
    _, F, tau = forces_and_torques(context)
    assert abs(energy_of(context, x) - energy) < 1e-12 * abs(energy)
    np.testing.assert_allclose(F, force, rtol=0.0, atol=1e-12 * np.abs(force).max())
    np.testing.assert_allclose(tau, torque, rtol=0.0, atol=1e-12 * max(1.0, np.abs(torque).max()))


def test_forces_and_torques_are_finite_differences_of_openmms_energy(fluid):
    context, _ = fluid
    x = particles(context)
    centre, F, tau = forces_and_torques(context)
    d = 1e-3
    for body, axis in itertools.product((0, 4, 8), range(3)):
        e = np.eye(3)[axis]

        def moved(s, body=body, e=e):
            y = x.copy()
            y[body] += s * e
            return energy_of(context, y)

        def turned(s, body=body, e=e):
            y = x.copy()
            y[body] = centre[body] + Rotation.from_rotvec(s * e).apply(x[body] - centre[body])
            return energy_of(context, y)

        for function, expected in ((moved, F[body, axis]), (turned, tau[body, axis])):
            slope = (8 * (function(d) - function(-d)) - (function(2 * d) - function(-2 * d))) / (12 * d)
            assert abs(slope + expected) < 1e-8 * max(1.0, np.abs(F).max())


def test_total_force_and_total_torque_are_zero(fluid):
    context, _ = fluid
    centre, F, tau = forces_and_torques(context)
    assert np.abs(F.sum(0)).max() < 1e-13 * np.abs(F).sum()
    assert np.abs((tau + np.cross(centre, F)).sum(0)).max() < 1e-12 * np.abs(F).sum()


def test_energy_does_not_change_when_all_bodies_move_turn_or_change_places(fluid, rng):
    context, _ = fluid
    x = particles(context)
    energy = energy_of(context, x)
    turn = Rotation.random(rng=rng)
    for same in (x + np.array([1.0, -2.0, 0.5]), turn.apply(x.reshape(-1, 3)), x[rng.permutation(9)]):
        assert abs(energy_of(context, np.asarray(same)) - energy) < 1e-12 * abs(energy)


def test_the_force_survives_xml(fluid):
    context, _ = fluid
    x = particles(context)
    system = openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(context.getSystem()))
    again = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    assert energy_of(again, x) == energy_of(context, x)


def test_two_dipoles_head_to_tail_bind_where_r9_is_4():
    force = rb.soft_dipole_force([(0, 1), (2, 3)], strength=2**0.5, length=0.5)

    def energy(r):
        free = openmm.System()
        for _ in range(4):
            free.addParticle(1.0)
        free.addForce(openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(force)))
        context = openmm.Context(free, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
        context.setPositions(np.array([[0, 0, 0], [0, 0, 0.5], [0, 0, r], [0, 0, r + 0.5]]))
        return context.getState(energy=True).getPotentialEnergy()._value

    r = 4 ** (1 / 9)
    assert energy(r) == pytest.approx(-4 / r**3 + 4 / r**12, rel=1e-13)
    assert energy(r) < min(energy(0.999 * r), energy(1.001 * r))


def test_a_dipole_moment_takes_units():
    assert rb.dipole_strength(1.5) == 1.5
    coulomb = 138.93545764438198
    e_nm = unit.elementary_charge * unit.nanometer
    assert rb.dipole_strength(0.1 * e_nm) == pytest.approx(0.1 * coulomb**0.5, rel=1e-12)
    assert rb.dipole_strength(2.35 * unit.debye) == pytest.approx(2.35 * 0.0208194334 * coulomb**0.5, rel=1e-8)
    with pytest.raises(ValueError, match="is not a dipole moment"):
        rb.dipole_strength(1.0 * unit.nanometer)


def test_two_charges_are_as_strong_as_their_dipole():
    """Far away a pair of charges +-q at a distance d is the dipole q d: OpenMM's Coulomb energy, in its own units."""
    charge, d, r = 0.4, 1e-3, 1.0
    system = openmm.System()
    force = openmm.NonbondedForce()
    for q in (charge, -charge, charge, -charge):
        system.addParticle(1.0)
        force.addParticle(q, 1.0, 0.0)
    force.addException(0, 1, 0.0, 1.0, 0.0)
    force.addException(2, 3, 0.0, 1.0, 0.0)
    system.addForce(force)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    z = np.array([d / 2, -d / 2, r + d / 2, r - d / 2])
    context.setPositions(np.column_stack([0 * z, 0 * z, z]))
    strength = rb.dipole_strength(charge * d * unit.elementary_charge * unit.nanometer)
    energy = context.getState(energy=True).getPotentialEnergy()._value
    assert energy == pytest.approx(-2 * strength**2 / r**3, rel=1e-4)
