"""The highest frequency of coupled bonds and angles, from the System alone, against Hessians by finite differences."""

import itertools

import numpy as np
import openmm
import pytest
from hypothesis import given
from hypothesis import strategies as st
from openmm import unit

import openmm_exactrb as rb
from openmm_exactrb.multiple_time_steps.stiffness import fastest
from peptides import peptide
from starts import system_of

MASSES, STRENGTHS = st.floats(1.0, 40.0), st.floats(1e4, 6e5)


def springs(masses, x, bonds, angles):
    """Return a System at whose minimum the particles are at x; the terms are lists of particles and strength."""
    system = system_of(masses)
    of_bonds, of_angles = openmm.HarmonicBondForce(), openmm.HarmonicAngleForce()
    for i, j, strength in bonds:
        of_bonds.addBond(i, j, np.linalg.norm(x[i] - x[j]), strength)
    for i, j, k, strength in angles:
        a, b = x[i] - x[j], x[k] - x[j]
        of_angles.addAngle(i, j, k, np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)), strength)
    system.addForce(of_bonds)
    system.addForce(of_angles)
    return system


def measured(system, x, step=1e-5):
    """Return the highest frequency of small oscillations about x, from forces of all bonds and angles."""
    bonded = openmm.XmlSerializer.clone(system)
    for i in reversed(range(bonded.getNumForces())):
        if not isinstance(bonded.getForce(i), (openmm.HarmonicBondForce, openmm.HarmonicAngleForce)):
            bonded.removeForce(i)
    platform = openmm.Platform.getPlatform("Reference")
    context, rows = openmm.Context(bonded, openmm.VerletIntegrator(0.001), platform), []
    for place in np.ndindex(x.shape):
        ends = []
        for sign in (1.0, -1.0):
            moved = np.array(x)
            moved[place] += sign * step
            context.setPositions(moved)
            ends.append(context.getState(forces=True).getForces(asNumpy=True)._value.ravel())
        rows.append((ends[1] - ends[0]) / (2.0 * step))
    mass = np.repeat([system.getParticleMass(i)._value for i in range(len(x))], 3)
    hessian = np.array(rows) / np.sqrt(np.outer(mass, mass))
    return np.sqrt(np.linalg.eigvalsh(0.5 * (hessian + hessian.T))[-1])


@given(st.integers(1, 4), st.data())
def test_modes_of_atoms_about_one_are_exact(n, data):
    """A bond, and molecules of two to four bonds of one atom, in which nothing rotates about a bond."""
    draw = data.draw
    masses = draw(st.lists(MASSES, min_size=n + 1, max_size=n + 1))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])[:n] + rng.uniform(-0.3, 0.3, (n, 3))
    x = np.vstack([np.zeros(3), corners * rng.uniform(0.06, 0.1, (n, 1))])
    bonds = [(0, i, draw(STRENGTHS)) for i in range(1, n + 1)]
    pairs = itertools.combinations(range(1, n + 1), 2)
    angles = [(i, 0, k, draw(st.floats(100.0, 1500.0))) for i, k in pairs]
    system = springs(masses, x, bonds, angles)
    assert fastest(system) == pytest.approx(measured(system, x), rel=1e-5)


@given(MASSES, MASSES, STRENGTHS)
def test_bonds_without_an_angle_are_as_fast_as_if_they_were_parallel(end, middle, strength):
    """Exactly for a straight molecule, and never too slow for a bent one."""
    for bend in (0.0, 0.5, 1.5):
        x = np.array([[-0.12, 0.0, 0.0], [0.0, 0.0, 0.0], [0.12 * np.cos(bend), 0.12 * np.sin(bend), 0.0]])
        system = springs([end, middle, end], x, [(0, 1, strength), (1, 2, strength)], [])
        exact = measured(system, x)
        assert fastest(system) == pytest.approx(exact, rel=1e-5) if bend == 0.0 else fastest(system) > 0.999 * exact


def test_an_angle_follows_from_distances():
    """Of a bond between the ends, or of a constraint."""
    x = np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [-0.03, 0.1, 0.0]])
    bonds = [(0, 1, 3e5), (1, 2, 2e5)]
    exact = fastest(springs([16.0, 12.0, 14.0], x, bonds, [(0, 1, 2, 1e-6)]))
    by_bond = springs([16.0, 12.0, 14.0], x, [*bonds, (0, 2, 1e-6)], [])
    held = springs([16.0, 12.0, 14.0], x, bonds, [])
    assert fastest(held) > 1.05 * exact
    held.addConstraint(0, 2, np.linalg.norm(x[0] - x[2]))
    for system in (by_bond, held):
        assert fastest(system) == pytest.approx(exact, rel=1e-6)


def test_two_terms_of_the_same_atoms_are_one_spring():
    x = np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert fastest(springs([12.0, 1.0], x, [(0, 1, 1e5), (1, 0, 2e5)], [])) == pytest.approx(
        fastest(springs([12.0, 1.0], x, [(0, 1, 3e5)], [])), rel=1e-12
    )


@pytest.mark.parametrize("theta", [np.pi, np.pi - 1e-7, 0.999 * np.pi])
def test_straight_angles_are_as_fast_as_their_bonds_or_as_they_are(theta):
    x = np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.12 * np.cos(theta), 0.12 * np.sin(theta), 0.0]])
    masses, bonds = [16.0, 12.0, 14.0], [(0, 1, 5e5), (1, 2, 4e5)]
    stretched = measured(springs(masses, x, bonds, []), x)
    assert fastest(springs(masses, x, bonds, [(0, 1, 2, 500.0)])) == pytest.approx(stretched, rel=1e-3)
    bent = np.sqrt(9e3 * (1.0 / 16.0 / 0.01 + 1.0 / 14.0 / 0.0144 + (1.0 / 0.1 + 1.0 / 0.12) ** 2 / 12.0))
    slow = [(i, j, 1e-2 * k) for i, j, k in bonds]
    assert fastest(springs(masses, x, slow, [(0, 1, 2, 9e3)])) == pytest.approx(bent, rel=1e-3)


@pytest.mark.parametrize(("constraints", "heavy"), [("HBonds", None), ("HBonds", 3.0), ("None", None), ("None", 3.0)])
def test_a_peptide_oscillates_as_fast_as_that_within_three_percent(constraints, heavy):
    """In the conformation of its file, from which the estimate is independent. Isolated terms miss by 20 %."""
    topology, system, x = peptide(constraints)
    if heavy is not None:
        rb.heavy_hydrogens(system, topology, heavy)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(x)
    openmm.LocalEnergyMinimizer.minimize(context, 0.1)
    x = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)
    assert fastest(system) == pytest.approx(measured(system, x), rel=0.03)


def test_many_molecules_are_as_fast_as_the_fastest():
    """In any order, and to the last digits that decide on a number of steps."""
    x = np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [-0.03, 0.1, 0.0]])
    terms = [(0, 1, 3e5), (1, 2, 2e5)], [(0, 1, 2, 600.0)]
    one = fastest(springs([16.0, 12.0, 14.0], x, *terms))
    n, fast = 300, 17
    bonds = [(3 * m + i, 3 * m + j, k * (1.1 if m == fast else 1.0)) for m in range(n) for i, j, k in terms[0]]
    angles = [(*(3 * m + np.array(of)).tolist(), k) for m in range(n) for *of, k in terms[1]]
    every = np.tile(x, (n, 1))
    faster = springs([16.0, 12.0, 14.0], x, [(i, j, 1.1 * k) for i, j, k in terms[0]], terms[1])
    assert fastest(springs(n * [16.0, 12.0, 14.0], every, bonds, angles)) == pytest.approx(fastest(faster), rel=1e-6)
    same = springs(n * [16.0, 12.0, 14.0], every, [(i, j, k) for i, j, k in bonds if i // 3 != fast], angles)
    assert fastest(same) == pytest.approx(one, rel=1e-6)


def test_nothing_that_oscillates_has_no_frequency():
    x = np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert fastest(springs([0.0, 0.0], x, [(0, 1, 1e5)], [])) == 0.0
    assert fastest(springs([1.0, 1.0], x, [(0, 1, 0.0)], [])) == 0.0
    assert fastest(system_of([1.0])) == 0.0
