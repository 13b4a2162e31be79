"""The bonded terms of the kernels: forces of OpenMM, and derivatives of the energies to forty digits."""

import mpmath as mp
import numpy as np
import openmm
import pytest
from kernel_functions import U

import bonded_terms
from bonded_terms import FORMS, RNG, maps, system_of, terms_in
from openmm_exactrb.multiple_time_steps.terms import kinds_of
from openmm_exactrb.openmm_access.units import COULOMB
from starts import context_of

#: The differences of positions (nm) by which energies are differentiated.
H = mp.mpf(10) ** -15


def forces_of(kernels, terms, x):
    """Return the forces (n, 3) of the kernels of all kinds at positions (n, 3)."""
    sums, state = np.zeros(x.shape), np.ascontiguousarray(np.stack([x, np.zeros(x.shape)], axis=-1))
    patches, harmonics = np.ascontiguousarray(terms.patches), terms.of_torsions.shape[1]
    for name, kind in kinds_of(terms, np.float64).items():
        members = np.ascontiguousarray(np.concatenate([kind.particles.T, kind.others]), np.int32)
        numbers = np.ascontiguousarray(kind.numbers)
        counts = len(kind.particles), len(x), harmonics
        kernels("pi_add_forces", name, *counts, state, members, numbers, patches, sums)
    return sums


# -- against OpenMM ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", FORMS)
def test_forces_are_those_of_openmm(kernels, make):
    system = system_of(make())
    for _ in range(10):
        x = RNG.normal(size=(bonded_terms.N, 3))
        context = context_of(system, openmm.VerletIntegrator(0.001), x)
        theirs = context.getState(forces=True).getForces(asNumpy=True)._value
        ours = forces_of(kernels, terms_in(system), x)
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-13 * abs(theirs).max())


# -- against derivatives ----------------------------------------------------------------------------------------------


def difference(x, i, j):
    return [a - b for a, b in zip(x[i], x[j], strict=True)]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def distance(x, i, j):
    return mp.norm(difference(x, i, j))


def angle(x, i, j, k):
    u, v = difference(x, i, j), difference(x, k, j)
    return mp.atan2(mp.norm(cross(u, v)), mp.fdot(u, v))


def torsion(x, i, j, k, l):
    u, v, w = difference(x, i, j), difference(x, k, j), difference(x, k, l)
    a, b = cross(u, v), cross(v, w)
    return mp.atan2(mp.norm(v) * mp.fdot(u, b), mp.fdot(a, b))


def lennard_jones(r, sigma, epsilon):
    return 4 * epsilon * ((sigma / r) ** 12 - (sigma / r) ** 6)


def polynomial(coefficients, x):
    """Return the sum of c_k x^k."""
    return mp.fsum(c * x**k for k, c in enumerate(coefficients))


def away(x, atoms, strength, phi0, pi):
    """Return the energy of a harmonic torsion that is periodic with 2 pi."""
    apart = abs(torsion(x, *atoms) - phi0)
    return strength * min(apart, 2 * pi - apart) ** 2


#: The energy of a term, from the positions x, the atoms a of the term, and its parameters in OpenMM's order.
ENERGIES = {
    "bonds": lambda x, a, length, k: k * (distance(x, *a) - length) ** 2 / 2,
    "angles": lambda x, a, theta0, k: k * (angle(x, *a) - theta0) ** 2 / 2,
    "periodic_torsions": lambda x, a, n, phase, k: k * (1 + mp.cos(n * torsion(x, *a) - phase)),
    "polynomial_torsions": lambda x, a, *c: polynomial(c, mp.cos(torsion(x, *a) - mp.pi)),
    "pairs": lambda x, a, charges, sigma, e: (
        COULOMB * charges / distance(x, *a) + lennard_jones(distance(x, *a), sigma, e)
    ),
    "lennard_jones_pairs": lambda x, a, epsilon, sigma: lennard_jones(distance(x, *a), sigma, epsilon),
    "harmonic_torsions": lambda x, a, k, phi0: away(x, a, k, phi0, mp.pi),
    "harmonic_torsions_of_files": lambda x, a, k, phi0: away(x, a, k, phi0, mp.mpf(3.141593)),
    "torsions_on_a_line": lambda x, a, phi0, k: k * (torsion(x, *a) - phi0) ** 2,
}


def terms_by_openmm(name, force):
    """Yield the atoms and the energy, a function of positions, of each term."""
    term = next(term for term in ("Bond", "Angle", "Torsion") if hasattr(force, f"getNum{term}s"))
    size = {"Bond": 2, "Angle": 3, "Torsion": 4}[term]
    for t in range(getattr(force, f"getNum{term}s")()):
        values = getattr(force, f"get{term}Parameters")(t)
        atoms, numbers = values[:size], values[size:]
        if isinstance(numbers[0], tuple):
            (numbers,) = numbers
        numbers = [mp.mpf(getattr(value, "_value", value)) for value in numbers]
        yield atoms, lambda x, atoms=atoms, numbers=numbers: ENERGIES[name](x, atoms, *numbers)


def terms_by_patches(terms):
    """Yield the atoms and the energies of maps, from the polynomials of their patches."""
    for row in terms.maps.tolist():
        atoms, first, size = row[:8], row[8], row[9]

        def energy(x, atoms=atoms, first=first, size=size):
            angles = [torsion(x, *some) % (2 * mp.pi) for some in (atoms[:4], atoms[4:])]
            places = [int(a * size / (2 * mp.pi)) for a in angles]
            u, v = (a - place * 2 * mp.pi / size for a, place in zip(angles, places, strict=True))
            patch = terms.patches[first + places[0] * size + places[1]][::-1, ::-1].tolist()
            return polynomial([polynomial(row, v) for row in patch], u)

        yield atoms, energy


def derivatives(terms, x):
    """Return the energy of terms, and minus its derivatives (n, 3), by central differences."""
    places, forces, total = [list(map(mp.mpf, row)) for row in x.tolist()], np.zeros(x.shape, object), mp.mpf(0)
    for atoms, energy in terms:
        total += energy(places)
        for i in set(atoms):
            for e in range(3):
                here, ends = places[i][e], []
                for shift in (H, -H):
                    places[i][e] = here + shift
                    ends.append(energy(places))
                places[i][e] = here
                forces[i, e] += (ends[1] - ends[0]) / (2 * H)
    return total, forces.astype(float)


@pytest.mark.parametrize("make", FORMS)
def test_forces_are_derivatives_of_openmms_energy(kernels, make, monkeypatch):
    monkeypatch.setattr(bonded_terms, "N", 9)
    force = make()
    system = system_of(force, n=9)
    terms, x = terms_in(system), 0.2 * RNG.normal(size=(9, 3))
    with mp.workdps(50):
        each = terms_by_patches(terms) if make is maps else terms_by_openmm(make.__name__, force)
        energy, expected = derivatives(each, x)
    of_openmm = context_of(system, openmm.VerletIntegrator(0.001), x).getState(energy=True).getPotentialEnergy()._value
    assert of_openmm == pytest.approx(float(energy), rel=1e-12)
    roundings = 200 if make is maps else 30  # the terms of a patch cancel in part
    allowed = roundings * U * np.abs(expected).max()
    np.testing.assert_allclose(forces_of(kernels, terms, x), expected, rtol=0.0, atol=allowed)


@pytest.mark.parametrize("away", [1e-7, 1e-4, 0.1])
@pytest.mark.parametrize("folded", [False, True])
def test_almost_straight_angles_and_flat_torsions_keep_their_digits(kernels, away, folded):
    """The plane of an angle is known to a rounding over the sine."""
    bent, turn = openmm.HarmonicAngleForce(), openmm.PeriodicTorsionForce()
    bent.addAngle(0, 1, 2, 1.9, 500.0)
    turn.addTorsion(3, 4, 5, 6, 2, 0.3, 10.0)
    a = away if folded else np.pi - away
    corner = [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.12 * np.cos(a), 0.12 * np.sin(a), 0.01 * away]]
    plane = [[0.1, 0.1, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.15], [0.1 * np.cos(a), 0.1 * np.sin(a), 0.25]]
    x = np.array(corner + plane)
    with mp.workdps(50):
        each = [*terms_by_openmm("angles", bent), *terms_by_openmm("periodic_torsions", turn)]
        _, expected = derivatives(each, x)
    found = forces_of(kernels, terms_in(system_of(bent, turn, n=7)), x)
    for some, condition in ((slice(3), 1.0 / np.sin(a)), (slice(3, 7), 1.0)):
        size = np.abs(expected[some]).max()
        np.testing.assert_allclose(found[some], expected[some], rtol=0.0, atol=30 * U * condition * size)


def test_a_bond_of_no_length_has_no_force(kernels):
    bond = openmm.HarmonicBondForce()
    bond.addBond(0, 1, 0.1, 1e5)
    assert not forces_of(kernels, terms_in(system_of(bond)), np.zeros((2, 3))).any()


@pytest.mark.parametrize("make", FORMS)
def test_forces_do_not_depend_on_the_terms_of_other_molecules(kernels, make):
    """Several terms are evaluated at once; terms in front of those of a molecule change which ones."""
    terms, (x, elsewhere) = terms_in(system_of(make())), RNG.normal(size=(2, bonded_terms.N, 3))
    alone = forces_of(kernels, terms, x)
    for in_front in range(1, 5):
        found = forces_of(kernels, behind_others(terms, in_front, len(x)), np.concatenate([elsewhere, x]))
        np.testing.assert_array_equal(found[len(x) :], alone)


def behind_others(terms, n, atoms):
    """Return the first n terms of each kind, and then all terms on particles whose indices are larger by `atoms`."""
    made = {}
    for name, values in terms._asdict().items():
        if name.startswith("of_"):
            made[name] = np.concatenate([values[..., :n], values], axis=-1)
        elif name != "patches":
            shift = np.where(np.arange(values.shape[1]) < 8, atoms, 0)  # further columns of maps are no particles
            made[name] = np.concatenate([values[:n], values + shift])
    return terms._replace(**made)
