"""Forces of some groups within the drifts: what may be nested, what it keeps, and pairs that become bonded forces."""

import copy
import pickle

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from orders import slope
from peptides import FORCE_FIELD, PEPTIDE, REFERENCE, end_of, moving, peptide


@pytest.mark.parametrize("constraints", ["HBonds", "None"])
@pytest.mark.parametrize(("scheme", "order"), [("S2_2", 2), ("W4_5", 4)])
def test_nested_schemes_keep_their_order(constraints, scheme, order):
    _, system, x = peptide(constraints)
    rb.separate_bonded(system)
    end = end_of(system, x, scheme, 0.008, fast="bonded", inner=scheme, innerSteps=1)
    assert slope(end, (4, 8)) == pytest.approx(order, abs=0.2)


def test_inner_steps_that_nobody_tells_err_no_more_than_the_outer_ones():
    """At 2000 evaluations of the other forces per ps, where longer inner steps, four times, err 32 times as far."""
    _, system, x = peptide()
    rb.separate_bonded(system)
    usual = end_of(system, x, "SRKN4_6b", 0.03, fast="bonded")(10)
    finer = end_of(system, x, "SRKN4_6b", 0.03, fast="bonded", innerSteps=60)
    once = finer(10)
    assert np.abs(usual - once).max() < 5.0 * np.abs(once - finer(20)).max()


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
    """What the feature is for: 4 fs per force evaluation, where plain Verlet has several kJ/mol."""
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
        ({"fast": 1}, 'fast is None, "bonded" or force groups'),
        ({"fast": (0.5,)}, 'fast is None, "bonded" or force groups'),
        ({"fast": openmm.NonbondedForce()}, r"force\.getForceGroup\(\) tells"),
        ({"fast": (openmm.NonbondedForce(),)}, r"force\.getForceGroup\(\) tells"),
        ({"inner": "S2_2"}, "name these with fast="),
        ({"innerSteps": 2}, "name these with fast="),
        ({"fast": "bonded", "inner": "V2_C17"}, "drifts and kicks alone"),
        ({"fast": "bonded", "innerSteps": 0}, "innerSteps"),
    ],
)
def test_what_is_no_nesting_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        rb.ExactRigidBodyIntegrator(0.001, **options)


@pytest.mark.parametrize(("given", "name"), [(None, "NoneType"), (app.Topology(), "Topology")])
def test_only_a_system_has_bonded_forces(given, name):
    with pytest.raises(ValueError, match=rf"takes an openmm\.System, before a Simulation .* not {name}"):
        rb.separate_bonded(given)


def test_groups_may_be_whole_numbers_of_numpy():
    integrator = rb.ExactRigidBodyIntegrator(0.001, fast=np.array([2, 1, 2]))
    assert integrator.getNesting().fast == (1, 2)


def test_exceptions_are_moved_or_not():
    with pytest.raises(ValueError, match="exceptions must be True or False, not 'yes'"):
        rb.separate_bonded(peptide()[1], exceptions="yes")


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
