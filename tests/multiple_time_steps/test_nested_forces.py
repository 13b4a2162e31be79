"""Multiple time steps: which forces may be fast, what they keep, and pairs that become bonded forces."""

import copy
import re
import warnings
from dataclasses import replace

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.multiple_time_steps.excerpt import bonded_excerpt
from openmm_exactrb.multiple_time_steps.stiffness import fastest
from orders import slope
from peptides import FORCE_FIELD, PEPTIDE, bonded_apart, end_of, moving, peptide, positions_of
from places import HOST_AND_NATIVE, REFERENCE
from starts import context_of, force_of, system_of


@pytest.mark.parametrize("constraints", ["HBonds", "None"])
@pytest.mark.parametrize(("scheme", "order"), [("S2_2", 2), ("W4_5", 4)])
def test_nested_schemes_keep_their_order(constraints, scheme, order):
    _, system, x = peptide(constraints)
    end = end_of(system, x, scheme, 0.008, fast="bonded", inner=scheme, innerSteps=1)
    assert slope(end, (4, 6, 8)) == pytest.approx(order, abs=0.2)


def test_default_inner_steps_err_no_more_than_the_outer_ones():
    """At 2000 evaluations of the other forces per ps, where longer inner steps, four times, err 32 times as far."""
    _, system, x = peptide()
    usual = end_of(system, x, "SRKN4_6b", 0.015, fast="bonded")(5)
    finer = end_of(system, x, "SRKN4_6b", 0.015, fast="bonded", innerSteps=60)
    once = finer(5)
    assert np.abs(usual - once).max() < 5.0 * np.abs(once - finer(10)).max()


@pytest.mark.parametrize("by", ["bonded", "group"])
def test_what_was_fitted_to_rigid_molecules_is_not_shown_of_flexible_ones(by):
    """W4_4's output is: the inverse of its processor is shown in its place."""
    _, system, x = peptide()
    fast = "bonded" if by == "bonded" else (rb.separate_bonded(system),)
    ends = []
    for scheme in (rb.SCHEMES["W4_4"], replace(rb.SCHEMES["W4_4"], output=())):
        integrator, context = moving(system, x, 0.008, scheme, fast=fast)
        integrator.step(3)
        ends.append(positions_of(context))
    np.testing.assert_array_equal(*ends)
    output, _context = moving(system, x, 0.002, replace(rb.SCHEMES["W4_4"], output_of_rigid=False), fast=fast)
    output.timings.reset()
    output.step(3)
    exact, _other = moving(system, x, 0.002, "W4_4", fast=fast)
    exact.timings.reset()
    exact.step(3)
    assert exact.timings.evaluations > output.timings.evaluations


def test_nesting_bonded_forces_evaluates_the_others_as_often_as_before():
    _, system, x = peptide()
    plain, _one = moving(system, x, engine="host")
    nested, _other = moving(system, x, fast="bonded", engine="host")
    for integrator in (plain, nested):
        integrator.timings.reset()
        integrator.step(10)
    assert nested.timings.evaluations == plain.timings.evaluations == 21
    assert (plain.timings.fast_evaluations, nested.timings.fast_evaluations) == (0, 41)
    assert nested.totalEnergy()._value == pytest.approx(plain.totalEnergy()._value, abs=0.1)


def test_a_step_that_bonds_do_not_bear_is_borne_when_they_are_nested():
    """What the feature is for: 4 fs per force evaluation, where plain Verlet has several kJ/mol."""
    _, system, x = peptide("None")
    errors = []
    for fast in (None, "auto"):
        integrator, _context = moving(system, x, 0.003, "V2", fast=fast)
        before = integrator.totalEnergy()._value
        try:
            integrator.step(100)
            errors.append(abs(integrator.totalEnergy()._value - before))
        except rb.IntegrationError:
            errors.append(np.inf)
    assert errors[1] < 1.0
    assert errors[0] > 20.0 * errors[1]


@pytest.mark.parametrize("scheme", ["S2_2", "W2_1", "Chin4B"])
def test_bonded_forces_need_no_group_of_their_own(scheme):
    """The same steps as with force groups that tell them apart, in a System with all forces in one, which stays so."""
    _, system, x = peptide()
    before = openmm.XmlSerializer.serialize(system)
    taken, apart = (copy.deepcopy(system) for _ in range(2))
    group = bonded_apart(apart)
    ends = []
    for own, fast in ((taken, "bonded"), (apart, (group,))):
        integrator, _context = moving(own, x, 0.002, scheme, fast=fast, inner="S2_2", innerSteps=4)
        integrator.step(20)
        ends.append(integrator.bodyState()[1])
    for a, b in zip(*ends, strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-10)
    assert openmm.XmlSerializer.serialize(taken) == before


def test_groups_may_be_whole_numbers_of_numpy():
    integrator = rb.ExactRigidBodyIntegrator(0.001, fast=np.array([2, 1, 2]))
    assert integrator.getMultipleTimeSteps().fast == (1, 2)


def energy_and_forces(system, x, platform=REFERENCE):
    context = context_of(system, openmm.VerletIntegrator(0.001), x, platform=platform)
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
    nonbonded = force_of(system)
    if periodic:
        nonbonded.setExceptionsUsePeriodicBoundaryConditions(True)
        x[0] += [2.2, 0.0, 0.0]
        for force in system.getForces():
            getattr(force, "setUsesPeriodicBoundaryConditions", lambda _: None)(True)
    before = energy_and_forces(system, x)
    group = bonded_apart(system)
    pairs = system.getForce(system.getNumForces() - 1)
    assert isinstance(pairs, openmm.CustomBondForce)
    assert (pairs.getNumBonds(), pairs.getForceGroup()) == (41, group)
    for after in (energy_and_forces(system, x), energy_and_forces(copy.deepcopy(system), x)):
        assert after[0] == pytest.approx(before[0], rel=1e-10)
        np.testing.assert_allclose(after[1], before[1], rtol=1e-9, atol=1e-7)


def test_a_force_that_came_after_the_context_does_not_act():
    """As OpenMM has it, until the Context is reinitialised."""
    _, system, x = peptide()
    ends = []
    for late in (False, True):
        integrator, context = moving(system, x, 0.004)
        if late:
            force = openmm.CustomBondForce("stiff*r")
            force.addGlobalParameter("stiff", 10.0)
            force.addBond(0, 20)
            system.addForce(force)
        integrator.step(5)
        ends.append(positions_of(context))
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-7)


def test_pairs_are_not_taken_from_a_force_without_direct_space():
    """OpenMM has the exceptions in the direct part: a force that is the reciprocal part alone has none."""
    _, system, x = peptide()
    system.setDefaultPeriodicBoxVectors(*(2.2 * np.eye(3)))
    nonbonded = force_of(system)
    nonbonded.setNonbondedMethod(openmm.NonbondedForce.PME)
    nonbonded.setIncludeDirectSpace(False)
    before = energy_and_forces(system, x)
    forces = system.getNumForces()
    bonded_apart(system)
    assert system.getNumForces() == forces
    assert energy_and_forces(system, x)[0] == pytest.approx(before[0], rel=1e-12)
    excerpt = bonded_excerpt(system, find_bodies(system, x))
    assert not any(isinstance(force, openmm.CustomBondForce) for force in excerpt.system.getForces())


def test_bonds_of_a_formula_are_as_fast_as_they_are():
    """The frequencies of the same bonds as HarmonicBondForce and by a formula, in Morse's potential about as high."""
    _, system, _ = peptide("None")
    bonds = force_of(system, openmm.HarmonicBondForce)
    exact = fastest(system)
    for formula in ("0.5*k*(r-length)^2", "4000*(1-exp(-sqrt(k/8000)*(r-length)))^2"):
        other = openmm.XmlSerializer.clone(system)
        for i in reversed(range(other.getNumForces())):
            if isinstance(other.getForce(i), openmm.HarmonicBondForce):
                other.removeForce(i)
        assert fastest(other) < 0.6 * exact  # of the angles
        force = openmm.CustomBondForce(formula)
        force.addPerBondParameter("length")
        force.addPerBondParameter("k")
        for i, j, length, k in map(bonds.getBondParameters, range(bonds.getNumBonds())):
            force.addBond(i, j, [length, k])
        other.addForce(force)
        assert fastest(other) == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize("options", [{}, {"fast": "bonded"}, {"innerSteps": 4}])
def test_steps_of_no_time_leave_all_where_it_is(options):
    _, system, x = peptide()
    integrator, context = moving(system, x, 0.0, **options)
    before = positions_of(context)
    integrator.step(3)
    np.testing.assert_allclose(positions_of(context), before, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("engine", HOST_AND_NATIVE)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"fast": (7,)},
            r"the force groups in fast= \(7\) contain no forces: choose from the force groups of this System \(0, 1\)",
        ),
        ({"fast": (7,), "innerSteps": 4}, r"the force groups in fast= \(7\) contain no forces"),
        ({"fast": (1,)}, "no bonds, and no harmonic angles .* set the number of inner steps per step with innerSteps="),
    ],
)
def test_groups_without_bonded_forces_have_nothing_to_nest_and_say_so(options, message, engine):
    """As a script for any molecule names the group that `separate_bonded` returns, and is given water."""
    ends = []
    for fast in (options, {"fast": None}):
        _, system, positions = rb.rigid_water(2)
        nonbonded = force_of(system)
        field = openmm.CustomExternalForce("y^2")
        for particle in range(system.getNumParticles()):
            field.addParticle(particle, [])
        for force in system.getForces():
            force.setForceGroup(0)
        nonbonded.setForceGroup(1)
        system.addForce(field)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            integrator, context = moving(system, positions, 0.001, "S2_2", engine=engine, **fast)
            integrator.step(5)
        assert integrator.timings.fast_evaluations == 0
        assert len(told) == (fast is options)
        assert not told or re.search(f"there are no inner steps, because .*{message}", str(told[0].message))
        ends.append(positions_of(context))
    np.testing.assert_array_equal(*ends)


def test_a_group_of_bonded_forces_of_rigid_water_has_nothing_to_nest():
    _, system, positions = rb.rigid_water(2)
    with pytest.warns(UserWarning, match="there are no inner steps"):
        integrator, _context = moving(system, positions, 0.001, "S2_2", fast=(rb.separate_bonded(system),))
    integrator.step(2)
    assert integrator.timings.fast_evaluations == 0


def test_angles_know_the_lengths_of_bonds_in_other_groups():
    _, system, x = peptide()
    for force in system.getForces():
        force.setForceGroup(1 if isinstance(force, openmm.HarmonicAngleForce) else 0)
    integrator, _context = moving(system, x, 0.002, "S2_2", fast=(1,))
    integrator.step(1)
    assert integrator.timings.fast_evaluations > 0


def test_a_particle_held_by_a_bond_of_no_length_moves_as_with_openmm():
    """An anchor without mass at the same place, as restraints are often made."""
    ends = []
    for fast in ("bonded", None):
        system = system_of([0.0, 12.0, 12.0])
        bonds, pull = openmm.HarmonicBondForce(), openmm.CustomExternalForce("3*x*y")
        bonds.addBond(0, 1, 0.0, 1e3)
        bonds.addBond(1, 2, 0.15, 1e5)
        pull.addParticle(2, [])
        system.addForce(bonds)
        system.addForce(pull)
        integrator, context = moving(system, [[0, 0, 0], [0, 0, 0], [0.15, 0.01, 0]], 0.0005, "W4_5", fast=fast)
        integrator.step(40)
        ends.append(positions_of(context))
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.0, atol=1e-7)


def test_times_of_nested_forces_are_no_free_motion():
    _, system, x = peptide()
    integrator, _context = moving(system, x, 0.004, "S2_2", fast="bonded")
    integrator.step(20)
    timings = integrator.timings
    assert timings.forces + timings.rotor < timings.total
