"""Bodies named by hand and OpenMM's own functions: minimisation, virtual sites, temperatures of groups."""

import warnings

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from places import REFERENCE
from starts import R, apart, masses_of, positions_of, system_of, velocities_of
from thermostatted import simulation_of


def domains(remover=False):
    """Return a chain of 16 beads, two domains of five and a linker, beside four waters; its bodies and positions."""
    rng = np.random.default_rng(3)
    system, bonds, pairs = openmm.System(), openmm.HarmonicBondForce(), openmm.CustomNonbondedForce("2*(0.4/r)^8")
    x = [[0.38 * k, 0.1 * (k % 2), 0.05 * (k % 3)] for k in range(16)]
    for k in range(16):
        system.addParticle(100.0 + k)
        if k:
            bonds.addBond(k - 1, k, 0.3, 8000.0)
    for k in range(4):
        first = system.getNumParticles()
        for mass, place in ((16.0, [0.0, 0.0, 0.0]), (1.0, [0.1, 0.0, 0.0]), (1.0, [-0.02, 0.09, 0.0])):
            system.addParticle(mass)
            x.append(np.array([1.0 + k, 2.0, 0.3]) + place)
        for i, j in ((0, 1), (0, 2), (1, 2)):
            length = float(np.linalg.norm(np.subtract(x[first + i], x[first + j])))
            system.addConstraint(first + i, first + j, length)
    for _ in range(system.getNumParticles()):
        pairs.addParticle([])
    for force in (bonds, pairs):
        system.addForce(force)
    if remover:
        system.addForce(openmm.CMMotionRemover())
    return system, np.array(x) + 0.01 * rng.standard_normal((len(x), 3)) * (np.arange(len(x)) < 16)[:, None]


DOMAINS = [range(5), range(11, 16)]
GROUPS = {"domains": [*range(5), *range(11, 16)], "linker": range(5, 11), "water": range(16, 28)}


def test_the_minimiser_of_the_integrator_keeps_their_shape_and_openmms_is_refused():
    system, x = domains()
    simulation = simulation_of(rb.ExactRigidBodyIntegrator(0.001, bodies=DOMAINS), system, x)
    before = simulation.context.getState(energy=True).getPotentialEnergy()
    for minimise in (simulation.minimizeEnergy, lambda: openmm.LocalEnergyMinimizer.minimize(simulation.context)):
        with pytest.raises(openmm.OpenMMException, match=r"deform the bodies .* call integrator\.minimizeEnergy\(\)"):
            minimise()
    np.testing.assert_array_equal(positions_of(simulation), x)
    simulation.integrator.minimizeEnergy(maxIterations=20)
    assert simulation.context.getState(energy=True).getPotentialEnergy() < before
    y = positions_of(simulation)
    for body in DOMAINS:
        np.testing.assert_allclose(apart(y[list(body)]), apart(x[list(body)]), rtol=0.0, atol=1e-13)
    assert np.abs(y - x).max() > 1e-3


def test_the_minimiser_is_openmms_where_no_body_is_named():
    system, x = domains()
    ends = []
    for integrator in (rb.ExactRigidBodyIntegrator(0.001), openmm.VerletIntegrator(0.001)):
        simulation = simulation_of(integrator, system, x)
        simulation.minimizeEnergy(maxIterations=20)
        ends.append(positions_of(simulation))
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize("remover", [False, True])
def test_temperatures_of_groups_are_those_of_momenta_that_were_drawn(remover):
    """Means over draws, against the temperature and the spread of chi-squared variables."""
    system, x = domains(remover)
    simulation = simulation_of(rb.ExactRigidBodyIntegrator(0.001, bodies=DOMAINS), system, x)
    integrator, found = simulation.integrator, []
    for seed in range(400):
        integrator.setVelocitiesToTemperature(300, seed)
        found.append([[t._value for t in pair] for pair in integrator.temperatures(GROUPS).values()])
    mean = np.mean(found, axis=0)
    freedom = np.array([[6, 6], [18, 0], [12, 12]]) - remover * 3 * np.array([[1, 0]]) * shares(system)[:, None]
    expected, spread = np.full((3, 2), 300.0), 300.0 * np.sqrt(2.0 / (400 * np.maximum(freedom, 1)))
    expected[1, 1] = np.nan
    assert (np.abs(mean - expected)[freedom > 0] < 4.0 * spread[freedom > 0]).all()
    np.testing.assert_array_equal(np.isnan(mean), freedom == 0)


def shares(system):
    mass = masses_of(system)
    return np.array([mass[list(group)].sum() for group in GROUPS.values()]) / mass.sum()


def test_groups_share_the_energy_of_all():
    system, x = domains()
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=DOMAINS)
    _kept = simulation_of(integrator, system, x)
    integrator.setVelocitiesToTemperature(300, 1)
    of_groups, freedom = integrator.temperatures(groups=GROUPS), np.array([[6, 6], [18, 0], [12, 12]])
    temperatures = np.nan_to_num([[t._value for t in pair] for pair in of_groups.values()])
    energies = 0.5 * R * (freedom * temperatures).sum(axis=0)
    np.testing.assert_allclose(energies, [energy._value for energy in integrator.kineticEnergies()], rtol=1e-12)


@pytest.mark.parametrize(
    ("group", "message"),
    [
        ([0, 1], r"group 'x' contains only some particles of body 0 \(particles 0, 1, 2, 3, 4\): name all"),
        ([99], "the particles of group 'x' must be numbers from 0 to 27, not 99"),
        ([0.5], "groups must be lists of particle indices"),
    ],
)
def test_groups_that_are_none_are_refused(group, message):
    system, x = domains()
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=DOMAINS)
    _kept = simulation_of(integrator, system, x)
    with pytest.raises(ValueError, match=message):
        integrator.temperatures(groups={"x": group})


def test_a_group_has_all_atoms_of_a_cluster():
    system = system_of(3 * [12.0], [(k, k + 1, 0.15) for k in range(2)])
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    _kept = simulation_of(integrator, system, np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0], [0.15, 0.15, 0.0]]))
    integrator.setVelocitiesToTemperature(300, 1)
    (alone,) = integrator.temperatures(groups={"chain": range(3)}).values()
    assert alone[0]._value == pytest.approx(integrator.temperatures()[0]._value, rel=1e-12)
    with pytest.raises(
        ValueError, match="group 'x' contains only some particles of the cluster of particles 1, 0, 2: name"
    ):
        integrator.temperatures(groups={"x": [0, 1]})


def test_a_body_whose_masses_openmm_moved_to_four_particles_is_pointed_out():
    """As createRigidBodies leaves a domain: four particles with mass, which hold the others as virtual sites."""
    rng = np.random.default_rng(1)
    x, system = rng.uniform(-1.0, 1.0, (12, 3)), system_of(4 * [25.0] + 8 * [0.0])
    for k in range(4, 12):
        system.setVirtualSite(k, openmm.LocalCoordinatesSite([0, 1, 2], [1, 0, 0], [-1, 1, 0], [-1, 0, 1], x[k]))
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=[range(12)])
    _kept = simulation_of(integrator, system, x)
    with pytest.warns(rb.ShapeWarning, match="8 of the 12 particles of body 0 are virtual sites and do not contribute"):
        integrator.step(1)


def test_a_named_water_with_a_virtual_site_is_not():
    topology, system, positions = rb.rigid_water(1, model="tip4pew", nonbondedMethod=app.NoCutoff)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=[range(4)])
        simulation = app.Simulation(topology, system, integrator, REFERENCE)
        simulation.context.setPositions(positions)
        integrator.step(1)


def lone_chain():
    """Return the chain of `domains` alone."""
    (full, x), bonds = domains(), openmm.HarmonicBondForce()
    system = system_of(masses_of(full)[:16])
    for k in range(1, 16):
        bonds.addBond(k - 1, k, 0.3, 8000.0)
    system.addForce(bonds)
    return system, x[:16]


def angular_momentum(context):
    x, v, masses = positions_of(context), velocities_of(context), masses_of(context.getSystem())
    return np.cross(x - masses @ x / masses.sum(), masses[:, None] * v).sum(axis=0)


@pytest.mark.parametrize(
    ("integrator", "kept"),
    [
        (lambda **bodies: rb.ExactRigidBodyNoseHooverIntegrator(300, 5, 0.005, together=True, **bodies), True),
        (lambda **bodies: rb.ExactRigidBodyNoseHooverIntegrator(300, 5, 0.005, **bodies), False),
        (lambda **bodies: rb.ExactRigidBodyLangevinIntegrator(300, 5, 0.005, **bodies), False),
    ],
    ids=["one chain", "two chains", "Langevin"],
)
def test_one_chain_never_turns_the_angular_momentum_of_a_lone_molecule(integrator, kept):
    """Its rotation as a whole has the temperature of its start: OpenMM's issue 3993."""
    system, x = lone_chain()
    integrator = integrator(bodies=DOMAINS)
    integrator.setRandomNumberSeed(1)
    simulation = simulation_of(integrator, system, x)
    integrator.setVelocitiesToTemperature(300, 1)
    before = angular_momentum(simulation.context)
    simulation.step(200)
    after = angular_momentum(simulation.context)
    assert integrator.degreesOfFreedom() == (3 * (2 + 6), 6)
    assert abs(np.linalg.norm(after) / np.linalg.norm(before) - 1.0) > 0.02
    angle = np.linalg.norm(np.cross(before, after)) / np.linalg.norm(before) / np.linalg.norm(after)
    assert (angle < 1e-10) == kept
