"""The Ewald sum of the compiled kernel: its functions, its derivatives, its tolerance, and sums known otherwise."""

import sys

import mpmath as mp
import numba
import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from ewald import dipole_ewald
from openmm_exactrb import kernels, pairs_compiled
from openmm_exactrb.potentials import SoftDipoles, _splitting, _truncation
from test_pairs import amoeba_energy, arrows, energy_and_forces, liquid

REFERENCE = openmm.Platform.getPlatform("Reference")


def soft_dipoles(
    sites, edges, *, tolerance=1e-12, cutoff=None, switch=None, dielectric=np.inf, coupling=1.0, threads=None
):
    """Return energy and forces (2 n, 3) of dipoles alone."""
    edges = tuple(map(float, edges))
    truncation = _truncation(edges, cutoff, switch, 1.0)
    ewald = *_splitting(len(sites) // 2, edges, truncation, tolerance), dielectric
    kernel = SoftDipoles(truncation, ewald)._in_box(np.diag(edges))
    return pairs_compiled.soft_dipoles(sites, 0.0, coupling, kernel, threads, ewald=ewald)


def sites_of(R, mu):
    return np.stack([R, R + mu], axis=1).reshape(-1, 3)


# -- functions --------------------------------------------------------------------------------------------------


@numba.njit(error_model="numpy")
def screened(r2, alpha, B):
    for i in range(len(r2)):
        B[i] = pairs_compiled.screened(r2[i], 1.0 / r2[i], alpha)


def test_the_functions_of_screened_dipoles_are_exact():
    """B1, B2, B3 by mpmath from erfc(alpha r)/r with -1/r d/dr; relative errors, down to 1e-14 of what is bare."""
    r, alpha = np.linspace(0.05, 4.0, 80), 1.4
    B = np.empty((80, 3))
    screened(r**2, alpha, B)
    with mp.workdps(40):
        for x, found in zip(r, B, strict=True):
            taylor = mp.taylor(lambda s: mp.erfc(mp.mpf(alpha) * mp.sqrt(s)) / mp.sqrt(s), mp.mpf(x) ** 2, 3)
            exact = [(-2) ** k * mp.factorial(k) * taylor[k] for k in (1, 2, 3)]
            for k in range(3):
                assert abs(found[k] / exact[k] - 1) < 2e-14


def test_nothing_is_left_of_a_screened_dipole_far_away():
    B = np.empty((2, 3))
    screened(np.array([1e4, np.inf]), 1.0, B)
    assert np.abs(B).max() < 1e-22


# -- sums known otherwise ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [2, 3])
def test_parallel_dipoles_on_a_cubic_lattice_feel_the_field_of_lorentz(side):
    """Errors of 1e-12 add up where all dipoles have the same neighbours."""
    a, mu = 1.3, np.array([0.3, -0.5, 0.8])
    R = a * np.argwhere(np.ones((side, side, side)))
    energy, forces = soft_dipoles(sites_of(R, np.tile(mu, (len(R), 1))), 3 * [side * a])
    np.testing.assert_allclose(forces[1::2], np.tile(4.0 * np.pi / 3.0 * mu / a**3, (len(R), 1)), rtol=1e-11)
    assert energy == pytest.approx(-2.0 * np.pi / 3.0 * len(R) * (mu @ mu) / a**3, rel=1e-11)


@pytest.mark.parametrize("n", [27, 125])
def test_a_liquid_has_the_energy_and_the_fields_of_a_plain_sum(n):
    R, mu, box = liquid(n)
    energy, forces = soft_dipoles(sites_of(R, mu), 3 * [box])
    exact, field = dipole_ewald(R, mu, box, 13.0 / box)
    assert energy == pytest.approx(exact, rel=2e-12)
    np.testing.assert_allclose(forces[1::2], field, rtol=0.0, atol=5e-12 * np.abs(field).max())


def test_a_liquid_has_the_energy_that_amoeba_gives_it():
    R, mu, box = liquid(64)
    assert soft_dipoles(sites_of(R, mu), 3 * [box])[0] == pytest.approx(amoeba_energy(R, mu, box), rel=1e-5)


def test_a_box_and_two_of_it_are_the_same_crystal(rng):
    R, mu = 4.0 * rng.random((6, 3)), rng.standard_normal((6, 3))
    edges = np.array([4.0, 4.5, 5.0])
    energy, forces = soft_dipoles(sites_of(R, mu), edges)
    for axis in range(3):
        double = np.concatenate([R, R + np.eye(3)[axis] * edges[axis]])
        twice, again = soft_dipoles(sites_of(double, np.tile(mu, (2, 1))), edges * (1.0 + np.eye(3)[axis]))
        assert twice == pytest.approx(2.0 * energy, rel=1e-11)
        np.testing.assert_allclose(again[: len(forces)], forces, rtol=0.0, atol=1e-11 * np.abs(forces).max())


def test_other_surroundings_add_the_energy_of_the_surface(rng):
    x, box = arrows(27, rng)
    M = (x[1::2] - x[0::2]).sum(axis=0)
    tin, vacuum, water = (soft_dipoles(x, 3 * [box], dielectric=d)[0] for d in (np.inf, 1.0, 80.0))
    assert vacuum - tin == pytest.approx(2.0 * np.pi / 3.0 * (M @ M) / box**3, rel=1e-10)
    assert water - tin == pytest.approx(2.0 * np.pi / 161.0 * (M @ M) / box**3, rel=1e-8)


# -- tolerance and derivatives ----------------------------------------------------------------------------------


def gas(n):
    """Return centres, dipoles and box of dipoles at a density of 0.05."""
    rng = np.random.default_rng(4)
    side, box = round(n ** (1.0 / 3.0)), (n / 0.05) ** (1.0 / 3.0)
    R = (np.argwhere(np.ones((side, side, side))) + 0.3 * rng.random((n, 3))) * box / side
    return R, rng.standard_normal((n, 3)), box


@pytest.mark.parametrize("switch", [0.5, 0.75, 0.9])
@pytest.mark.parametrize(
    ("dipoles", "cutoff"),
    [
        (lambda: liquid(27, seed=8), None),
        (lambda: liquid(216, seed=8), None),
        (lambda: liquid(216, seed=8), 1.5),
        (lambda: gas(64), None),
        (lambda: gas(216), 3.0),
    ],
    ids=["small liquid", "liquid", "liquid, short cutoff", "small gas", "gas, short cutoff"],
)
def test_the_error_is_below_the_tolerance_and_not_much_smaller(dipoles, cutoff, switch):
    """Root mean square errors of the dipoles' forces and fields."""
    R, mu, box = dipoles()
    x, edges = sites_of(R, mu), 3 * [box]
    _, exact = soft_dipoles(x, edges, tolerance=1e-12)

    def forces_and_fields(forces):
        return forces[0::2] + forces[1::2], forces[1::2]

    finest = [1e-9] if cutoff is None else []  # a short cutoff needs more waves for it than are allowed
    for tolerance in [1e-2, 1e-3, 1e-4, 1e-6, *finest]:
        _, forces = soft_dipoles(
            x, edges, tolerance=tolerance, cutoff=cutoff, switch=switch * (0.5 * box if cutoff is None else cutoff)
        )
        errors = [
            np.linalg.norm(found - right) / np.linalg.norm(right)
            for found, right in zip(forces_and_fields(forces), forces_and_fields(exact), strict=True)
        ]
        assert tolerance / 6.0 < max(errors) < tolerance


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5])
@pytest.mark.parametrize("dielectric", [np.inf, 3.0])
def test_forces_are_the_exact_gradient_whatever_the_tolerance(rng, tolerance, dielectric):
    x, box = arrows(27, rng)
    edges = box * np.array([1.0, 1.1, 1.3])
    options = {"tolerance": tolerance, "dielectric": dielectric, "coupling": 2.0}
    _, forces = soft_dipoles(x, edges, **options)
    for site, axis in ((4, 0), (5, 1), (20, 2), (21, 0), (33, 2)):
        d = np.zeros_like(x)
        d[site, axis] = 1e-3
        f = [soft_dipoles(x + k * d, edges, **options)[0] for k in (-2, -1, 1, 2)]
        slope = (f[0] - 8.0 * f[1] + 8.0 * f[2] - f[3]) / 12e-3
        assert -forces[site, axis] == pytest.approx(slope, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("n", [27, 500])
def test_any_number_of_threads_gives_the_same_bits(rng, n):
    x, box = arrows(n, rng)
    energy, forces = soft_dipoles(x, 3 * [box], tolerance=1e-4, threads=1)
    for threads in (2, 3, 7):
        again = soft_dipoles(x, 3 * [box], tolerance=1e-4, threads=threads)
        assert again[0] == energy
        np.testing.assert_array_equal(again[1], forces)


def test_moved_by_whole_boxes_a_liquid_is_the_same(rng):
    x, box = arrows(27, rng)
    energy, forces = soft_dipoles(x, 3 * [box], tolerance=1e-6)
    far = x + box * rng.integers(-400, 400, (27, 1, 3)).repeat(2, axis=1).reshape(-1, 3)
    again = soft_dipoles(far, 3 * [box], tolerance=1e-6)
    assert again[0] == pytest.approx(energy, rel=1e-11)
    np.testing.assert_allclose(again[1], forces, rtol=0.0, atol=1e-10 * np.abs(forces).max())


def test_a_dipole_feels_its_images():
    """Alone in a cube, the field of Lorentz; three in a slab, what they feel in a cube of 36 slabs."""
    mu, box = np.array([0.3, -0.5, 0.8]), 1.7
    _, forces = soft_dipoles(sites_of(np.full((1, 3), 0.4), mu[None]), 3 * [box])
    np.testing.assert_allclose(forces[1], 4.0 * np.pi / 3.0 * mu / box**3, rtol=1e-11)

    edges = np.array([1.0, 2.0, 3.0])
    rng = np.random.default_rng(2)
    R, mu = edges * rng.random((3, 3)), rng.standard_normal((3, 3))
    energy, forces = soft_dipoles(sites_of(R, mu), edges)
    shifts = edges * np.argwhere(np.ones((6, 3, 2)))
    exact, field = dipole_ewald((R + shifts[:, None]).reshape(-1, 3), np.tile(mu, (36, 1)), 6.0, 13.0 / 6.0)
    np.testing.assert_allclose(forces[1::2], field[:3], rtol=0.0, atol=1e-10 * np.abs(field).max())
    assert energy == pytest.approx(exact / 36.0, rel=1e-9)
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-12 * np.abs(forces).max())


# -- in a Context -----------------------------------------------------------------------------------------------


def context_of(n, **options):
    _, system, positions = rb.dipole_fluid(
        n, seed=5, perturbation=0.08, periodic=True, long_range="ewald", **({"density": 0.5} | options)
    )
    integrator = rb.ExactRigidBodyIntegrator(0.005, scheme="SRKN4_6b")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    return context


def test_the_sum_follows_the_box_of_the_context():
    context, edges = context_of(27, cutoff=1.7, ewald_tolerance=1e-12), np.array([3.6, 3.7, 3.9])
    context.setPeriodicBoxVectors(*np.diag(edges))
    context.setParameter("soft_repulsion", 0.0)
    state = context.getState(energy=True, positions=True)
    x = state.getPositions(asNumpy=True)._value.reshape(27, -1, 3)[:, -2:].reshape(-1, 3)
    energy, _ = soft_dipoles(x, edges, coupling=context.getParameter("dipole_coupling"))
    assert state.getPotentialEnergy()._value == pytest.approx(energy, rel=1e-11)


def test_a_barostat_changes_the_box_of_the_sum():
    _, system, positions = rb.dipole_fluid(64, 3, periodic=True, density=0.6, long_range="ewald", cutoff=1.9)
    system.addForce(openmm.MonteCarloBarostat(20.0, 120.0, 2))
    integrator = rb.ExactRigidBodyIntegrator(0.004, scheme="S2_2")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    integrator.setVelocitiesToTemperature(120.0, 1)
    volume = context.getState().getPeriodicBoxVolume()
    integrator.step(60)
    state = context.getState(positions=True, energy=True)
    assert abs(state.getPeriodicBoxVolume() / volume - 1.0) > 1e-3
    again = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    again.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    again.setPositions(state.getPositions())
    assert again.getState(energy=True).getPotentialEnergy()._value == state.getPotentialEnergy()._value


@pytest.mark.parametrize("wca", [False, True])
def test_a_serialised_system_has_the_same_sum(wca):
    context = context_of(27, dielectric=4.0, attraction=1.0, wca=wca)
    system = openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(context.getSystem()))
    copy = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    copy.setPositions(context.getState(positions=True).getPositions())
    for one, other in zip(energy_and_forces(copy), energy_and_forces(context), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernel": "openmm"}, "only the compiled kernel has an Ewald sum"),
        ({"kernel": "fortran"}, "unknown kernel"),
        ({"dielectric": 0.5}, "dielectric must be at least 1"),
        ({"switch": 0.0}, "let the switch begin farther out"),
        ({"switch": 0.02}, "waves, more than 1000000"),
        ({"ewald_tolerance": 0.0}, "between 1e-13 and 1e-2"),
        ({"ewald_tolerance": np.nan}, "between 1e-13 and 1e-2"),
        ({"periodic": False, "density": None}, "add periodic=True"),
        ({"long_range": "p3m"}, "unknown long_range 'p3m'"),
    ],
)
def test_wrong_options_get_one_sentence(options, message):
    with pytest.raises(ValueError, match=message):
        rb.dipole_fluid(27, **({"periodic": True, "long_range": "ewald"} | options))


def test_without_a_box_there_is_no_sum():
    with pytest.raises(ValueError, match="needs a periodic box"):
        rb.soft_dipole_force([(0, 1)], strength=1.0, length=0.5, long_range="ewald")


def test_a_kernel_that_is_refused_is_not_used(monkeypatch):
    monkeypatch.setenv(kernels.SWITCH, "0")
    with pytest.raises(ValueError, match="only the compiled kernel"):
        rb.dipole_fluid(27, periodic=True, long_range="ewald")
    rb.dipole_fluid(27, periodic=True, long_range="ewald", kernel="compiled")


def test_the_kernel_needs_a_box_too():
    with pytest.raises(ValueError, match="needs a box"):
        pairs_compiled.soft_dipoles(np.zeros((2, 3)), 4.0, 1.0, ewald=(1.0, 1.0, 1.0))


def test_without_numba_there_is_no_sum(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "openmm-exactrb\[fast\]"'):
        rb.dipole_fluid(2, periodic=True, density=0.1, long_range="ewald")
