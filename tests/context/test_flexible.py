"""Flexible molecules: constrained clusters and free atoms in a Context, and forces within the drifts."""

import copy
import io
import pickle
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import app, unit
from scipy import stats

import openmm_exactrb as rb
from orders import slope

REFERENCE = openmm.Platform.getPlatform("Reference")
PEPTIDE = Path(__file__).parents[2] / "examples" / "data" / "alanine_dipeptide.pdb"
FORCE_FIELD = app.ForceField("amber14-all.xml", "amber14/tip3p.xml")
CONSTRAINTS = {"HBonds": app.HBonds, "AllBonds": app.AllBonds, "HAngles": app.HAngles, "None": None}
R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


def peptide(constraints="HBonds", **options):
    """Return topology, System and positions (nm), on the constraints, of alanine dipeptide in vacuum."""
    pdb = app.PDBFile(str(PEPTIDE))
    system = FORCE_FIELD.createSystem(
        pdb.topology, constraints=CONSTRAINTS[constraints], removeCMMotion=False, **options
    )
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    context.setPositions(pdb.positions)
    context.applyConstraints(1e-9)
    return pdb.topology, system, positions_of(context)


def moving(system, x, h=0.0005, scheme="S2_2", temperature=300.0, **options):
    """Return our integrator and its Context, with momenta of a temperature."""
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, **options)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(x)
    integrator.setVelocitiesToTemperature(temperature, 3)
    return integrator, context


def positions_of(context):
    return context.getState(positions=True).getPositions(asNumpy=True)._value.copy()


def velocities_of(context):
    return context.getState(velocities=True).getVelocities(asNumpy=True)._value.copy()


def violations(system, x, v):
    """Return by how much (nm) lengths are missed, and the velocities along constraints times their lengths."""
    constraints = [system.getConstraintParameters(i) for i in range(system.getNumConstraints())]
    lengths = [abs(np.linalg.norm(x[i] - x[j]) - d._value) for i, j, d in constraints]
    slips = [abs((x[i] - x[j]) @ (v[i] - v[j])) for i, j, _ in constraints]
    return max(lengths), max(slips)


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


def test_positions_off_the_constraints_are_put_on_them_with_a_word():
    _, system, x = peptide()
    off = x.copy()
    off[3] += [0.004, -0.003, 0.002]  # a hydrogen of a methyl group
    context = openmm.Context(system, rb.ExactRigidBodyIntegrator(0.0005), REFERENCE)
    context.setPositions(off)
    with pytest.warns(rb.ShapeWarning, match=r"in the cluster of particles 0, 1, 2, 3"):
        context.getIntegrator().step(0)
    put, v = positions_of(context), velocities_of(context)
    assert violations(system, put, v)[0] < 1e-15
    mass = np.array([12.01, 1.008, 1.008, 1.008])
    np.testing.assert_allclose(mass @ put[:4], mass @ off[:4], atol=1e-4)  # the centre stays


def test_positions_far_from_the_constraints_are_refused():
    _, system, x = peptide()
    context = openmm.Context(system, rb.ExactRigidBodyIntegrator(0.0005), REFERENCE)
    x[3] += [0.0, 0.0, 5.0]
    context.setPositions(x)
    with pytest.raises(ValueError, match=r"the cluster of particles 0, 1, 2, 3 is .* away from its shape"):
        context.getIntegrator().step(1)


def test_a_singular_place_is_refused():
    """A rhombus of constraints that lies on a line."""
    system = openmm.System()
    for _ in range(4):
        system.addParticle(10.0)
    for i in range(4):
        system.addConstraint(i, (i + 1) % 4, 0.1)
    context = openmm.Context(system, rb.ExactRigidBodyIntegrator(0.001), REFERENCE)
    context.setPositions(np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.1, 0, 0]]))
    with pytest.raises(ValueError, match="singular place"):
        context.getIntegrator().step(1)


# -- orders -----------------------------------------------------------------------------------------------------


def end_of(system, x, scheme, time, **options):
    """Return end(n), the positions (3, 22) after n steps over a time from the same state."""
    start, _context = moving(system, x)
    start.step(20)
    _, state = start.fullState()

    def end(n):
        integrator, context = moving(system, x, time / n, scheme, **options)
        integrator.setBodyState(state)
        integrator.step(n)
        return positions_of(context).T

    return end


@pytest.mark.parametrize("constraints", ["HBonds", "AllBonds", "None"])
@pytest.mark.parametrize(
    ("scheme", "steps"), [("S2_2", (8, 16)), ("W4_5", (8, 16)), ("Chin4B", (8, 16)), ("S6_10", (4, 8))]
)
def test_schemes_keep_their_order(constraints, scheme, steps):
    _, system, x = peptide(constraints)
    time = 0.004 if constraints == "None" else 0.008
    order = {"S2_2": 2, "W4_5": 4, "Chin4B": 4, "S6_10": 6}[scheme]
    assert slope(end_of(system, x, scheme, time), steps) == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("constraints", ["HBonds", "None"])
@pytest.mark.parametrize(("scheme", "order"), [("S2_2", 2), ("W4_5", 4)])
def test_nested_schemes_keep_their_order(constraints, scheme, order):
    _, system, x = peptide(constraints)
    rb.separate_bonded(system)
    end = end_of(system, x, scheme, 0.008, fast="bonded", inner=scheme, innerSteps=1)
    assert slope(end, (4, 8)) == pytest.approx(order, abs=0.2)


# -- forces within the drifts -----------------------------------------------------------------------------------


def test_nesting_bonded_forces_evaluates_the_others_as_often_as_before():
    _, system, x = peptide()
    assert rb.separate_bonded(system) == 1
    plain, _one = moving(system, x)
    nested, _other = moving(system, x, fast="bonded")
    for integrator in (plain, nested):
        integrator.timings.reset()
        integrator.step(10)
    assert nested.timings.evaluations == plain.timings.evaluations == 21
    assert (plain.timings.fast_evaluations, nested.timings.fast_evaluations) == (0, 41)
    assert nested.totalEnergy()._value == pytest.approx(plain.totalEnergy()._value, abs=0.1)


def test_a_step_that_bonds_do_not_bear_is_borne_when_they_are_nested():
    """What the feature is for: 4 fs a force evaluation, where plain Verlet has several kJ/mol."""
    _, system, x = peptide("None")
    rb.separate_bonded(system)
    errors = []
    for fast in (None, "bonded"):
        integrator, _context = moving(system, x, 0.003, "V2", fast=fast)
        before = integrator.totalEnergy()._value
        try:
            integrator.step(100)
            errors.append(abs(integrator.totalEnergy()._value - before))
        except rb.NonFiniteError:
            errors.append(np.inf)
    assert errors[1] < 1.0
    assert errors[0] > 20.0 * errors[1]


def test_shared_groups_are_refused_with_what_to_do():
    _, system, x = peptide()
    with pytest.raises(ValueError, match=r"NonbondedForce are both in force group 0.*separate_bonded"):
        moving(system, x, fast="bonded")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fast": (7,)}, "no force in group 7"),
        ({"fast": (0, 1)}, "fast names all forces"),
        ({"fast": (0,)}, "innerSteps="),  # no bonds in it that tell how fast it is
    ],
)
def test_groups_that_cannot_be_nested_are_refused(options, message):
    _, system, x = peptide()
    rb.separate_bonded(system)
    with pytest.raises(ValueError, match=message):
        moving(system, x, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fast": "angles"}, 'fast is None, "bonded" or force groups'),
        ({"fast": (32,)}, 'fast is None, "bonded" or force groups'),
        ({"fast": ()}, 'fast is None, "bonded" or force groups'),
        ({"fast": "bonded", "inner": "V2_C17"}, "drifts and kicks alone"),
        ({"fast": "bonded", "innerSteps": 0}, "innerSteps"),
    ],
)
def test_what_is_no_nesting_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        rb.ExactRigidBodyIntegrator(0.001, **options)


def test_copies_nest_as_the_original_does():
    integrator = rb.ExactRigidBodyIntegrator(0.002, fast=(1, 2), inner="V2", innerSteps=3)
    for twin in (copy.copy(integrator), pickle.loads(pickle.dumps(integrator))):
        assert twin.getNesting() == integrator.getNesting()


def energy_and_forces(system, x, platform=REFERENCE):
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), platform)
    context.setPositions(x)
    state = context.getState(energy=True, forces=True)
    return state.getPotentialEnergy()._value, state.getForces(asNumpy=True)._value


@pytest.mark.parametrize("method", ["NoCutoff", "CutoffPeriodic", "PME", "LJPME"])
@pytest.mark.parametrize("periodic", [False, True])
def test_exceptions_become_bonded_forces_of_the_same_energy(method, periodic):
    """Also where molecules reach across the box, and where the reciprocal sum has these pairs taken out."""
    pdb = app.PDBFile(str(PEPTIDE))
    pdb.topology.setPeriodicBoxVectors(2.2 * np.eye(3) * unit.nanometer)
    system = FORCE_FIELD.createSystem(
        pdb.topology, nonbondedMethod=getattr(app, method), nonbondedCutoff=0.8 * unit.nanometer, removeCMMotion=False
    )
    x = np.array(pdb.positions.value_in_unit(unit.nanometer))
    (nonbonded,) = (f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    if periodic:
        nonbonded.setExceptionsUsePeriodicBoundaryConditions(True)
        x[0] += [2.2, 0.0, 0.0]
        for force in system.getForces():
            getattr(force, "setUsesPeriodicBoundaryConditions", lambda _: None)(True)
    before = energy_and_forces(system, x)
    group = rb.separate_bonded(system, exceptions=True)
    pairs = system.getForce(system.getNumForces() - 1)
    assert isinstance(pairs, openmm.CustomBondForce)
    assert (pairs.getNumBonds(), pairs.getForceGroup()) == (41, group)
    for after in (energy_and_forces(system, x), energy_and_forces(copy.deepcopy(system), x)):
        assert after[0] == pytest.approx(before[0], rel=1e-10)
        np.testing.assert_allclose(after[1], before[1], rtol=1e-9, atol=1e-7)
    assert rb.separate_bonded(system, exceptions=True) == group  # there is nothing left to move
    assert pairs.getNumBonds() == 41
    assert system.getForce(system.getNumForces() - 1).getNumBonds() == 41


def test_exceptions_with_parameters_of_the_context_stay():
    _, system, _ = peptide()
    (nonbonded,) = (f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    nonbonded.addGlobalParameter("scale", 1.0)
    nonbonded.addExceptionParameterOffset("scale", 0, 0.1, 0.0, 0.0)
    with pytest.raises(ValueError, match=r"parameter offsets.*leave exceptions=True away"):
        rb.separate_bonded(system, exceptions=True)


# -- OpenMM's own tools -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"fast": "bonded"}])
def test_a_checkpoint_goes_on_bit_for_bit(options):
    topology, system, x = peptide()
    rb.separate_bonded(system)
    ends = []
    for interrupted in (False, True):
        integrator = rb.ExactRigidBodyIntegrator(0.001, "W4_5", **options)
        simulation = app.Simulation(topology, system, integrator, REFERENCE)
        simulation.context.setPositions(x)
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
    twin = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    twin.setPositions(positions_of(context))
    integrator.minimizeEnergy(tolerance=1.0)
    assert violations(system, positions_of(context), velocities_of(context))[0] < 1e-15
    openmm.LocalEnergyMinimizer.minimize(twin, 0.1)
    ours, theirs = (c.getState(energy=True).getPotentialEnergy()._value for c in (context, twin))
    assert ours == pytest.approx(theirs, abs=0.01)


def test_openmm_minimises_too():
    topology, system, x = peptide()
    simulation = app.Simulation(topology, system, rb.ExactRigidBodyIntegrator(0.001), REFERENCE)
    simulation.context.setPositions(x)
    simulation.minimizeEnergy()
    simulation.integrator.setVelocitiesToTemperature(300.0, 1)
    before = simulation.integrator.totalEnergy()._value
    simulation.step(20)
    assert simulation.integrator.totalEnergy()._value == pytest.approx(before, abs=0.05)


def test_virtual_sites_on_flexible_parents_hand_their_forces_on():
    _, system, x = peptide()
    system.addParticle(0.0)
    system.setVirtualSite(22, openmm.TwoParticleAverageSite(0, 8, 0.5, 0.5))
    (nonbonded,) = (f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    nonbonded.addParticle(0.0, 0.3, 0.0)
    pull = openmm.CustomExternalForce("100*(x - 1)^2")
    pull.addParticle(22)
    system.addForce(pull)
    end = end_of(system, np.vstack([x, np.zeros(3)]), "W4_5", 0.008)
    assert slope(end, (8, 16)) == pytest.approx(4, abs=0.2)


def test_heavier_hydrogens_change_nothing_else():
    _, system, x = peptide(hydrogenMass=3.0 * unit.dalton)
    integrator, context = moving(system, x)
    integrator.step(20)
    assert violations(system, positions_of(context), velocities_of(context))[0] < 1e-15


def test_a_thermostat_and_a_barostat_leave_the_constraints_and_the_rest_alone():
    pdb = app.PDBFile(str(PEPTIDE))
    topology = pdb.topology
    topology.setPeriodicBoxVectors(3.0 * np.eye(3) * unit.nanometer)
    system = FORCE_FIELD.createSystem(topology, nonbondedMethod=app.CutoffPeriodic, constraints=app.HBonds)
    system.addForce(openmm.MonteCarloBarostat(1.0, 300.0, 1))
    thermostat = openmm.AndersenThermostat(300.0, 100.0)
    thermostat.setRandomNumberSeed(1)
    system.addForce(thermostat)
    _, _, x = peptide()
    integrator, context = moving(system, x)
    box = context.getState().getPeriodicBoxVolume()._value
    integrator.step(40)
    assert context.getState().getPeriodicBoxVolume()._value != box
    length, slip = violations(system, positions_of(context), velocities_of(context))
    assert length < 1e-14
    assert slip < 1e-13


# -- baths and engines ------------------------------------------------------------------------------------------


def test_strong_friction_makes_every_kinetic_energy_canonical():
    """The noise acts along the constraints only: a chi-square number of all degrees of freedom after each step."""
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1e5, 1e-4)
    integrator.setRandomNumberSeed(4)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(x)
    freedom, energies = sum(integrator.degreesOfFreedom()), []
    for _ in range(300):
        integrator.step(1)
        energies.append(2.0 * sum(e._value for e in integrator.kineticEnergies()) / (300.0 * R))
    assert stats.kstest(energies, stats.chi2(freedom).cdf).pvalue > 0.01
    length, slip = violations(system, positions_of(context), velocities_of(context))
    assert length < 1e-15
    assert slip < 1e-13


def test_rescaling_accounts_for_the_energy_along_the_constraints_alone():
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.02, 0.0005, "W4_5")
    integrator.setRandomNumberSeed(4)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(x)
    integrator.setVelocitiesToTemperature(300.0, 1)
    before = integrator.effectiveEnergy()._value
    integrator.step(100)
    assert abs(integrator.heat()._value) > 1.0
    assert integrator.effectiveEnergy()._value == pytest.approx(before, abs=1e-3)


BATHS = {
    "Langevin": lambda h, **options: rb.ExactRigidBodyLangevinIntegrator(300.0, 0.0, h, **options),
    "rescaling": lambda h, **options: rb.ExactRigidBodyRescalingIntegrator(300.0, 1e300, h, **options),
    "hybrid": lambda h, **options: rb.ExactRigidBodyHybridIntegrator(300.0, 0.0, h, **options),
}


def bathed(integrator, system, x, seed=4):
    integrator.setRandomNumberSeed(seed)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(x)
    integrator.setVelocitiesToTemperature(300.0, 3)
    return context


@pytest.mark.parametrize("scheme", ["S2_2", "W4_5"])
@pytest.mark.parametrize("bath", ["Langevin", "hybrid"])
def test_a_bath_that_does_nothing_leaves_the_nested_trajectory_bit_for_bit(bath, scheme):
    _, system, x = peptide()
    rb.separate_bonded(system)
    alone, _context = moving(system, x, 0.001, scheme, fast="bonded")
    integrator = BATHS[bath](0.001, scheme=scheme, fast="bonded")
    _other = bathed(integrator, system, x)
    for moved in (alone, integrator):
        moved.timings.reset()
        moved.step(20)
    if bath == "hybrid":
        assert integrator.acceptanceRate() == 1.0  # else momenta would have turned
    for ours, plain in zip(integrator.fullState()[1], alone.fullState()[1], strict=True):
        np.testing.assert_array_equal(ours, plain)
    assert integrator.timings.evaluations == alone.timings.evaluations
    assert integrator.timings.fast_evaluations == alone.timings.fast_evaluations


def test_a_bath_within_a_step_leaves_the_bonded_forces_about_it():
    """BAOAB without friction is velocity Verlet: each half of its drift has half of the inner steps."""
    _, system, x = peptide()
    rb.separate_bonded(system)
    plain, _one = moving(system, x, 0.001, "V2", fast="bonded", inner="S2_2", innerSteps=2)
    within = rb.ExactRigidBodyLangevinIntegrator(300.0, 0.0, 0.001, "BAOAB", fast="bonded", inner="S2_2", innerSteps=2)
    _other = bathed(within, system, x)
    for moved in (plain, within):
        moved.step(20)
    for ours, theirs in zip(within.bodyState()[1], plain.bodyState()[1], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-10)
    assert within.timings.fast_evaluations == plain.timings.fast_evaluations


@pytest.mark.parametrize("maker", BATHS.values(), ids=BATHS)
def test_copies_of_baths_nest_as_the_original_does(maker):
    integrator = maker(0.002, fast=(1, 2), inner="V2", innerSteps=3)
    for twin in (copy.copy(integrator), pickle.loads(pickle.dumps(integrator))):
        assert type(twin) is type(integrator)
        assert twin.getNesting() == integrator.getNesting()


def test_rescaling_nested_keeps_the_effective_energy():
    _, system, x = peptide()
    rb.separate_bonded(system)
    integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.02, 0.002, "W4_5", fast="bonded")
    _context = bathed(integrator, system, x)
    before = integrator.effectiveEnergy()._value
    integrator.step(50)
    assert abs(integrator.heat()._value) > 1.0
    assert integrator.effectiveEnergy()._value == pytest.approx(before, abs=1e-2)


def quadratic_cluster():
    """Return a System of XH3 whose members are drawn to places, by forces of two groups, and these (nm).

    Both are harmonic: what holds the cluster, and the bond from its middle to an atom that stands still.
    """
    system = openmm.System()
    for mass in (12.0, 1.0, 1.0, 1.0, 0.0):
        system.addParticle(mass)
    places = np.array([[0.0, 0, 0], [0.1, 0, 0.03], [-0.05, 0.087, 0.03], [-0.05, -0.087, 0.03], [0, 0, -0.15]])
    for i in range(1, 4):
        system.addConstraint(0, i, float(np.linalg.norm(places[i])))
    field = openmm.CustomExternalForce("500*(x^2 + y^2 + 2*z^2)")
    for i in range(1, 4):
        field.addParticle(i)
    bond = openmm.HarmonicBondForce()
    bond.addBond(0, 4, 0.15, 3e5)
    bond.setForceGroup(1)
    for force in (field, bond):
        system.addForce(force)
    return system, places


@pytest.mark.parametrize("bath", ["Langevin", "hybrid"])
def test_equipartition_of_a_nested_constrained_cluster(bath):
    """Twice the kinetic energy is kT for each degree of freedom, with steps that only nesting bears."""
    system, x = quadratic_cluster()
    h = 0.012  # the bond alone turns by 2 within a step
    kind = {"Langevin": rb.ExactRigidBodyLangevinIntegrator, "hybrid": rb.ExactRigidBodyHybridIntegrator}[bath]
    integrator = kind(300.0, 5.0, h, "S2_2", fast="bonded")
    _context = bathed(integrator, system, x)
    freedom, ratios = sum(integrator.degreesOfFreedom()), []
    assert freedom == 9
    integrator.step(200)
    for _ in range(800):
        integrator.step(4)
        ratios.append(2.0 * sum(e._value for e in integrator.kineticEnergies()) / (300.0 * R * freedom))
    blocks = np.reshape(ratios, (20, -1)).mean(axis=1)
    error = blocks.std(ddof=1) / np.sqrt(20)
    assert np.mean(ratios) == pytest.approx(1.0, abs=4.0 * error)
    assert error < 0.04  # a bath that heats what constraints hold would be off by a third
    if bath == "hybrid":
        assert 0.5 < integrator.acceptanceRate() < 1.0


def test_more_proposals_are_taken_where_bonds_are_nested():
    _, system, x = peptide("None")
    rb.separate_bonded(system)
    rates = []
    for fast in (None, "bonded"):
        integrator = rb.ExactRigidBodyHybridIntegrator(300.0, 5.0, 0.008, "S2_2", stepsPerProposal=2, fast=fast)
        _context = bathed(integrator, system, x)
        integrator.step(60)
        rates.append(integrator.acceptanceRate())
    assert rates[1] > 0.8
    assert rates[1] > rates[0] + 0.2


def test_the_device_is_refused_for_clusters_and_nesting():
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyIntegrator(0.0005, engine="device")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(x)
    with pytest.raises(ValueError, match="a motion of its own, which the device does not follow"):
        integrator.step(1)
    with pytest.raises(ValueError, match="fast="):
        rb.ExactRigidBodyIntegrator(0.0005, fast="bonded", engine="device")
