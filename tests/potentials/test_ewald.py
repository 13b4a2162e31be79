"""The Ewald sum of the compiled kernel: its functions, its derivatives, its tolerance, and sums known otherwise."""

import mpmath as mp
import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
import starts
from force_laws import evaluated, resting
from openmm_exactrb.potentials import SoftDipoles
from plain_ewald import dipole_ewald
from soft_dipoles import arrows, assert_same, dipoles_alone, fluid, liquid, sites_of
from starts import positions_of

# -- functions --------------------------------------------------------------------------------------------------


def screened(r, u, v, alpha):
    """Return field and force (3,) on a dipole u at a vector r from v, with clouds of width 1/alpha and no waves.

    The dipole also feels its own cloud, which would leave few digits of what is screened: v is made strong for a while.
    """
    box, cutoff, strong = 400.0, 200.0, 2.0**70
    kernel = SoftDipoles((cutoff, 0.9 * cutoff, 0.0), (alpha, 1e-3, np.inf))
    sites = sites_of(np.array([r, np.zeros(3)]), np.array([u, strong * v]))
    _, forces = kernel.energy_and_forces(sites, {"soft_repulsion": 0.0, "dipole_coupling": 1.0}, box * np.eye(3))
    return forces[1] / strong, (forces[0] + forces[1]) / strong


def exact_screening(r, alpha):
    """Return B1, B2 and B3, the derivatives -1/r d/dr of erfc(alpha r)/r, in mpmath."""
    gauss = 2 * alpha / mp.sqrt(mp.pi) * mp.exp(-((alpha * r) ** 2)) / r**2
    B = [mp.erfc(alpha * r) / r**3 + gauss]
    for k in (1, 2):
        B.append((2 * k + 1) * B[-1] / r**2 + (2 * alpha**2) ** k * gauss)
    return B


def test_the_functions_of_screened_dipoles_are_derivatives_of_a_screened_charge():
    with mp.workdps(40):
        r, alpha = mp.mpf("0.7"), mp.mpf("1.4")
        taylor = mp.taylor(lambda s: mp.erfc(alpha * mp.sqrt(s)) / mp.sqrt(s), r**2, 3)
        for k, exact in enumerate(exact_screening(r, alpha), 1):
            assert abs((-2) ** k * mp.factorial(k) * taylor[k] / exact - 1) < 1e-20


def test_the_functions_of_screened_dipoles_are_exact():
    """Errors relative to the terms that are added up, down to 1e-14 of what is bare.

    A field is -B1 v + B2 (v.r) r, and a force B2 (u.v r + u.r v + v.r u) - B3 u.r v.r r.
    """
    x, y, z = np.eye(3)
    alpha = 1.4
    with mp.workdps(40):
        for r in np.linspace(0.05, 4.0, 80):
            B1, B2, B3 = exact_screening(mp.mpf(r), mp.mpf(alpha))
            assert abs(screened(r * z, x, y, alpha)[0][1] / -B1 - 1) < 2e-14
            d, e = 0.6 * r, 0.8 * r
            B = exact_screening(mp.sqrt(mp.mpf(d) ** 2 + mp.mpf(e) ** 2), mp.mpf(alpha))
            assert abs(screened(d * x + e * y, z, x, alpha)[0][1] / (B[1] * d * e) - 1) < 2e-14
            force = screened(r * x, x + y, x - y, alpha)[1][0]
            assert abs(force - (2 * B2 * r - B3 * mp.mpf(r) ** 3)) < 2e-14 * (2 * B2 * r + B3 * r**3)


def test_nothing_is_left_of_a_screened_dipole_far_away():
    field, force = screened(np.array([100.0, 0.0, 0.0]), np.eye(3)[0], np.eye(3)[1], 1.0)
    assert np.abs(field[1:]).max() < 1e-22
    assert np.abs(force).max() < 1e-22


# -- sums known otherwise ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [2, 3])
def test_parallel_dipoles_on_a_cubic_lattice_feel_the_field_of_lorentz(side):
    """Errors of 1e-12 add up where all dipoles have the same neighbours."""
    a, mu = 1.3, np.array([0.3, -0.5, 0.8])
    R = a * np.argwhere(np.ones((side, side, side)))
    energy, forces = dipoles_alone(sites_of(R, np.tile(mu, (len(R), 1))), 3 * [side * a])
    np.testing.assert_allclose(forces[1::2], np.tile(4.0 * np.pi / 3.0 * mu / a**3, (len(R), 1)), rtol=1e-11)
    assert energy == pytest.approx(-2.0 * np.pi / 3.0 * len(R) * (mu @ mu) / a**3, rel=1e-11)


@pytest.mark.parametrize("n", [27, pytest.param(125, marks=pytest.mark.validate)])
def test_a_liquid_has_the_energy_and_the_fields_of_a_plain_sum(n):
    R, mu, box = liquid(n)
    energy, forces = dipoles_alone(sites_of(R, mu), 3 * [box])
    exact, field = dipole_ewald(R, mu, box, 11.0 / box)
    assert energy == pytest.approx(exact, rel=2e-12)
    np.testing.assert_allclose(forces[1::2], field, rtol=0.0, atol=5e-12 * np.abs(field).max())


def amoeba_energy(R, mu, box):
    """Return the energy of the same dipoles from the particle mesh Ewald sum of OpenMM's AMOEBA."""
    force, system = openmm.AmoebaMultipoleForce(), openmm.System()
    force.setNonbondedMethod(force.PME)
    force.setPolarizationType(force.Direct)
    force.setCutoffDistance(0.499 * box)
    force.setAEwald(8.0 / box)
    force.setPmeGridDimensions([96, 96, 96])
    strength = float(np.linalg.norm(mu[0])) / rb.dipole_strength(1.0 * unit.elementary_charge * unit.nanometer)
    for i in range(len(R)):
        system.addParticle(1.0)
        system.addParticle(1.0)
        force.addMultipole(0.0, [0, 0, strength], [0] * 9, force.ZOnly, 2 * i + 1, -1, -1, 0.39, 0.0, 0.0)
        force.addMultipole(0.0, [0, 0, 0], [0] * 9, force.NoAxisType, -1, -1, -1, 0.39, 0.0, 0.0)
    system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*(box * np.eye(3)))
    return evaluated(resting(system, sites_of(R, 0.1 * mu)))[0]


def test_the_plain_sum_is_right():
    """It does not depend on its splitting, has minus the gradient as its field, and agrees with OpenMM's AMOEBA."""
    R, mu, box = liquid(27)
    energy, field = dipole_ewald(R, mu, box, 11.0 / box)
    assert dipole_ewald(R, mu, box, 13.0 / box)[0] == pytest.approx(energy, rel=1e-11)
    step = np.zeros_like(mu)
    step[3] = 0.01, 0.02, -0.03
    rise = dipole_ewald(R, mu + step, box, 11.0 / box)[0] - dipole_ewald(R, mu - step, box, 11.0 / box)[0]
    assert rise == pytest.approx(-2.0 * np.sum(field * step), rel=1e-9)
    assert amoeba_energy(R, mu, box) == pytest.approx(energy, rel=1e-5)


def test_a_box_and_two_of_it_are_the_same_crystal(rng):
    R, mu = 4.0 * rng.random((6, 3)), rng.standard_normal((6, 3))
    edges = np.array([4.0, 4.5, 5.0])
    energy, forces = dipoles_alone(sites_of(R, mu), edges)
    for axis in range(3):
        double = np.concatenate([R, R + np.eye(3)[axis] * edges[axis]])
        twice, again = dipoles_alone(sites_of(double, np.tile(mu, (2, 1))), edges * (1.0 + np.eye(3)[axis]))
        assert twice == pytest.approx(2.0 * energy, rel=1e-11)
        np.testing.assert_allclose(again[: len(forces)], forces, rtol=0.0, atol=1e-11 * np.abs(forces).max())


def test_other_surroundings_add_the_energy_of_the_surface(rng):
    x, box = arrows(27, rng)
    M = (x[1::2] - x[0::2]).sum(axis=0)
    tin, vacuum, water = (dipoles_alone(x, 3 * [box], dielectric=d)[0] for d in (np.inf, 1.0, 80.0))
    assert vacuum - tin == pytest.approx(2.0 * np.pi / 3.0 * (M @ M) / box**3, rel=1e-10)
    assert water - tin == pytest.approx(2.0 * np.pi / 161.0 * (M @ M) / box**3, rel=1e-8)


# -- tolerance and derivatives ----------------------------------------------------------------------------------


def gas(n):
    """Return centres, dipoles and box of dipoles at a density of 0.05."""
    rng = np.random.default_rng(4)
    side, box = round(n ** (1.0 / 3.0)), (n / 0.05) ** (1.0 / 3.0)
    R = (np.argwhere(np.ones((side, side, side))) + 0.3 * rng.random((n, 3))) * box / side
    return R, rng.standard_normal((n, 3)), box


@pytest.mark.parametrize(
    ("kind", "n", "cutoff", "switch"),
    [
        (liquid, 27, None, 0.5),
        (liquid, 27, None, 0.9),
        (liquid, 125, 1.5, 0.9),
        (gas, 64, None, 0.5),
        (gas, 64, None, 0.9),
        *(
            pytest.param(*case, marks=pytest.mark.validate)
            for case in (
                *((liquid, 216, *of) for of in ((None, 0.5), (1.5, 0.5), (1.5, 0.9))),
                (gas, 216, 3.0, 0.9),
            )
        ),
    ],
)
def test_the_error_is_below_the_tolerance_and_not_much_smaller(kind, n, cutoff, switch):
    """Root mean square errors of the dipoles' forces and fields."""
    R, mu, box = kind(n)
    x, edges = sites_of(R, mu), 3 * [box]
    _, exact = dipoles_alone(x, edges, tolerance=1e-12)

    def forces_and_fields(forces):
        return forces[0::2] + forces[1::2], forces[1::2]

    finest = [1e-9] if cutoff is None and n < 100 else []  # a short cutoff needs more waves for it than are allowed
    for tolerance in [1e-2, 1e-3, 1e-4, 1e-6, *finest]:
        _, forces = dipoles_alone(
            x, edges, tolerance=tolerance, cutoff=cutoff, switch=switch * (0.5 * box if cutoff is None else cutoff)
        )
        errors = [
            np.linalg.norm(found - right) / np.linalg.norm(right)
            for found, right in zip(forces_and_fields(forces), forces_and_fields(exact), strict=True)
        ]
        assert tolerance / 6.0 < max(errors) < tolerance


def test_moved_by_whole_boxes_a_liquid_is_the_same(rng):
    x, box = arrows(27, rng)
    energy, forces = dipoles_alone(x, 3 * [box], tolerance=1e-6)
    far = x + box * rng.integers(-400, 400, (27, 1, 3)).repeat(2, axis=1).reshape(-1, 3)
    again = dipoles_alone(far, 3 * [box], tolerance=1e-6)
    assert again[0] == pytest.approx(energy, rel=1e-11)
    np.testing.assert_allclose(again[1], forces, rtol=0.0, atol=1e-10 * np.abs(forces).max())


def test_a_dipole_feels_its_images():
    """Alone in a cube, the field of Lorentz; three in a slab, what they feel in a cube of six slabs."""
    mu, box = np.array([0.3, -0.5, 0.8]), 1.7
    _, forces = dipoles_alone(sites_of(np.full((1, 3), 0.4), mu[None]), 3 * [box])
    np.testing.assert_allclose(forces[1], 4.0 * np.pi / 3.0 * mu / box**3, rtol=1e-11)

    edges = np.array([1.0, 1.5, 3.0])
    rng = np.random.default_rng(2)
    R, mu = edges * rng.random((3, 3)), rng.standard_normal((3, 3))
    energy, forces = dipoles_alone(sites_of(R, mu), edges)
    shifts = edges * np.argwhere(np.ones((3, 2, 1)))
    exact, field = dipole_ewald((R + shifts[:, None]).reshape(-1, 3), np.tile(mu, (6, 1)), 3.0, 11.0 / 3.0)
    np.testing.assert_allclose(forces[1::2], field[:3], rtol=0.0, atol=1e-10 * np.abs(field).max())
    assert energy == pytest.approx(exact / 6.0, rel=1e-9)
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-12 * np.abs(forces).max())


# -- in a Context -----------------------------------------------------------------------------------------------


def test_the_sum_follows_the_box_of_the_context():
    context, _ = fluid(27, boundary=rb.Ewald(cutoff=1.7, tolerance=1e-12), density=0.5, sphere_cutoff=1.7)
    edges = np.array([3.6, 3.7, 3.9])
    context.setPeriodicBoxVectors(*np.diag(edges))
    context.setParameter("soft_repulsion", 0.0)
    x = positions_of(context).reshape(27, -1, 3)[:, -2:].reshape(-1, 3)
    energy, _ = dipoles_alone(x, edges, coupling=context.getParameter("dipole_coupling"))
    assert evaluated(context)[0] == pytest.approx(energy, rel=1e-11)


@pytest.mark.parametrize("boundary", [{"cutoff": 1.9}, {"method": "mesh", "cutoff": 1.5, "tolerance": 1e-3}], ids=str)
def test_a_barostat_changes_the_box_of_the_sum(boundary):
    _, system, positions = rb.dipole_fluid(64, 3, density=0.6, sphere_cutoff=1.9, boundary=rb.Ewald(**boundary))
    barostat = openmm.MonteCarloBarostat(20.0, 120.0, 2)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    integrator = rb.ExactRigidBodyIntegrator(0.004, scheme="S2_2")
    context = starts.context_of(system, integrator, positions)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    integrator.setVelocitiesToTemperature(120.0, 1)
    volume = context.getState().getPeriodicBoxVolume()
    integrator.step(40)
    state = context.getState(positions=True, energy=True)
    assert abs(state.getPeriodicBoxVolume() / volume - 1.0) > 1e-3
    again = resting(system, state.getPositions())
    again.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    assert again.getState(energy=True).getPotentialEnergy() == state.getPotentialEnergy()


@pytest.mark.parametrize("wca", [False, True])
def test_a_serialised_system_has_the_same_sum(wca):
    context, _ = fluid(27, boundary=rb.Ewald(dielectric=4.0), density=0.5, attraction=1.0, wca=wca)
    system = openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(context.getSystem()))
    assert_same(evaluated(resting(system, positions_of(context))), evaluated(context), 0.0)
