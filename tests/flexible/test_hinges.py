"""Hinges and linkages: flat places are passed, singular ones are errors, and cholesterol moves in its membrane."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from benchmarks.constraints import martini, martini_rings
from starts import context_of, system_of

EVERY_ENGINE = pytest.mark.usefixtures("every_engine")

SIDE, SPEED = 0.2, 2.0


def test_the_levels_of_martini_are_those_of_its_paper():
    """Marrink et al. (2007), table 1: water is I, an apolar bead repels water at VIII, charges in oil at IX."""
    strength, size = martini.lennard_jones()
    at = {name: k for k, name in enumerate(martini.TYPES)}
    for one, other, expected, width in (
        ("P4", "P4", 5.0, 0.47),
        ("P4", "C1", 2.0, 0.47),
        ("Q0", "C1", 2.0, 0.62),
        ("Qa", "P4", 5.6, 0.47),
        ("C1", "C1", 3.5, 0.47),
        ("SC1", "SC1", 0.75 * 3.5, 0.43),
    ):
        assert (strength[at[one], at[other]], size[at[one], at[other]]) == (expected, width)
    np.testing.assert_array_equal(strength, strength.T)


@EVERY_ENGINE
@pytest.mark.parametrize("step", [pytest.param(0.02, marks=pytest.mark.validate), 0.03])
def test_cholesterol_in_a_small_membrane_keeps_its_constraints(step):
    topology, system, positions = martini.bilayer({"DPPC": 0.5, "CHOL": 0.5}, per_side=3, water=3.0)
    names = np.array([atom.residue.name for atom in topology.atoms()])
    integrator = rb.ExactRigidBodyLangevinIntegrator(323.0, 5.0, step, checkDivergence=False)
    integrator.setRandomNumberSeed(3)
    for force in system.getForces():  # a patch narrower than two cutoffs
        if isinstance(force, openmm.CustomNonbondedForce):
            force.setCutoffDistance(0.9)
    context = context_of(
        system, integrator, positions, platform=openmm.Platform.getPlatform("CPU"), properties={"Threads": "1"}
    )
    context.computeVirtualSites()
    integrator.setVelocitiesToTemperature(323.0, 1)
    martini.relax(integrator, step, 5.0)
    integrator.checkDivergence = True
    integrator.step(100)
    state = context.getState(positions=True)
    x = state.getPositions(asNumpy=True)._value
    for c in range(system.getNumConstraints()):
        i, j, length = system.getConstraintParameters(c)
        assert abs(np.linalg.norm(x[i] - x[j]) - length._value) < 3e-15
    chol = np.flatnonzero(names == "CHOL").reshape(-1, 8)
    assert len(integrator.bodyState()[0].clusters) == len(chol) == 8
    sites = x[chol[:, 4]] - (x[chol[:, 3]] + 0.9613 * (x[chol[:, 2]] - x[chol[:, 3]]))
    np.testing.assert_allclose(sites, 0.6320 * (x[chol[:, 6]] - x[chol[:, 3]]), rtol=0.0, atol=1e-6)
    assert 250.0 < integrator.temperatures()[0]._value < 400.0


def test_a_minimiser_that_loses_the_constraints_of_cholesterol_is_an_error():
    """Of the integrator's method at once, and after OpenMM's minimiser at the next step."""
    _, system, positions = martini.bilayer({"DPPC": 0.5, "CHOL": 0.5}, per_side=3, water=1.0, area=0.8)
    integrator = rb.ExactRigidBodyIntegrator(0.01)
    context = context_of(
        system, integrator, positions, platform=openmm.Platform.getPlatform("CPU"), properties={"Threads": "1"}
    )
    context.computeVirtualSites()
    before = context.getState(positions=True).getPositions(asNumpy=True)._value
    with pytest.raises(ArithmeticError, match="so the positions are unchanged: relax the positions before by"):
        integrator.minimizeEnergy(1000.0, 0)
    np.testing.assert_array_equal(context.getState(positions=True).getPositions(asNumpy=True)._value, before)

    def minimised_by_openmm():
        openmm.LocalEnergyMinimizer.minimize(context, 1000.0, 0)
        integrator.step(1)

    for call in (minimised_by_openmm, lambda: integrator.step(1)):
        with pytest.raises(ArithmeticError, match="could not satisfy the constraints: relax the positions before"):
            call()
    context.setPositions(before)
    integrator.step(0)


@EVERY_ENGINE
def test_a_hinge_passes_180_degrees_and_keeps_its_energy():
    """The four beads of cholesterol, thrown through the plane of both triangles."""
    molecule = martini_rings.MOLECULES["cholesterol"]
    x, masses = molecule["places"][:4].copy(), molecule["masses"][:4]
    x -= x[1]
    axis = x[2] / np.linalg.norm(x[2])
    system = system_of(masses)
    for i, j, length in molecule["constraints"]:
        system.addConstraint(i, j, length)
    integrator = rb.ExactRigidBodyIntegrator(0.02, scheme="S2_2")
    context = context_of(system, integrator, x)
    v = np.zeros((4, 3))
    v[0] = np.cross(axis, x[0])  # one wing turns about the shared side
    context.setVelocities(v)
    integrator.step(0)
    before, heights = integrator.totalEnergy()._value, []
    for _ in range(40):
        integrator.step(1)
        y = context.getState(positions=True).getPositions(asNumpy=True)._value
        heights.append(np.linalg.det([y[2] - y[1], y[0] - y[1], y[3] - y[1]]))
    context.setVelocities(-context.getState(velocities=True).getVelocities(asNumpy=True))
    for _ in range(80):  # back, through the flat start, and out on the other side
        integrator.step(1)
        y = context.getState(positions=True).getPositions(asNumpy=True)._value
        heights.append(np.linalg.det([y[2] - y[1], y[0] - y[1], y[3] - y[1]]))
    assert min(heights) < -1e-3
    assert max(heights) > 1e-3
    assert abs(integrator.totalEnergy()._value / before - 1.0) < 1e-13
    for i, j, length in molecule["constraints"]:
        assert abs(np.linalg.norm(y[i] - y[j]) - length) < 3e-15


def folding(angle, h):
    """Return the Context of four rods in a ring that fold in their plane, onto a line after the time angle/SPEED."""
    x = SIDE * np.array([[np.cos(angle), 0, 0], [0, np.sin(angle), 0], [-np.cos(angle), 0, 0], [0, -np.sin(angle), 0]])
    away = np.array([[-np.sin(angle), 0, 0], [0, np.cos(angle), 0], [np.sin(angle), 0, 0], [0, -np.cos(angle), 0]])
    system = system_of(4 * [12.0])
    for k in range(4):
        system.addConstraint(k, (k + 1) % 4, SIDE)
    integrator = rb.ExactRigidBodyIntegrator(h, "S2_2")
    context = context_of(system, integrator, x, -SPEED * SIDE * away)
    return context, integrator


@EVERY_ENGINE
def test_a_linkage_folds_at_a_constant_rate_until_close_to_its_singular_place():
    context, integrator = folding(0.3, 0.01)
    integrator.step(10)
    x = context.getState(positions=True).getPositions(asNumpy=True)._value
    np.testing.assert_allclose(x[0], [SIDE * np.cos(0.1), 0.0, 0.0], rtol=0.0, atol=1e-16)
    np.testing.assert_allclose(x[1], [0.0, SIDE * np.sin(0.1), 0.0], rtol=0.0, atol=1e-16)


@EVERY_ENGINE
@pytest.mark.parametrize(("angle", "h"), [(0.3, 0.02), (0.3, 0.05), (0.305, 0.05), (0.3, 0.3), (1e-3, 0.002)])
def test_a_step_onto_or_over_a_singular_place_is_an_error_and_leaves_the_state_before_it(angle, h):
    context, integrator = folding(angle, h)
    with pytest.raises(rb.NonFiniteError, match="the cluster of particles 0, 1, 2, 3"):
        integrator.step(40)
    x = context.getState(positions=True).getPositions(asNumpy=True)._value
    assert np.isfinite(x).all()
    for k in range(4):
        assert abs(np.linalg.norm(x[k] - x[(k + 1) % 4]) - SIDE) < 1e-15
