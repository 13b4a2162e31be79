"""The Ewald sum on a mesh, and pairs through cells: exact derivatives, the tolerance, and what is chosen."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from benchmarks.dipoles import dipole_scale, nufft_ewald
from force_laws import assert_gradient, evaluated, resting
from openmm_exactrb.potentials import ewald, ewald_errors
from soft_dipoles import arrows, assert_same, dipoles_alone, fluid, liquid, sites_of, summed
from starts import positions_of

MESH = {"method": "mesh", "cutoff": 1.5, "tolerance": 1e-3}


def parts(sites, forces):
    """Return forces, fields and torques (n, 3) of dipoles."""
    pulls = forces[1::2]
    return forces[0::2] + pulls, pulls, np.cross(sites[1::2] - sites[0::2], pulls)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("n", [125, 216])
def test_errors_of_forces_fields_and_torques_are_below_the_tolerance(n, tolerance):
    R, mu, box = liquid(n)
    x, edges = sites_of(R, mu), 3 * [box]
    _, exact = dipoles_alone(x, edges)
    _, forces = dipoles_alone(x, edges, tolerance=tolerance, method="mesh")
    for found, right in zip(parts(x, forces), parts(x, exact), strict=True):
        assert np.linalg.norm(found - right) < tolerance * np.linalg.norm(right)


@pytest.mark.parametrize("order", [8, 10])
@pytest.mark.parametrize("dielectric", [np.inf, 3.0])
def test_forces_are_the_exact_gradient_of_the_energy_on_the_mesh(rng, order, dielectric):
    x, box = arrows(64, rng)
    edges = box * np.array([1.0, 1.1, 1.3])
    options = MESH | {"tolerance": 1e-2, "order": order, "dielectric": dielectric, "coupling": 2.0}
    _, forces = dipoles_alone(x, edges, **options)
    assert_gradient(lambda y: dipoles_alone(y, edges, **options)[0], x, forces, (4, 21), 1e-8)


def test_the_energy_on_the_mesh_does_not_change_when_all_move(rng):
    x, box = arrows(64, rng)
    energy, _ = summed(x, rb.Ewald(**MESH), 3 * [box])
    moved, _ = summed(x + 0.3 * rng.standard_normal(3), rb.Ewald(**MESH), 3 * [box])
    assert moved == pytest.approx(energy, rel=1e-12)


def test_pairs_through_cells_are_those_of_all_rows(rng):
    """A cutoff of 0.4 of the box has five cells an edge, a longer one none."""
    x, box = arrows(125, rng)
    pairs = [
        summed(x, rb.ReactionField(cutoff=part * box, switch=0.25 * box), 3 * [box], soft_attraction=3.0)
        for part in (0.4, 0.4 * (1.0 + 1e-9))
    ]
    assert_same(*pairs, 1e-6)


def test_few_dipoles_are_summed_directly_and_many_on_a_mesh():
    kinds = [rb.Ewald().getParameters(n, 3 * [(n / 0.8) ** (1 / 3)]) for n in (27, 1000, 27000)]
    assert [kind.method for kind in kinds] == ["direct", "mesh", "mesh"]
    assert kinds[1].cutoff == pytest.approx(kinds[2].cutoff, rel=0.1)
    assert all(kind.error <= 1e-4 for kind in kinds)


def test_what_is_given_is_taken():
    box = 3 * [10.0]
    chosen = rb.Ewald(mesh=48, order=10, cutoff=3.0, switch=2.0).getParameters(1000, box)
    assert chosen[:3] == ("mesh", 3.0, 2.0)
    assert chosen[5:7] == (10, (48, 48, 48))
    assert rb.Ewald(mesh=[48, 48, 48], order=10, cutoff=3.0, switch=2.0).getParameters(1000, box) == chosen
    again = rb.Ewald(cutoff=chosen.cutoff, mesh=chosen.points, order=chosen.order, switch=chosen.switch)
    assert again.getParameters(1000, box) == chosen
    assert rb.Ewald(method="direct").getParameters(1000, box).cutoff == 5.0


@pytest.mark.validate
@pytest.mark.parametrize("n", [125, 8000, 27000])
def test_forces_and_fields_are_those_of_nonuniform_fourier_transforms(n):
    """An independent sum, by finufft: also of more dipoles than a direct sum takes."""
    pytest.importorskip("finufft")
    R, mu, box = dipole_scale.liquid(n)
    energy, forces, fields = nufft_ewald.dipole_sum(R, mu, box)
    x, right = sites_of(R, mu), (forces, fields, np.cross(mu, fields))
    for settings in [{"tolerance": t} for t in (1e-3, 1e-4, 1e-5, 1e-6)] + [{"method": "direct"}] * (n == 125):
        total, found = dipoles_alone(x, 3 * [box], **settings)
        errors = [np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(parts(x, found), right, strict=True)]
        assert max(errors) < settings.get("tolerance", 1e-11)
        assert total == pytest.approx(energy, rel=10.0 * settings.get("tolerance", 1e-12))


def test_a_restart_goes_on_bit_for_bit_and_a_serialised_system_has_the_same_mesh():
    context, integrator = fluid(64, "S6_10", boundary=rb.Ewald(**MESH), density=0.5, attraction=1.0)
    integrator.setVelocitiesToTemperature(120.0, 1)
    integrator.step(3)
    kept = context.createCheckpoint()
    integrator.step(5)
    first = positions_of(context)
    context.loadCheckpoint(kept)
    integrator.step(5)
    np.testing.assert_array_equal(positions_of(context), first)
    system = openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(context.getSystem()))
    assert_same(evaluated(resting(system, positions_of(context))), evaluated(context), 0.0)


@pytest.mark.parametrize("scheme", ["S2_2", "S6_10", "SRKN6_14a"])
def test_the_energy_error_of_a_scheme_is_that_of_the_direct_sum(scheme):
    R = []
    for method in ("direct", "mesh"):
        boundary = rb.Ewald(method=method, cutoff=1.9, tolerance=1e-3)
        context, integrator = fluid(64, scheme, boundary=boundary, density=0.6, attraction=1.0)
        openmm.LocalEnergyMinimizer.minimize(context, 100.0, 30)
        integrator.setVelocitiesToTemperature(120.0, 1)
        start, errors = integrator.totalEnergy()._value, []
        for _ in range(10):
            integrator.step(2)
            errors.append(abs(integrator.totalEnergy()._value - start))
        R.append(max(errors))
    assert R[1] == pytest.approx(R[0], rel=0.3)


def test_the_estimates_shrink_as_formulas_say():
    """Errors of a mesh fall with the power of its order, those of pairs as a Gaussian."""
    coarse, fine = (ewald_errors.of_mesh(0.5, step, 8, 1.0) for step in (0.6, 0.3))
    assert 6.5 < np.log2(coarse / fine) < 9.0
    near, far = (ewald_errors.of_pairs(1.0, cutoff, 0.99 * cutoff, 1.0) for cutoff in (3.0, 4.0))
    assert np.log(near / far) == pytest.approx(7.0, abs=0.7)
    assert ewald.MOST_POINTS >= 512
