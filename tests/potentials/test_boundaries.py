"""What is around dipoles: numbers that fit, a switch that is smooth, a reaction field that is the wanted one."""

import dataclasses

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb import ensemble
from openmm_exactrb.potentials.boundaries import sharp_volume
from orders import exponent
from soft_dipoles import dipoles_alone, fluid, liquid, sites_of, summed, truncated

PERIODIC = [rb.ReactionField, rb.Ewald]


# -- numbers --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", PERIODIC)
def test_the_cutoff_is_half_the_shortest_edge_and_the_switch_three_quarters_of_it(kind):
    assert kind().truncation((3.0, 4.0, 5.0))[:2] == (1.5, 1.125)
    assert kind(cutoff=1.2).truncation((3.0, 4.0, 5.0))[:2] == (1.2, 0.75 * 1.2)
    assert kind(cutoff=np.float64(1.2), switch=np.float64(0.5)).truncation((3.0, 4.0, 5.0))[:2] == (1.2, 0.5)


def test_numbers_of_numpy_write_the_same_system():
    plain = rb.ReactionField(cutoff=1.2, switch=0.5, dielectric=7.0)
    of_numpy = rb.ReactionField(**{name: np.float64(value) for name, value in dataclasses.asdict(plain).items()})
    for kernel in ("bonds", "compiled"):
        texts = [
            openmm.XmlSerializer.serialize(rb.dipole_fluid(8, boundary=boundary, kernel=kernel, density=0.3)[1])
            for boundary in (plain, of_numpy)
        ]
        assert texts[0] == texts[1]


def test_a_boundary_is_a_value():
    assert rb.Ewald(cutoff=1.0) == rb.Ewald(cutoff=1.0) != rb.ReactionField(cutoff=1.0)
    assert len({rb.Open(), rb.Open(), rb.Ewald(), rb.Ewald(tolerance=1e-3)}) == 3
    assert repr(rb.ReactionField()) == "ReactionField(cutoff=None, switch=None, dielectric=inf)"
    with pytest.raises(dataclasses.FrozenInstanceError):
        rb.Ewald().cutoff = 1.0


def test_jobs_take_boundaries():
    def key(boundary):
        return ensemble.Job(rb.dipole_fluid, boundary=boundary).key

    assert key(rb.Ewald()) == key(rb.Ewald(tolerance=1e-4)) != key(rb.Ewald(tolerance=1e-3))
    assert key(rb.Ewald()) != key(rb.ReactionField())


# -- the box of the Context -----------------------------------------------------------------------------------------


# -- the switch -----------------------------------------------------------------------------------------------------


def test_forces_are_smooth_where_the_switch_begins_and_ends():
    """The second derivative of the force between two dipoles has no step at either end."""
    box = 10.0
    u, v = np.array([0.1, 0.4, 0.2]), np.array([0.5, -0.3, 0.1])

    def pull(r):
        x = np.array([[0.0, 0.0, 0.0], u, [r, 0.0, 0.0], v + np.array([r, 0.0, 0.0])])
        return summed(x, truncated(box), 3 * [box])[1][2]

    d = 1e-3
    for end in (0.25 * box, 0.4 * box):
        before, after = (
            (pull(end + s + d) - 2 * pull(end + s) + pull(end + s - d)) / d**2 for s in (-1.5 * d, 1.5 * d)
        )
        assert np.abs(before - after).max() < 0.02
    assert np.abs(pull(0.4 * box + d)).max() == 0.0


@pytest.mark.parametrize(("scheme", "order"), [("SRKN4_6b", 4), ("S6_10", 6)])
@pytest.mark.parametrize("boundary", [rb.ReactionField(), rb.Ewald(tolerance=1e-2)], ids=["reaction field", "ewald"])
def test_a_liquid_keeps_its_energy_to_the_order_of_the_scheme(boundary, scheme, order):
    """With OpenMM's formula too: it has the same forces (test_formula)."""
    context, integrator = fluid(27, density=0.8, boundary=boundary, dipole=(0.0, 0.0, 1.0), scheme=scheme)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0)
    integrator.setVelocitiesToTemperature(60.0, 3)
    start = context.getState(positions=True, velocities=True)

    def total_energy():
        return integrator.totalEnergy()._value

    steps, swings = (0.004, 0.008 / 3, 0.002), []
    for h in steps:
        context.setPositions(start.getPositions())
        context.setVelocities(start.getVelocities())
        integrator.setStepSize(h)
        energies = [total_energy()]
        for _ in range(10):
            integrator.step(round(0.008 / h))
            energies.append(total_energy())
        swings.append(np.ptp(energies))
    assert exponent(steps, swings) == pytest.approx(order, abs=0.25)


# -- the reaction field ---------------------------------------------------------------------------------------------


def field_of(sites, **settings):
    """Return the fields (n, 3) of dipoles without spheres, in a cubic box cut off at half its edge."""
    box = settings.pop("box")
    boundary = rb.ReactionField(cutoff=0.5 * box, **settings)
    return summed(sites, boundary, 3 * [box], soft_repulsion=0.0, dipole_coupling=1.0)[1][1::2]


def test_the_sharp_sphere_has_the_volume_of_the_switched_one():
    """3 integral S r² dr from forces alone: -integral of r³ dS/dr, by the trapezoidal rule on a smooth S."""
    cutoff, switch = 1.7, 0.6
    r = np.linspace(switch, cutoff, 2001)
    s = (cutoff**2 - r**2) / (cutoff**2 - switch**2)
    rate = 12012.0 * (s * (1.0 - s)) ** 6 * 2.0 * r / (cutoff**2 - switch**2)
    assert sharp_volume(cutoff, switch) == pytest.approx(np.sum(r**3 * rate) * (r[1] - r[0]), rel=1e-12)


@pytest.mark.parametrize("switch", [0.0, 1.3, 2.4])
def test_a_uniform_polarisation_has_the_reaction_field_that_was_asked_for(switch):
    """The field of unit dipoles that fill the switched sphere, 4 pi/3 between conductors, on the one in its middle."""
    box, dielectric = 5.0, 4.0

    def reaction(r):
        """Return the field of a dipole on one like it, mean over the angles between field and direction."""
        fields = []
        for axis in np.eye(3):
            x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], r * axis, r * axis + [0.0, 0.0, 1.0]])
            fields.append(field_of(x, box=box, switch=switch, dielectric=dielectric)[0, 2])
        return np.mean(fields)

    x, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for low, high in ((1e-6, max(switch, 1e-6)), (max(switch, 1e-6), 0.5 * box)):
        r = 0.5 * (low + high + (high - low) * x)
        total += 0.5 * (high - low) * np.sum(weights * 4.0 * np.pi * r**2 * [reaction(a) for a in r])
    wanted = 4.0 * np.pi / 3.0 * 2.0 * (dielectric - 1.0) / (2.0 * dielectric + 1.0)
    assert total == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(("n", "most"), [(125, 0.12), pytest.param(343, 0.07, marks=pytest.mark.validate)])
def test_a_reaction_field_comes_close_to_the_ewald_sum_in_a_large_box(n, most):
    """Largest root mean square errors of the field on a dipole; more without it."""
    R, mu, box = liquid(n)
    x = sites_of(R, mu)
    exact = dipoles_alone(x, 3 * [box], tolerance=1e-3)[1][1::2]
    errors = [
        np.linalg.norm(field_of(x, box=box, switch=0.375 * box, dielectric=dielectric) - exact) / np.linalg.norm(exact)
        for dielectric in (np.inf, 1.0)
    ]
    assert errors[0] < most
    assert errors[0] < 0.75 * errors[1]
