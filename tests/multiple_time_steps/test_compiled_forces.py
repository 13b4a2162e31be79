"""Bonds, angles, torsions and pairs, by the library and in NumPy, have the forces of OpenMM's Reference platform."""

import numpy as np
import openmm
import pytest

from bonded_terms import (
    FORMS,
    RNG,
    N,
    angles,
    bonds,
    maps,
    pairs,
    periodic_torsions,
    polynomial_torsions,
    system_of,
    terms_in,
)
from openmm_exactrb.multiple_time_steps import bonded_forces
from openmm_exactrb.multiple_time_steps.bonded import interacting_exceptions
from openmm_exactrb.multiple_time_steps.excerpt_forces import by_library, has_known_form
from starts import context_of


@pytest.fixture(params=[pytest.param("library", marks=pytest.mark.library), "numpy"])
def forces(request):
    """Return a function that writes forces."""
    in_numpy = request.param == "numpy"
    return bonded_forces.forces if in_numpy else lambda x, terms, out: by_library(terms)(x, out)


def both(forces, system, x, groups=-1):
    """Return the forces of a kernel and those of OpenMM."""
    out = np.empty_like(x)
    forces(x, terms_in(system, groups), out)
    context = context_of(system, openmm.VerletIntegrator(0.001), x)
    return out, context.getState(forces=True, groups=groups).getForces(asNumpy=True)._value


@pytest.mark.parametrize("make", FORMS)
def test_each_form_is_openmms(make, forces):
    system = system_of(make())
    for _ in range(20):
        ours, theirs = both(forces, system, RNG.normal(size=(N, 3)))
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-13 * abs(theirs).max())


def test_forces_of_some_groups_add_up(forces):
    some = [bonds(), angles(), periodic_torsions(), polynomial_torsions(), pairs()]
    for group, force in enumerate(some):
        force.setForceGroup(group)
    system, x = system_of(*some), RNG.normal(size=(N, 3))
    for groups in (0b00001, 0b01010, 0b11111):
        ours, theirs = both(forces, system, x, groups)
        np.testing.assert_allclose(ours, theirs, atol=1e-13 * abs(theirs).max())


@pytest.mark.parametrize("angle", [1e-7, 1e-4, np.pi - 1e-4, np.pi - 1e-7])
def test_almost_straight_angles_and_flat_torsions_keep_their_digits(angle, forces):
    force = openmm.HarmonicAngleForce()
    force.addAngle(0, 1, 2, 1.9, 500.0)
    torsion = openmm.PeriodicTorsionForce()
    torsion.addTorsion(3, 4, 5, 6, 2, 0.3, 10.0)
    x = RNG.normal(size=(N, 3))
    x[:3] = [0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.12 * np.cos(angle), 0.12 * np.sin(angle), 0.0]
    x[3:7] = [0.1, 0.1, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.15], [0.1 * np.cos(angle), 0.1 * np.sin(angle), 0.25]
    out = np.empty_like(x)
    forces(x, terms_in(system_of(force, torsion), -1), out)
    a = abs(out[0])
    assert a[1] == pytest.approx(500.0 * abs(angle - 1.9) / 0.1, rel=1e-8)  # along the arc, strength times the rest
    turn = np.array([0.1, 0.1, 0.0])
    phi = angle - np.arctan2(turn[1], turn[0])
    arm = np.hypot(*turn[:2])
    assert np.linalg.norm(out[3]) == pytest.approx(abs(20.0 * np.sin(2.0 * phi - 0.3)) / arm, rel=1e-8)


def test_two_forces_with_maps_have_their_own(forces):
    system, x = system_of(maps(), maps()), RNG.normal(size=(N, 3))
    ours, theirs = both(forces, system, x)
    np.testing.assert_allclose(ours, theirs, atol=1e-13 * abs(theirs).max())


@pytest.mark.parametrize("make", FORMS)
def test_positions_that_are_not_finite_have_such_forces(make, forces):
    x = RNG.normal(size=(N, 3))
    x[4] = np.nan
    out = np.empty_like(x)
    forces(x, terms_in(system_of(make()), -1), out)
    assert np.isnan(out[4]).all()


def with_parameter(force, name="k"):
    """Return a force with a global parameter."""
    force.addGlobalParameter(name, 1.0)
    return force


def custom(force, parameters, term, values):
    """Return a custom force with one term, whose parameters have these names and values."""
    kind = next(word for word in ("Bond", "Angle", "Torsion") if word in type(force).__name__)
    for name in parameters:
        getattr(force, f"addPer{kind}Parameter")(name)
    getattr(force, f"add{kind}")(*term, values)
    return force


OTHERS = [
    custom(openmm.CustomBondForce("k*r^4"), ["k"], (0, 1), [1.0]),
    with_parameter(custom(openmm.CustomBondForce("k*r^4"), [], (0, 1), [])),
    custom(openmm.CustomAngleForce("k*theta^2"), ["k"], (0, 1, 2), [1.0]),
    custom(openmm.CustomTorsionForce("k*cos(theta)"), ["k"], (0, 1, 2, 3), [1.0]),
    with_parameter(
        custom(openmm.CustomBondForce("4*epsilon*((sigma/r)^12-(sigma/r)^6)"), ["sigma"], (0, 3), [0.3]), "epsilon"
    ),
]


@pytest.mark.parametrize("force", OTHERS)
def test_other_forms_are_left_to_openmm(force):
    assert not has_known_form(force)
    assert terms_in(system_of(angles(), force), -1) is None


@pytest.mark.parametrize("make", [form for form in FORMS if form is not pairs])
def test_periodic_forms_are_left_to_openmm(make):
    force = make()
    force.setUsesPeriodicBoundaryConditions(True)
    assert not has_known_form(force)
    assert terms_in(system_of(angles(), force), -1) is None


def test_periodic_exceptions_are_left_to_openmm():
    force = openmm.NonbondedForce()
    force.setNonbondedMethod(force.PME)
    force.setExceptionsUsePeriodicBoundaryConditions(True)
    force.addException(0, 3, 0.5, 0.3, 1.0)
    (pairs_of_force,) = interacting_exceptions(force)
    assert not has_known_form(pairs_of_force.force)
