"""Compiled bonds, angles, torsions and pairs have the forces of OpenMM's Reference platform."""

import numpy as np
import openmm
import pytest

from openmm_exactrb import kernels
from openmm_exactrb.multiple_time_steps.bonded import pairs_by_formula
from openmm_exactrb.multiple_time_steps.compiled_forces import terms_of
from starts import context_of

RNG = np.random.default_rng(5)
N = 140  # more terms than two blocks of the kernel have


def bonds():
    force = openmm.HarmonicBondForce()
    for i in range(N - 1):
        force.addBond(i, i + 1, *RNG.uniform((0.1, 1e4), (0.2, 4e5)))
    return force


def angles():
    force = openmm.HarmonicAngleForce()
    for i in range(N - 2):
        force.addAngle(i, i + 1, i + 2, *RNG.uniform((0.5, 100.0), (np.pi, 800.0)))
    return force


def periodic_torsions():
    force = openmm.PeriodicTorsionForce()
    for i in range(N - 3):
        for n in RNG.permutation(6)[:3]:
            force.addTorsion(i, i + 1, i + 2, i + 3, int(n) + 1, RNG.uniform(-4.0, 4.0), RNG.uniform(-20.0, 20.0))
    force.addTorsion(3, 2, 1, 0, 2, np.pi, 4.0)
    return force


def polynomial_torsions():
    force = openmm.RBTorsionForce()
    for i in range(N - 3):
        force.addTorsion(i, i + 1, i + 2, i + 3, *RNG.uniform(-20.0, 20.0, 6))
    return force


def pairs():
    force = openmm.NonbondedForce()
    some = [(i, i + 3, *RNG.uniform((-0.5, 0.2, 0.0), (0.5, 0.4, 2.0))) for i in range(N - 3)]
    return pairs_by_formula(force, some)


def lennard_jones_pairs():
    force = openmm.CustomBondForce("4*epsilon*((sigma/r)^12-(sigma/r)^6)")
    force.addPerBondParameter("epsilon")
    force.addPerBondParameter("sigma")
    for i in range(N - 3):
        force.addBond(i, i + 3, RNG.uniform((0.0, 0.2), (2.0, 0.4)))
    return force


def harmonic_torsions(pi=f"{np.pi}"):
    force = openmm.CustomTorsionForce(f"k*min(dtheta, 2*pi-dtheta)^2; dtheta = abs(theta-theta0); pi = {pi}")
    force.addPerTorsionParameter("k")
    force.addPerTorsionParameter("theta0")
    for i in range(N - 3):
        force.addTorsion(i, i + 1, i + 2, i + 3, RNG.uniform((1.0, -3.0), (200.0, 3.0)))
    return force


def harmonic_torsions_of_files():
    """As OpenMM's CharmmPsfFile makes them."""
    return harmonic_torsions("3.141593;")


def maps():
    force = openmm.CMAPTorsionForce()
    for size in (24, 5):
        force.addMap(size, RNG.uniform(-10.0, 10.0, size * size))
    for i in range(N - 4):
        force.addTorsion(i % 2, i, i + 1, i + 2, i + 3, i + 1, i + 2, i + 3, i + 4)
    return force


def both(system, x, groups=-1):
    """Return the forces of the kernel and those of OpenMM."""
    out = np.empty_like(x)
    kernels.load("bonded").forces(x, terms_of(system, groups), out)
    context = context_of(system, openmm.VerletIntegrator(0.001), x)
    return out, context.getState(forces=True, groups=groups).getForces(asNumpy=True)._value


def system_of(*forces):
    system = openmm.System()
    for _ in range(N):
        system.addParticle(1.0)
    for force in forces:
        system.addForce(force)
    return system


FORMS = (
    *(bonds, angles, periodic_torsions, polynomial_torsions),
    *(pairs, lennard_jones_pairs, harmonic_torsions, harmonic_torsions_of_files, maps),
)


@pytest.mark.parametrize("make", FORMS)
def test_each_form_is_openmms(make):
    system = system_of(make())
    for _ in range(20):
        ours, theirs = both(system, RNG.normal(size=(N, 3)))
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-13 * abs(theirs).max())


def test_forces_of_some_groups_add_up():
    forces = [bonds(), angles(), periodic_torsions(), polynomial_torsions(), pairs()]
    for group, force in enumerate(forces):
        force.setForceGroup(group)
    system, x = system_of(*forces), RNG.normal(size=(N, 3))
    for groups in (0b00001, 0b01010, 0b11111):
        ours, theirs = both(system, x, groups)
        np.testing.assert_allclose(ours, theirs, atol=1e-13 * abs(theirs).max())


@pytest.mark.parametrize("angle", [1e-7, 1e-4, np.pi - 1e-4, np.pi - 1e-7])
def test_almost_straight_angles_and_flat_torsions_keep_their_digits(angle):
    force = openmm.HarmonicAngleForce()
    force.addAngle(0, 1, 2, 1.9, 500.0)
    torsion = openmm.PeriodicTorsionForce()
    torsion.addTorsion(3, 4, 5, 6, 2, 0.3, 10.0)
    x = RNG.normal(size=(N, 3))
    x[:3] = [0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.12 * np.cos(angle), 0.12 * np.sin(angle), 0.0]
    x[3:7] = [0.1, 0.1, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.15], [0.1 * np.cos(angle), 0.1 * np.sin(angle), 0.25]
    out = np.empty_like(x)
    kernels.load("bonded").forces(x, terms_of(system_of(force, torsion), -1), out)
    a = abs(out[0])
    assert a[1] == pytest.approx(500.0 * abs(angle - 1.9) / 0.1, rel=1e-8)  # along the arc, strength times the rest
    turn = np.array([0.1, 0.1, 0.0])
    phi = angle - np.arctan2(turn[1], turn[0])
    arm = np.hypot(*turn[:2])
    assert np.linalg.norm(out[3]) == pytest.approx(abs(20.0 * np.sin(2.0 * phi - 0.3)) / arm, rel=1e-8)


def test_two_forces_with_maps_have_their_own():
    system, x = system_of(maps(), maps()), RNG.normal(size=(N, 3))
    ours, theirs = both(system, x)
    np.testing.assert_allclose(ours, theirs, atol=1e-13 * abs(theirs).max())


@pytest.mark.parametrize("make", FORMS)
def test_positions_that_are_not_finite_have_such_forces(make):
    x = RNG.normal(size=(N, 3))
    x[4] = np.nan
    out = np.empty_like(x)
    kernels.load("bonded").forces(x, terms_of(system_of(make()), -1), out)
    assert np.isnan(out[4]).all()


@pytest.mark.parametrize("other", ["periodic", "formula", "torsion", "parameter"])
def test_other_forms_are_left_to_openmm(other):
    if other == "periodic":
        force = bonds()
        force.setUsesPeriodicBoundaryConditions(True)
    elif other == "formula":
        force = openmm.CustomBondForce("k*r^4")
        force.addGlobalParameter("k", 1.0)
        force.addBond(0, 1)
    elif other == "torsion":
        force = openmm.CustomTorsionForce("k*cos(theta)")
        force.addPerTorsionParameter("k")
        force.addTorsion(0, 1, 2, 3, [1.0])
    else:
        force = openmm.CustomBondForce("4*epsilon*((sigma/r)^12-(sigma/r)^6)")
        force.addGlobalParameter("epsilon", 1.0)
        force.addPerBondParameter("sigma")
        force.addBond(0, 3, [0.3])
    assert terms_of(system_of(angles(), force), -1) is None
