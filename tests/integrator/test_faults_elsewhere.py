"""Faults that users of other programs reported, tried here; each test names the report."""

import itertools

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
import starts

CO2 = 0.116 * np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
BODY = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.2, 1.1, 0.0], [0.1, 0.3, 0.7]])


def rigid(masses, shapes):
    """Return a System of molecules with all their distances constrained."""
    system = openmm.System()
    for x in shapes:
        first = system.getNumParticles()
        for mass in masses:
            system.addParticle(mass)
        for i, j in itertools.combinations(range(len(x)), 2):
            system.addConstraint(first + i, first + j, np.linalg.norm(x[i] - x[j]))
    return system


@pytest.mark.parametrize(("mass", "size"), [(1e-12, 1e-4), (1e6, 1e3)])
def test_moments_of_inertia_may_be_tiny(mass, size):
    """LAMMPS issue 1657: bodies below a threshold did not turn. A free rotation does not depend on units."""
    found = []
    for m, s in ((1.0, 1.0), (mass, size)):
        masses, x = m * np.array([1.0, 2.0, 3.0, 1.5]), s * BODY
        context = starts.context_of(rigid(masses, [x]), rb.ExactRigidBodyIntegrator(0.002), x)
        context.setVelocities(np.cross([3.0, 2.0, -1.0], x - masses @ x / masses.sum()))
        context.getIntegrator().step(100)
        found.append(starts.positions_of(context) / s)
    np.testing.assert_allclose(found[1], found[0], atol=1e-13)
    assert np.abs(found[0] - BODY).max() > 0.3


@pytest.mark.parametrize(
    "integrator",
    [
        rb.ExactRigidBodyIntegrator(0.004),
        rb.ExactRigidBodyLangevinIntegrator(300, 1, 0.004),
        rb.ExactRigidBodyNoseHooverIntegrator(300, 1, 0.004),
    ],
    ids=["W2_1", "BAOA", "BAOAB"],
)
def test_positions_and_velocities_are_those_of_one_time(integrator):
    """A report on the list of GROMACS users (November 2015): angles of 89.5 degrees between a bond and its velocity."""
    _, system, x = rb.rigid_water(8)
    context = starts.context_of(system, integrator, x, kelvin=300.0)
    integrator.step(11)
    state = context.getState(positions=True, velocities=True)
    x, v = (a._value for a in (state.getPositions(asNumpy=True), state.getVelocities(asNumpy=True)))
    for i, j, _ in map(system.getConstraintParameters, range(system.getNumConstraints())):
        bond, velocity = x[i] - x[j], v[i] - v[j]
        assert abs(bond @ velocity) < 1e-14 * np.linalg.norm(bond) * np.linalg.norm(velocity)


@pytest.mark.parametrize(
    "make",
    [
        lambda h: rb.ExactRigidBodyNoseHooverIntegrator(200, 5, h),
        pytest.param(lambda h: rb.ExactRigidBodyLangevinIntegrator(200, 1e-6, h), marks=pytest.mark.validate),
        lambda h: rb.ExactRigidBodyRescalingIntegrator(200, 1e6, h),
    ],
    ids=["Nosé-Hoover", "Langevin", "rescaling"],
)
def test_conserved_energies_stay_beside_fixed_molecules(make):
    """i-PI issue 422: they drifted where atoms were fixed. Here their errors are of order 2."""
    _, system, x = rb.rigid_water(27)
    fixed = {0, 1, 2, 30, 31, 32}
    for k in reversed(range(system.getNumConstraints())):
        if fixed & {*system.getConstraintParameters(k)[:2]}:
            system.removeConstraint(k)
    for k in fixed:
        system.setParticleMass(k, 0.0)
    deviations = []
    for h in (0.002, 0.001):
        context = starts.context_of(system, make(h), x)
        integrator = context.getIntegrator()
        integrator.setRandomNumberSeed(1)
        integrator.minimizeEnergy(maxIterations=100)
        integrator.setVelocitiesToTemperature(200.0, 1)
        read = integrator.effectiveEnergy
        energies = []
        for _ in range(10):
            integrator.step(round(0.01 / h))
            energies.append(read()._value)
        deviations.append(np.std(energies))
    assert 3.2 < deviations[0] / deviations[1] < 4.8
    assert deviations[1] < 0.05


@pytest.mark.parametrize("places", [0.0, 7.0, np.nan])
def test_given_places_of_virtual_sites_do_not_matter(places):
    """OpenMM issue 3736 and openmmtools issue 695: wrong ones ended in NaN."""
    _, system, x = rb.rigid_water(8, model="tip4pew")
    found = []
    for given in (None, places):
        y = np.array(x._value)
        if given is not None:
            y[3::4] = given
        context = starts.context_of(system, rb.ExactRigidBodyIntegrator(0.002), y, kelvin=300.0)
        context.getIntegrator().step(5)
        found.append(starts.positions_of(context))
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("atom", [None, 4], ids=["whole", "by atom"])
def test_molecules_may_be_thousands_of_boxes_away(atom):
    """LAMMPS issue 4109: a restart failed where molecules had crossed many boundaries."""
    # Not at 0: the neighbour list of OpenMM's Reference platform misses pairs of a particle at -1e-17.
    shapes = [CO2 + np.array([0.3 + 0.45 * k, 0.3 + 0.1 * k, 0.4]) for k in range(4)]
    system, edge = rigid([12.0, 16.0, 16.0], shapes), 2.0
    force = openmm.NonbondedForce()
    force.setNonbondedMethod(force.CutoffPeriodic)
    force.setCutoffDistance(0.9)
    for _ in range(12):
        force.addParticle(0.0, 0.3, 0.5)
    for k in range(0, 12, 3):
        for i, j in itertools.combinations(range(k, k + 3), 2):
            force.addException(i, j, 0.0, 1.0, 0.0)
    system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*(edge * np.eye(3)))
    v, found = np.concatenate([np.cross([3.0, -2.0, 0.5 * k], CO2) for k in range(4)]), []
    for far in (0.0, 1700.0):
        x = np.concatenate(shapes)
        x[3:6] += far * edge * np.array([1.0, -1.0, 0.0])
        if far and atom is not None:
            x[atom] += edge * np.array([1234.0, 0.0, -77.0])
        context = starts.context_of(system, rb.ExactRigidBodyIntegrator(0.002), x, v)
        context.getIntegrator().step(50)
        y = starts.positions_of(context)
        assert np.linalg.norm(y[3] - y[4]) == pytest.approx(0.116, abs=1e-11)
        found.append(y - edge * np.round((y - np.concatenate(shapes)) / edge))
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)


@pytest.mark.parametrize("named", [False, True], ids=["constrained", "named"])
def test_dumbbells_have_the_pressure_of_their_centres(named):
    """LAMMPS pull request 5065: the virial of rigid bodies depended on where they are, and on the thermostat."""
    n, edge, masses, places = 27, 3.0, np.array([10.0, 30.0]), []
    system, pairs, bonds = openmm.System(), openmm.NonbondedForce(), openmm.HarmonicBondForce()
    rng, barostat = np.random.default_rng(1), openmm.MonteCarloBarostat(1.0, 300.0, 0)
    for k, centre in enumerate(itertools.product((0.5, 1.5, 2.5), repeat=3)):
        half = rng.normal(size=3)
        places += [centre + 0.1 * half / np.linalg.norm(half), centre - 0.1 * half / np.linalg.norm(half)]
        for mass in masses:
            system.addParticle(mass)
            pairs.addParticle(0.0, 0.3, 0.5)
        pairs.addException(2 * k, 2 * k + 1, 0.0, 1.0, 0.0)
        if named:  # for OpenMM a molecule is what bonds or constraints join
            bonds.addBond(2 * k, 2 * k + 1, 0.2, 0.0)
        else:
            system.addConstraint(2 * k, 2 * k + 1, 0.2)
    pairs.setNonbondedMethod(pairs.CutoffPeriodic)
    pairs.setCutoffDistance(1.0)
    pairs.setUseSwitchingFunction(True)
    pairs.setSwitchingDistance(0.8)
    pairs.setUseDispersionCorrection(False)
    system.setDefaultPeriodicBoxVectors(*(edge * np.eye(3)))
    for force in (pairs, bonds, barostat):
        system.addForce(force)
    bodies = np.arange(2 * n).reshape(n, 2).tolist() if named else None
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 2.0, 0.004, bodies=bodies)
    integrator.setRandomNumberSeed(1)
    context = starts.context_of(system, integrator, np.array(places), kelvin=300.0)
    integrator.step(100)
    found = barostat.computeCurrentPressure(context).value_in_unit(unit.bar)
    x, v = starts.positions_of(context).reshape(n, 2, 3), starts.velocities_of(context).reshape(n, 2, 3)
    energies = []
    for scale in (1.001, 0.999):
        context.setPeriodicBoxVectors(*(scale * edge * np.eye(3)))
        context.setPositions((x + (scale - 1.0) * x.mean(axis=1, keepdims=True)).reshape(-1, 3))
        energies.append(context.getState(energy=True).getPotentialEnergy()._value)
    virial = -(energies[0] - energies[1]) / 0.002
    momenta = np.einsum("s,nsi->ni", masses, v)
    pressure = (
        ((momenta**2).sum() / masses.sum() + virial) / (3.0 * edge**3) * unit.kilojoule_per_mole / unit.nanometer**3
    )
    bar = (pressure / unit.AVOGADRO_CONSTANT_NA).value_in_unit(unit.bar)
    assert found == pytest.approx(bar, rel=1e-5)


def test_the_total_momentum_of_a_periodic_box_stays():
    """HOOMD issue 1468: that of rigid bodies did not stay."""
    _, system, x = rb.rigid_water(27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4)
    integrator = rb.ExactRigidBodyIntegrator(0.002)
    context = starts.context_of(system, integrator, x, kelvin=300.0)
    masses = starts.masses_of(system)
    before = masses @ starts.velocities_of(context)
    integrator.step(200)
    np.testing.assert_allclose(masses @ starts.velocities_of(context), before, atol=1e-10)


def test_a_ferrofluid_in_a_field_has_langevins_magnetisation():
    """At low density the mean of the cosine is coth(x) - 1/x, with x the energy in the field over kT."""
    kelvin, x, n = 300.0, 2.0, 64
    field = x * starts.R * kelvin
    _, system, positions = rb.dipole_fluid(n, dipole=(0.0, 0.0, 1.0), spacing=50.0)
    sites = [k for k in range(system.getNumParticles()) if system.isVirtualSite(k)]
    arrows = np.array(sites).reshape(n, 2)
    force = openmm.CustomCompoundBondForce(2, f"-{field}*(z2-z1)/distance(p1,p2)")
    for pair in arrows.tolist():
        force.addBond(pair, [])
    system.addForce(force)
    integrator = rb.ExactRigidBodyLangevinIntegrator(kelvin, 2.0, 0.02)
    integrator.setRandomNumberSeed(2)
    context = starts.context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(kelvin, 1)
    found = []
    for _ in range(50):
        integrator.step(25)
        places = starts.positions_of(context)
        arrow = places[arrows[:, 1]] - places[arrows[:, 0]]
        found.append((arrow[:, 2] / np.linalg.norm(arrow, axis=1)).mean())
    expected, variance = 1 / np.tanh(x) - 1 / x, 1 / x**2 - 1 / np.sinh(x) ** 2
    assert abs(np.mean(found[10:]) - expected) < 4.0 * np.sqrt(variance / (n * 40 / 3))


@pytest.mark.validate
def test_metadynamics_of_the_distance_of_a_dimer_finds_its_free_energy():
    """Two rigid molecules bound by a spring: the free energy is that of the spring less 2 kT ln r."""
    kelvin, stiff, mean = 300.0, 400.0, 0.6
    kT, shapes = starts.R * kelvin, [CO2, CO2 + np.array([mean, 0.0, 0.0])]
    system = rigid([12.0, 16.0, 16.0], shapes)
    spring, distance = openmm.HarmonicBondForce(), openmm.CustomBondForce("r")
    spring.addBond(0, 3, mean, stiff)
    distance.addBond(0, 3, [])
    system.addForce(spring)
    topology = app.Topology()
    residue = topology.addResidue("DIM", topology.addChain())
    for k in range(6):
        topology.addAtom(f"A{k}", None, residue)
    variable = app.BiasVariable(distance, 0.3, 0.9, 0.03, False, 61)
    bias = app.Metadynamics(system, [variable], kelvin * unit.kelvin, 6.0, 0.3 * unit.kilojoule_per_mole, 20)
    integrator = rb.ExactRigidBodyLangevinIntegrator(kelvin, 5.0, 0.004)
    integrator.setRandomNumberSeed(3)
    simulation = starts.simulation_of(topology, system, integrator, np.concatenate(shapes))
    integrator.setVelocitiesToTemperature(kelvin, 1)
    bias.step(simulation, 160_000)
    r = np.linspace(0.3, 0.9, 61)
    turning = -2.0 * kT * np.log(r)
    exact = 0.5 * stiff * (r - mean) ** 2 + turning
    near = exact - exact.min() < 3.0 * kT
    error = (bias.getFreeEnergy()._value - exact)[near]
    assert np.std(error) < 0.5 * np.std(turning[near])
