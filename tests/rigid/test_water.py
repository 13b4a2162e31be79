"""Any System with rigid molecules: water models, ions, linear molecules, bodies by hand, and OpenMM's own tools."""

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from starts import context_of, force_of, positions_of, simulation_of, total_energy, warm

pytestmark = pytest.mark.usefixtures("every_engine")


def energy_noise(simulation, n_samples=20, steps=5):
    energies = []
    for _ in range(n_samples):
        simulation.step(steps)
        energies.append(total_energy(simulation))
    return np.std(energies)


# -- molecules --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["tip3p", "spce", "tip4pew", "tip5p", "tip4p2005"])
def test_water_models_run_and_keep_their_energy_and_shape(model):
    topology, system, positions = rb.rigid_water(8, model=model)
    simulation = warm(topology, system, positions, h=0.001)
    bodies, _ = simulation.integrator.bodyState()
    assert len(bodies) == bodies.n_turning == 8
    coarse = energy_noise(simulation)
    simulation.integrator.setStepSize(0.0005)
    fine = energy_noise(simulation, steps=10)
    assert fine < coarse
    assert fine / 8 < 5e-3
    x = positions_of(simulation)
    for i in range(system.getNumConstraints()):
        p, q, d = system.getConstraintParameters(i)
        assert abs(np.linalg.norm(x[p] - x[q]) - d._value) < 1e-13
    if model in ("tip4pew", "tip5p", "tip4p2005"):
        assert system.isVirtualSite(3)


@pytest.fixture
def salt_water():
    """Water with two ions beside it: free particles."""
    topology, system, positions = rb.rigid_water(16)
    nonbonded = force_of(system)
    x = positions._value
    for k, (mass, charge, sigma, epsilon) in enumerate([(22.99, 1.0, 0.2439, 0.3658), (35.45, -1.0, 0.4478, 0.1489)]):
        system.addParticle(mass)
        nonbonded.addParticle(charge, sigma, epsilon)
        chain = topology.addChain()
        topology.addAtom(
            "ION", app.element.sodium if k == 0 else app.element.chlorine, topology.addResidue("ION", chain)
        )
        x = np.vstack([x, [-0.3 - 0.1 * k, 0.3 + 0.5 * k, 0.3]])
    return topology, system, x


def test_ions_move_beside_rigid_water(salt_water):
    simulation = warm(*salt_water, h=0.001)
    bodies, _ = simulation.integrator.bodyState()
    assert (len(bodies), bodies.n_turning) == (18, 16)
    assert simulation.integrator.degreesOfFreedom() == (54, 48)
    coarse = energy_noise(simulation)
    simulation.integrator.setStepSize(0.00025)
    assert energy_noise(simulation, steps=20) < coarse / 5


def linear_molecules(n=27):
    """CO2 as three atoms in line, held by three constraints, with Lennard-Jones interactions and charges."""
    system, topology = openmm.System(), app.Topology()
    force = openmm.NonbondedForce()
    chain, x = topology.addChain(), []
    for k in range(n):
        first = system.getNumParticles()
        residue = topology.addResidue("CO2", chain)
        for name, mass, charge, sigma, epsilon in (
            ("C", 12.011, 0.6512, 0.2757, 0.2339),
            ("O1", 15.999, -0.3256, 0.3033, 0.6693),
            ("O2", 15.999, -0.3256, 0.3033, 0.6693),
        ):
            system.addParticle(mass)
            force.addParticle(charge, sigma, epsilon)
            topology.addAtom(name, app.element.carbon if name == "C" else app.element.oxygen, residue)
        for i, j, d in ((0, 1, 0.1149), (0, 2, 0.1149), (1, 2, 0.2298)):
            system.addConstraint(first + i, first + j, d)
            force.addException(first + i, first + j, 0.0, 1.0, 0.0)
        centre = 0.45 * np.array(np.unravel_index(k, (3, 3, 3)))
        axis = np.roll([0.0, 0.0, 0.1149], k % 3)
        x += [centre, centre + axis, centre - axis]
    system.addForce(force)
    return topology, system, np.array(x)


def test_linear_molecules_have_five_degrees_of_freedom_and_the_right_temperature():
    topology, system, x = linear_molecules()
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme="S2_2")
    simulation = simulation_of(topology, system, integrator, x)
    assert integrator.degreesOfFreedom() == (81, 54)
    samples = []
    for seed in range(200):
        integrator.setVelocitiesToTemperature(250.0 * unit.kelvin, seed)
        samples.append([t._value for t in integrator.temperatures()])
    # A temperature of f degrees of freedom has the relative standard deviation sqrt(2/f).
    for mean, freedom in zip(np.mean(samples, axis=0), (81, 54), strict=True):
        assert abs(mean / 250.0 - 1.0) < 4.0 * np.sqrt(2.0 / freedom / 200)
    coarse = energy_noise(simulation)
    integrator.setStepSize(0.0005)
    assert energy_noise(simulation, steps=20) < coarse / 5
    _, state = integrator.bodyState()
    assert not state.m[0].any()


def flexible_ring(n_rings=4):
    """Rings of six atoms with bonds and angles but no constraints."""
    system, topology = openmm.System(), app.Topology()
    bonds, angles, pairs = openmm.HarmonicBondForce(), openmm.HarmonicAngleForce(), openmm.NonbondedForce()
    chain, x = topology.addChain(), []
    for ring in range(n_rings):
        residue = topology.addResidue("RNG", chain)
        first = 6 * ring
        for k in range(6):
            system.addParticle(13.0)
            pairs.addParticle(0.0, 0.35, 0.3)
            topology.addAtom(f"C{k}", app.element.carbon, residue)
            phi = np.pi / 3 * k
            x.append([0.14 * np.cos(phi), 0.14 * np.sin(phi), 0.42 * ring])
        for k in range(6):
            i, j, l = (first + (k + d) % 6 for d in range(3))
            bonds.addBond(i, j, 0.139, 3e5)
            angles.addAngle(i, j, l, 2.09, 500.0)
        for i in range(6):
            for j in range(i):
                pairs.addException(first + i, first + j, 0.0, 1.0, 0.0)
    for force in (bonds, angles, pairs):
        system.addForce(force)
    return topology, system, np.array(x)


def test_bodies_given_by_hand_are_rigid_and_their_inner_energy_is_a_constant():
    topology, system, x = flexible_ring()
    rings = [range(6 * k, 6 * k + 6) for k in range(4)]
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme="SRKN4_6b", bodies=rings)
    simulation = simulation_of(topology, system, integrator, x)
    for group, force in enumerate(system.getForces()):
        force.setForceGroup(group)
    simulation.context.reinitialize(preserveState=True)
    integrator.setVelocitiesToTemperature(200.0, 1)
    inner = [simulation.context.getState(energy=True, groups={0, 1}).getPotentialEnergy()._value]
    energies = [total_energy(simulation)]
    for _ in range(10):
        simulation.step(5)
        inner.append(simulation.context.getState(energy=True, groups={0, 1}).getPotentialEnergy()._value)
        energies.append(total_energy(simulation))
    assert np.ptp(inner) < 1e-9
    assert inner[0] > 1.0
    assert np.ptp(energies) < 1e-6 * np.ptp([e - i for e, i in zip(energies, range(11), strict=True)])
    bodies, _ = integrator.bodyState()
    assert len(bodies.kinds) == 1


def test_a_rigid_cluster_without_all_its_distances_takes_its_shape_from_the_positions(rng):
    system, x = openmm.System(), rng.random((5, 3))
    for _ in range(5):
        system.addParticle(2.0)
    for i in range(5):
        for j in range(i):
            if (i, j) != (4, 0):
                system.addConstraint(j, i, float(np.linalg.norm(x[i] - x[j])))
    integrator = rb.ExactRigidBodyIntegrator(0.01)
    context = context_of(system, integrator, x, rng.standard_normal((5, 3)))
    integrator.step(50)
    y = context.getState(positions=True).getPositions(asNumpy=True)._value
    assert np.linalg.norm(y[4] - y[0]) == pytest.approx(np.linalg.norm(x[4] - x[0]), rel=1e-13)


def test_particles_without_mass_stay_where_they_are(salt_water):
    topology, system, x = salt_water
    system.setParticleMass(system.getNumParticles() - 1, 0.0)
    simulation = warm(topology, system, x)
    simulation.step(20)
    np.testing.assert_array_equal(positions_of(simulation)[-1], x[-1])
