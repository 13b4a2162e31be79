"""Flexible molecules: constrained clusters and free atoms in a Context."""

import io

import numpy as np
import openmm
import pytest
from openmm import app, unit
from scipy import stats

import openmm_exactrb as rb
from orders import slope
from peptides import FORCE_FIELD, PEPTIDE, R, end_of, in_water, moving, peptide, positions_of, violations
from places import REFERENCE
from starts import context_of, force_of, simulation_of, velocities_of

pytestmark = pytest.mark.usefixtures("every_engine")

# -- constraints ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("constraints", ["HBonds", "AllBonds", "HAngles"])
def test_constraints_hold_to_roundoff(constraints):
    _, system, x = peptide(constraints)
    integrator, context = moving(system, x)
    integrator.step(40)
    moved, v = positions_of(context), velocities_of(context)
    assert np.abs(moved - x).max() > 1e-3
    length, slip = violations(system, moved, v)
    assert length < 1e-15
    assert slip < 1e-14
    # OpenMM, whose tolerance is another one, finds nothing to put right either.
    context.applyVelocityConstraints(1e-10)
    np.testing.assert_allclose(velocities_of(context), v, atol=1e-12)


@pytest.mark.parametrize("constraints", ["HBonds", "AllBonds", "HAngles", "None"])
def test_degrees_of_freedom_are_those_of_openmm(constraints):
    _, system, x = peptide(constraints)
    integrator, _context = moving(system, x)
    assert sum(integrator.degreesOfFreedom()) == 3 * 22 - system.getNumConstraints()
    system.addForce(openmm.CMMotionRemover())
    integrator, _context = moving(system, x)
    assert sum(integrator.degreesOfFreedom()) == 3 * 22 - system.getNumConstraints() - 3


def test_energies_are_those_of_openmm_for_the_same_particles():
    _, system, x = peptide()
    integrator, context = moving(system, x)
    integrator.step(3)
    state, v = context.getState(energy=True), velocities_of(context)
    mass = np.array([system.getParticleMass(i)._value for i in range(22)])
    kinetic = sum(e._value for e in integrator.kineticEnergies())
    assert kinetic == pytest.approx(0.5 * float(mass @ (v * v).sum(axis=1)), rel=1e-12)
    assert kinetic == pytest.approx(state.getKineticEnergy()._value, rel=1e-12)
    assert integrator.totalEnergy()._value == pytest.approx(kinetic + state.getPotentialEnergy()._value, rel=1e-12)


def test_momenta_are_drawn_from_the_canonical_distribution():
    """Twice the kinetic energy over kT is a chi-square number of all degrees of freedom."""
    _, system, x = peptide()
    integrator, _context = moving(system, x)
    freedom = sum(integrator.degreesOfFreedom())
    energies = []
    for seed in range(300):
        integrator.setVelocitiesToTemperature(300.0, seed)
        energies.append(2.0 * sum(e._value for e in integrator.kineticEnergies()) / (300.0 * R))
    assert stats.kstest(energies, stats.chi2(freedom).cdf).pvalue > 0.01


def test_positions_off_the_constraints_are_put_on_them_with_a_warning():
    _, system, x = peptide()
    off = x.copy()
    off[3] += [0.004, -0.003, 0.002]  # a hydrogen of a methyl group
    context = context_of(system, rb.ExactRigidBodyIntegrator(0.0005), off)
    with pytest.warns(rb.ShapeWarning, match=r"for the cluster of particles 0, 1, 2, 3"):
        context.getIntegrator().step(0)
    put, v = positions_of(context), velocities_of(context)
    assert violations(system, put, v)[0] < 1e-15
    mass = np.array([12.01, 1.008, 1.008, 1.008])
    np.testing.assert_allclose(mass @ put[:4], mass @ off[:4], atol=1e-4)  # the centre stays


# -- orders -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("constraints", "scheme", "time", "steps"),
    [
        ("AllBonds", "Chin4B", 0.008, (8, 11, 16)),
        ("None", "Chin4B", 0.008, (8, 11, 16)),
        ("HBonds", "S2_2", 0.008, (8, 11, 16)),
        ("None", "W4_5", 0.008, (8, 11, 16)),
        ("AllBonds", "S6_10", 0.010, (4, 6, 8)),
        ("HBonds", "KL8_17", 0.020, (4, 6, 8)),
    ],
)
def test_schemes_keep_their_order_in_water(constraints, scheme, time, steps):
    """Flexible clusters, single atoms and rigid bodies that turn, each acting on the others."""
    _, system, x = in_water(constraints)
    order = rb.SCHEMES[scheme].order
    time = 0.5 * time if constraints == "None" else time
    assert slope(end_of(system, x, scheme, time), steps) == pytest.approx(order, abs=0.2)


# -- OpenMM's own tools -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"fast": "bonded"}])
def test_a_checkpoint_continues_bit_for_bit(options):
    topology, system, x = peptide()
    rb.separate_bonded(system)
    ends = []
    for interrupted in (False, True):
        integrator = rb.ExactRigidBodyIntegrator(0.001, "W4_5", **options)
        simulation = simulation_of(topology, system, integrator, x)
        integrator.setVelocitiesToTemperature(300.0, 1)
        simulation.step(7)
        if interrupted:
            file = io.BytesIO()
            simulation.saveCheckpoint(file)
            integrator = rb.ExactRigidBodyIntegrator(0.001, "W4_5", **options)
            simulation = app.Simulation(topology, system, integrator, REFERENCE)
            file.seek(0)
            simulation.loadCheckpoint(file)
        simulation.step(6)
        ends.append(simulation.integrator.fullState()[1])
    for whole, resumed in zip(*ends, strict=True):
        np.testing.assert_array_equal(resumed, whole)


def test_calls_may_be_split_without_a_bit_of_difference():
    _, system, x = peptide()
    ends = []
    for parts in ((6,), (2, 1, 3)):
        integrator, _context = moving(system, x)
        for n in parts:
            integrator.step(n)
        ends.append(integrator.fullState()[1])
    for whole, split in zip(*ends, strict=True):
        np.testing.assert_array_equal(split, whole)


def test_the_minimum_is_one_along_the_constraints():
    _, system, x = peptide()
    integrator, context = moving(system, x)
    integrator.step(30)
    twin = context_of(system, openmm.VerletIntegrator(0.001), positions_of(context))
    integrator.minimizeEnergy(tolerance=1.0)
    assert violations(system, positions_of(context), velocities_of(context))[0] < 1e-15
    openmm.LocalEnergyMinimizer.minimize(twin, 0.1)
    ours, theirs = (c.getState(energy=True).getPotentialEnergy()._value for c in (context, twin))
    assert ours == pytest.approx(theirs, abs=0.01)


def test_openmm_minimises_too():
    topology, system, x = peptide()
    simulation = simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.001), x)
    simulation.minimizeEnergy()
    simulation.integrator.setVelocitiesToTemperature(300.0, 1)
    before = simulation.integrator.totalEnergy()._value
    simulation.step(20)
    assert simulation.integrator.totalEnergy()._value == pytest.approx(before, abs=0.05)


def test_virtual_sites_on_flexible_parents_hand_their_forces_on():
    _, system, x = peptide()
    system.addParticle(0.0)
    system.setVirtualSite(22, openmm.TwoParticleAverageSite(0, 8, 0.5, 0.5))
    nonbonded = force_of(system)
    nonbonded.addParticle(0.0, 0.3, 0.0)
    pull = openmm.CustomExternalForce("100*(x - 1)^2")
    pull.addParticle(22)
    system.addForce(pull)
    end = end_of(system, np.vstack([x, np.zeros(3)]), "W4_5", 0.008)
    assert slope(end, (8, 11, 16)) == pytest.approx(4, abs=0.2)


def test_a_thermostat_and_a_barostat_leave_the_constraints_and_the_rest_alone():
    pdb = app.PDBFile(str(PEPTIDE))
    topology = pdb.topology
    topology.setPeriodicBoxVectors(3.0 * np.eye(3) * unit.nanometer)
    system = FORCE_FIELD.createSystem(topology, nonbondedMethod=app.CutoffPeriodic, constraints=app.HBonds)
    for update in (openmm.MonteCarloBarostat(1.0, 300.0, 1), openmm.AndersenThermostat(300.0, 100.0)):
        update.setRandomNumberSeed(1)
        system.addForce(update)
    _, _, x = peptide()
    integrator, context = moving(system, x)
    box = context.getState().getPeriodicBoxVolume()._value
    integrator.step(40)
    assert context.getState().getPeriodicBoxVolume()._value != box
    length, slip = violations(system, positions_of(context), velocities_of(context))
    assert length < 1e-14
    assert slip < 1e-13


@pytest.mark.opencl
def test_the_native_engine_makes_the_inner_steps_of_the_host():
    system, bond, charges = openmm.System(), openmm.HarmonicBondForce(), openmm.NonbondedForce()
    for i, mass in enumerate((12.0, 1.0, 12.0, 1.0)):
        system.addParticle(mass)
        charges.addParticle(0.1 * (-1) ** i, 0.3, 0.2)
    for i in (0, 2):
        bond.addBond(i, i + 1, 0.109, 284512.0)
        charges.addException(i, i + 1, 0.0, 1.0, 0.0)
    for force in (bond, charges):
        system.addForce(force)
    x = np.array([[0.0, 0, 0], [0.109, 0, 0], [0, 0.5, 0], [0.109, 0.5, 0]])
    ends = []
    for engine in ("host", "native"):
        integrator, context = moving(openmm.XmlSerializer.clone(system), x, engine=engine, beside="native")
        for h in (0.0005, 0.002, 0.004):
            integrator.setStepSize(h)
            integrator.step(2)
        assert integrator.getEngine() == engine
        assert integrator.timings.fast_evaluations > 0
        ends.append(positions_of(context))
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-13)
