"""The cutoff of the spheres belongs to the model: no tolerance, kernel or boundary of the dipoles changes it."""

import itertools

import numpy as np
import openmm
import pytest
from scipy.integrate import quad
from scipy.special import beta, betainc

import openmm_exactrb as rb
from force_laws import evaluated, resting, slope
from places import REFERENCE

#: A Stockmayer fluid, and one whose dipoles are hardly there.
STOCKMAYER = {"attraction": 1.0, "dipole": (0.0, 0.0, 1.0), "inertia": (0.3, 0.3, 0.3), "perturbation": 0.08, "seed": 3}
LENNARD_JONES = STOCKMAYER | {"dipole": (0.0, 0.0, 1e-7)}
FIELD = rb.ReactionField(dielectric=1.0)


def edge_of(n):
    return (n / 0.8) ** (1.0 / 3.0)


def energy_of(n, boundary, kernel="compiled", **options):
    """Return the energy and the places (n, 2, 3) of centres and tips."""
    _, system, positions = rb.dipole_fluid(n, boundary=boundary, kernel=kernel, **STOCKMAYER | options)
    energy, _ = evaluated(resting(system, positions))
    return energy, positions._value.reshape(n, -1, 3)[:, -2:]


# -- an own sum -------------------------------------------------------------------------------------------------------


def switch(r, cutoff, begin):
    """Return S and dS/dr: in r², S is the distribution function of a beta variable."""
    s = np.clip((cutoff**2 - r**2) / (cutoff**2 - begin**2), 0.0, 1.0)
    return betainc(7.0, 7.0, s), -2.0 * r / (cutoff**2 - begin**2) * (s * (1.0 - s)) ** 6 / beta(7.0, 7.0)


def lennard_jones(r, sigma=1.0, epsilon=1.0, attraction=1.0):
    """Return energy and derivative of two whole spheres at distances r."""
    repulsion, attracts = 4.0 * epsilon * (sigma / r) ** 12, 4.0 * epsilon * attraction * (sigma / r) ** 6
    return repulsion - attracts, (-12.0 * repulsion + 6.0 * attracts) / r


def spheres(r, cutoff, begin, *, shifted, **law):
    """Return energy and derivative of two spheres at distances r."""
    u, du = lennard_jones(r, **law)
    u = u - shifted * lennard_jones(cutoff, **law)[0]
    S, dS = switch(r, cutoff, begin)
    return S * u, S * du + dS * u


def correction(n, cutoff, begin, *, shifted, sigma=1.0, **law):
    """Return energy times volume of what the cutoff takes from all pairs of spheres that never overlap."""

    def left_out(r):
        return (
            lennard_jones(r, sigma, **law)[0] - spheres(r, cutoff, begin, shifted=shifted, sigma=sigma, **law)[0]
        ) * r**2

    ends = [sigma, *(r for r in (begin, cutoff) if r > sigma), np.inf]
    parts = [quad(left_out, *part, epsabs=1e-13, epsrel=1e-12)[0] for part in itertools.pairwise(ends)]
    return 2.0 * np.pi * n * (n - 1) * sum(parts)


def distances(centres, edge):
    """Return the vectors and distances of all pairs, each once."""
    d = (centres[:, None] - centres)[np.triu_indices(len(centres), 1)]
    d -= edge * np.rint(d / edge)
    return d, np.linalg.norm(d, axis=1)


def dipoles(places, edge):
    """Return the energy of truncated dipoles without a reaction field, switched from 3/8 to 1/2 of the box."""
    d, r = distances(places[:, 0], edge)
    mu = 2.0 * (places[:, 1] - places[:, 0])
    u, v = (mu[index] for index in np.triu_indices(len(mu), 1))
    energy = (u * v).sum(1) / r**3 - 3.0 * (u * d).sum(1) * (v * d).sum(1) / r**5
    return (switch(r, 0.5 * edge, 0.375 * edge)[0] * energy).sum()


#: Options, whether the energy is shifted, and whether it is corrected for what lies beyond the cutoff.
SETTINGS = {
    "default": ({}, False, True),
    "shifted": ({"shifted": True}, True, False),
    "shifted and corrected": ({"shifted": True, "long_range_correction": True}, True, True),
    "not corrected": ({"long_range_correction": False}, False, False),
    "own cutoff": ({"sphere_cutoff": 2.5, "sphere_switch": 1.5}, False, True),
}


@pytest.mark.parametrize(
    ("kernel", "name"),
    [*(("compiled", name) for name in SETTINGS), ("bonds", "shifted and corrected"), ("bonds", "own cutoff")],
)
def test_the_energy_is_that_of_an_own_sum(kernel, name):
    options, shifted, corrected = SETTINGS[name]
    for n in (125, 216) if name == "default" else (125,):  # half the box is less than the default cutoff, and more
        edge = edge_of(n)
        cutoff = options.get("sphere_cutoff", min(3.0, 0.5 * edge))
        begin = options.get("sphere_switch", 0.75 * cutoff)
        energy, places = energy_of(n, FIELD, kernel, **options)
        _, r = distances(places[:, 0], edge)
        expected = spheres(r, cutoff, begin, shifted=shifted)[0].sum() + dipoles(places, edge)
        if corrected:
            expected += correction(n, cutoff, begin, shifted=shifted) / edge**3
        assert energy == pytest.approx(expected, rel=1e-11, abs=1e-9)


@pytest.mark.parametrize("options", [{}, {"shifted": True}], ids=["corrected", "shifted"])
def test_the_pressure_is_that_of_an_own_virial(options):
    """Minus the derivative of the energy by the volume, as a barostat sees it: centres move, bodies stay rigid."""
    n, cutoff, shifted = 216, 2.6, bool(options)
    boundary = rb.ReactionField(cutoff=2.0)
    _, system, positions = rb.dipole_fluid(n, boundary=boundary, sphere_cutoff=cutoff, **LENNARD_JONES | options)
    context, edge = resting(system, positions), edge_of(n)
    x = positions._value.reshape(n, -1, 3)

    def energy_at(volume):
        scale = np.cbrt(1.0 + volume / edge**3)
        context.setPeriodicBoxVectors(*(scale * edge * np.eye(3)))
        context.setPositions((x + (scale - 1.0) * x[:, -2:-1]).reshape(-1, 3))
        return evaluated(context)[0]

    _, r = distances(x[:, -2], edge)
    virial = -(r * spheres(r, cutoff, 0.75 * cutoff, shifted=shifted)[1]).sum() / (3.0 * edge**3)
    more = 0.0 if shifted else correction(n, cutoff, 0.75 * cutoff, shifted=False) / edge**6
    assert -slope(energy_at, 0.02 * edge**3 / 100.0) == pytest.approx(virial + more, rel=1e-6)
    assert shifted or abs(more) > 0.01 * abs(virial)


# -- nothing else changes it ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "tolerances"),
    [
        (125, (1e-3, 1e-4, 1e-6, 1e-9)),
        pytest.param(1000, (1e-3, 1e-4, 1e-6, 1e-9), marks=pytest.mark.validate),
        pytest.param(8000, (1e-3, 1e-4), marks=pytest.mark.validate),
    ],
)
def test_the_tolerance_of_an_ewald_sum_changes_its_own_error_alone(n, tolerances):
    """The error of an energy is the tolerance times what fields and dipoles are worth, added up at random or not."""
    energies = [energy_of(n, rb.Ewald(tolerance=tolerance))[0] for tolerance in tolerances]
    mean_field = 4.0 * np.pi / 3.0 * 0.8  # of dipoles of 1 at this density
    for tolerance, energy in zip(tolerances, energies[:-1], strict=False):
        assert abs(energy - energies[-1]) < (tolerance + tolerances[-1]) * n * mean_field


@pytest.mark.parametrize("n", [125, pytest.param(512, marks=pytest.mark.validate)])
def test_boundaries_and_kernels_have_the_same_spheres(n):
    """With all kernels, and all cutoffs of the dipoles, which hardly have moments here."""
    wanted = energy_of(n, rb.ReactionField(), **LENNARD_JONES)[0]
    kinds = [
        ("compiled", rb.ReactionField(cutoff=1.5)),
        ("compiled", rb.Ewald(tolerance=1e-3)),
        ("compiled", rb.Ewald(tolerance=1e-9)),
        ("openmm", rb.ReactionField(cutoff=1.5)),
        ("openmm", rb.Ewald(tolerance=1e-3)),
    ]
    kinds += [("bonds", rb.ReactionField(cutoff=1.5))] * (n < 300)
    for kernel, boundary in kinds:
        assert energy_of(n, boundary, kernel, **LENNARD_JONES)[0] == pytest.approx(wanted, rel=1e-9), (kernel, boundary)


def test_rods_have_the_energy_of_point_dipoles_to_the_tolerance():
    n, tolerance = 125, 1e-3
    exact, places = energy_of(n, rb.Ewald(tolerance=1e-9))
    energy, _ = energy_of(n, rb.Ewald(tolerance=tolerance), "openmm")
    _, r = distances(places[:, 0], edge_of(n))
    assert abs(energy - exact) < tolerance * n * 4.0 * np.pi / 3.0 * 0.8
    assert r.max() > 0.5 * edge_of(n), "some pairs have their nearest image beyond the cutoff"


def test_what_lies_beyond_hardly_depends_on_the_cutoff():
    """Of 512 spheres, with the correction a fifth of what it does without, at most."""
    settings = [{"sphere_cutoff": cutoff, **LENNARD_JONES} for cutoff in (2.0, 3.0, 4.0)]
    full = [energy_of(512, FIELD, **own)[0] for own in settings]
    bare = [energy_of(512, FIELD, long_range_correction=False, **own)[0] for own in settings]
    assert np.ptp(full) < 0.2 * np.ptp(bare)


@pytest.mark.parametrize(
    ("n", "density", "law", "cutoff", "begin", "shifted"),
    [
        (2, 0.001, {}, 3.0, 2.25, False),
        (2, 0.1, {}, 1.2, 0.9, False),
        (3, 0.03, {"attraction": 0.0}, 1.01, 0.1, False),
        (5, 0.05, {"epsilon": 2.5}, 1.3, 1.0, True),
        (8, 0.8, {}, 1.05, 0.2, True),
        (27, 0.5, {"attraction": 0.4}, 1.5, 1.3, False),
        (27, 40.0, {"sigma": 0.25, "epsilon": 0.7}, 0.4, 0.2, True),
        (64, 0.02, {"sigma": 2.5, "attraction": 1.3}, 5.0, 2.0, False),
        (125, 0.7, {}, 2.5, 2.49, False),
    ],
)
def test_the_correction_is_the_quadrature_over_pairs_beyond_the_diameter(n, density, law, cutoff, begin, shifted):
    options = {"density": density, "sphere_cutoff": cutoff, "sphere_switch": begin, "shifted": shifted} | law
    with_it, without = (energy_of(n, FIELD, long_range_correction=on, **options)[0] for on in (True, False))
    expected = correction(n, cutoff, begin, shifted=shifted, **law) * density / n
    assert with_it - without == pytest.approx(expected, rel=1e-10, abs=1e-12 * abs(without))


@pytest.mark.parametrize("boundary", [FIELD, rb.Ewald()], ids=["field", "Ewald"])
@pytest.mark.parametrize(
    ("n", "options"),
    [
        *((n, {}) for n in (1, 2, 3, 4, 6)),
        *((64, {"sphere_cutoff": cutoff}) for cutoff in (0.5, 0.99, 1.0)),
        (27, {"sigma": 0.3, "density": 2.0, "sphere_cutoff": 0.25}),
        (2, {"attraction": 0.0, "density": 0.26}),
    ],
)
def test_within_the_diameter_nothing_is_corrected(n, options, boundary):
    """Asked for or not: there g(r) is not 1."""
    names = [
        [
            force.getName()
            for force in rb.dipole_fluid(n, boundary=boundary, **STOCKMAYER | options | asked)[1].getForces()
        ]
        for asked in ({}, {"long_range_correction": False})
    ]
    assert names == 2 * [["SoftDipoleForce"]]
    with pytest.raises(ValueError, match=r"correction needs a sphere_cutoff beyond the diameter .* or omit"):
        rb.dipole_fluid(n, boundary=boundary, long_range_correction=True, **STOCKMAYER | options)


def test_other_platforms_and_integrators_have_the_same_energy():
    _, system, positions = rb.dipole_fluid(125, boundary=rb.Ewald(), **STOCKMAYER)
    found = []
    for platform in (REFERENCE, openmm.Platform.getPlatform("CPU")):
        for make in (lambda: openmm.VerletIntegrator(0.001), lambda: rb.ExactRigidBodyIntegrator(0.001)):
            context = openmm.Context(system, make(), platform)
            context.setPositions(positions)
            found.append(evaluated(context)[0])
    np.testing.assert_allclose(found, found[0], rtol=1e-5)


def test_the_correction_follows_the_parameters_of_the_context():
    _, system, positions = rb.dipole_fluid(125, boundary=FIELD, **LENNARD_JONES)
    context = resting(system, positions)
    before = evaluated(context)[0]
    for name, factor in (("soft_repulsion", 2.0), ("soft_attraction", 2.0)):
        context.setParameter(name, factor * context.getParameter(name))
    assert evaluated(context)[0] == pytest.approx(2.0 * before, rel=1e-9)


# -- what is refused --------------------------------------------------------------------------------------------------
