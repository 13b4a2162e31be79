"""The soft dipole potential: energy, forces and torques against formulas of their own and finite differences."""

import copy
import itertools
import pickle
import re
from pathlib import Path

import numpy as np
import openmm
import pytest
from scipy.spatial.transform import Rotation

import openmm_exactrb as rb
from force_laws import assert_lawful, energy_and_forces, evaluated, resting, slope
from openmm_exactrb.potentials import SoftDipoles
from soft_dipoles import FIELD, PARAMETERS, arrows, assert_same, fluid, truncated
from starts import masses_of, positions_of

DATA = Path(__file__).parent.parent / "data"
HEAD_TO_TAIL = [(0, 1), (2, 3)]


# -- against the formula, vector by vector --------------------------------------------------------------------------


def reference(R, mu, sigma=1.0, epsilon=1.0):
    """Energy, forces (N, 3) and space-frame torques (N, 3) of soft spheres with point dipoles, vector by vector."""
    energy, force, torque = 0.0, np.zeros_like(R), np.zeros_like(R)
    for i, j in itertools.combinations(range(len(R)), 2):
        r = R[i] - R[j]
        d = np.linalg.norm(r)
        energy += 4 * epsilon * (sigma / d) ** 12
        energy += mu[i] @ mu[j] / d**3 - 3 * (mu[i] @ r) * (mu[j] @ r) / d**5
        pull = 48 * epsilon * sigma**12 * r / d**14
        pull += 3 / d**5 * ((mu[i] @ mu[j]) * r + (mu[j] @ r) * mu[i] + (mu[i] @ r) * mu[j])
        pull -= 15 / d**7 * (mu[i] @ r) * (mu[j] @ r) * r
        force[i] += pull
        force[j] -= pull
        field_at_i = 3 * (mu[j] @ r) * r / d**5 - mu[j] / d**3
        field_at_j = 3 * (mu[i] @ r) * r / d**5 - mu[i] / d**3
        torque[i] += np.cross(mu[i], field_at_i)
        torque[j] += np.cross(mu[j], field_at_j)
    return energy, force, torque


@pytest.fixture(params=["paper", "tetrahedron"])
def droplet(request):
    own = {"inertia": (1.0, 1.5, 2.0), "dipole": (0.3, -0.8, 0.5), "mass": 3.0, "sigma": 0.9, "epsilon": 1.7}
    options = {} if request.param == "paper" else own
    context, _ = fluid(9, seed=3, perturbation=0.05, **options)
    return context, options


def sites(context):
    return positions_of(context).reshape(9, -1, 3)


def energy_of(context, x):
    context.setPositions(x.reshape(-1, 3))
    context.computeVirtualSites()
    return evaluated(context)[0]


def forces_and_torques(context):
    """Return centres, total forces and space-frame torques of the bodies."""
    x, system = sites(context), context.getSystem()
    mass = masses_of(system).reshape(9, -1)
    F = evaluated(context)[1].reshape(x.shape) * (mass > 0)[..., None]
    centre = np.einsum("ns,nsi->ni", mass, x) / mass.sum(1, keepdims=True)
    return centre, F.sum(1), np.cross(x - centre[:, None], F).sum(1)


def test_energy_forces_and_torques_agree_with_the_vector_formula(droplet):
    context, options = droplet
    x = sites(context)
    centre, tip = x[:, -2], x[:, -1]
    strength = np.linalg.norm(options.get("dipole", (0.0, 1.0, 1.0)))
    mu = (tip - centre) * (strength / np.linalg.norm(tip - centre, axis=1, keepdims=True))
    energy, force, torque = reference(centre, mu, options.get("sigma", 1.0), options.get("epsilon", 1.0))
    _, F, tau = forces_and_torques(context)
    assert abs(energy_of(context, x) - energy) < 1e-12 * abs(energy)
    np.testing.assert_allclose(F, force, rtol=0.0, atol=1e-12 * np.abs(force).max())
    np.testing.assert_allclose(tau, torque, rtol=0.0, atol=1e-12 * max(1.0, np.abs(torque).max()))


def test_forces_and_torques_are_finite_differences_of_openmms_energy(droplet):
    context, _ = droplet
    x = sites(context)
    centre, F, tau = forces_and_torques(context)
    for body, axis in itertools.product((0, 4, 8), range(3)):
        e = np.eye(3)[axis]

        def moved(s, body=body, e=e):
            y = x.copy()
            y[body] += s * e
            return energy_of(context, y)

        def turned(s, body=body, e=e):
            y = x.copy()
            y[body] = centre[body] + Rotation.from_rotvec(s * e).apply(x[body] - centre[body])
            return energy_of(context, y)

        for function, expected in ((moved, F[body, axis]), (turned, tau[body, axis])):
            assert abs(slope(function) + expected) < 1e-8 * max(1.0, np.abs(F).max())


def test_total_force_and_total_torque_are_zero(droplet):
    context, _ = droplet
    centre, F, tau = forces_and_torques(context)
    assert np.abs(F.sum(0)).max() < 1e-13 * np.abs(F).sum()
    assert np.abs((tau + np.cross(centre, F)).sum(0)).max() < 1e-12 * np.abs(F).sum()


def test_energy_does_not_change_when_all_bodies_move_turn_or_change_places(droplet, rng):
    context, _ = droplet
    x = sites(context)
    energy = energy_of(context, x)
    turn = Rotation.random(rng=rng)
    for same in (x + np.array([1.0, -2.0, 0.5]), turn.apply(x.reshape(-1, 3)), x[rng.permutation(9)]):
        assert abs(energy_of(context, np.asarray(same)) - energy) < 1e-12 * abs(energy)


# -- the definition of its parts ------------------------------------------------------------------------------------


def of_two(r, kernel="auto", **options):
    """Return energy and forces of two dipoles along z, side by side at a distance r."""
    force = rb.soft_dipole_force(HEAD_TO_TAIL, length=0.5, kernel=kernel, **options)
    return energy_and_forces(force, np.array([[0, 0, 0], [0, 0, 0.5], [r, 0, 0], [r, 0, 0.5]]))


def test_two_dipoles_head_to_tail_bind_where_r9_is_4():
    force = rb.soft_dipole_force(HEAD_TO_TAIL, strength=2**0.5, length=0.5)

    def energy(r):
        return energy_and_forces(force, np.array([[0, 0, 0], [0, 0, 0.5], [0, 0, r], [0, 0, r + 0.5]]))[0]

    r = 4 ** (1 / 9)
    assert energy(r) == pytest.approx(-4 / r**3 + 4 / r**12, rel=1e-13)
    assert energy(r) < min(energy(0.999 * r), energy(1.001 * r))


def test_two_stockmayer_spheres_have_the_energy_of_their_definition():
    """Side by side and parallel: 4 epsilon ((sigma/r)^12 - (sigma/r)^6) + mu²/r³."""
    r, mu = 1.3, 1.7
    energies = [of_two(r, strength=mu, sigma=1.1, attraction=attraction)[0] for attraction in (0.0, 1.0)]
    core, pull = 4.0 * (1.1 / r) ** 12, 4.0 * (1.1 / r) ** 6
    assert energies == pytest.approx([core + mu**2 / r**3, core - pull + mu**2 / r**3], rel=1e-13)


@pytest.mark.parametrize("kernel", ["openmm", "compiled"])
def test_spheres_of_weeks_chandler_and_andersen_only_repel(kernel):
    """Lennard-Jones up to its minimum at 2^(1/6) sigma, raised by epsilon."""
    sigma, epsilon = 1.1, 1.7
    own = {"strength": 1e-6, "sigma": sigma, "epsilon": epsilon, "attraction": 1.0, "wca": True}
    for r, inside in ((0.9, True), (1.2, True), (1.234, True), (1.236, False), (3.0, False)):
        exact = (4.0 * epsilon * ((sigma / r) ** 12 - (sigma / r) ** 6) + epsilon) * inside
        energy, forces = of_two(r, kernel, **own)
        assert energy == pytest.approx(exact, rel=1e-10, abs=1e-11)
        assert forces[2, 0] == pytest.approx(
            24.0 * epsilon * (2.0 * (sigma / r) ** 12 - (sigma / r) ** 6) / r * inside, abs=1e-10
        )


@pytest.mark.parametrize(
    ("periodic", "kernel"),
    [
        (False, "bonds"),
        (False, "compiled"),
        (True, "compiled"),
        pytest.param(True, "bonds", marks=pytest.mark.validate),  # whose gradient OpenMM takes, for seconds
    ],
)
def test_the_force_is_lawful(kernel, periodic, rng):
    x, box = arrows(12, rng)
    around = {"boundary": truncated(box), "box": 3 * [box]} if periodic else {}
    pairs = np.arange(24).reshape(12, 2).tolist()
    assert_lawful(rb.soft_dipole_force(pairs, strength=1.5, length=0.5, kernel=kernel, **around), x, around.get("box"))


@pytest.mark.parametrize("kernel", ["compiled", "openmm"])
def test_arrows_may_be_an_array_or_an_iterator(kernel):
    pairs = np.arange(8).reshape(4, 2)
    asked = {"strength": 1.0, "length": 0.5, "kernel": kernel}
    texts = {
        openmm.XmlSerializer.serialize(rb.soft_dipole_force(arrows, **asked))
        for arrows in (pairs, iter(pairs.tolist()), pairs.tolist())
    }
    assert len(texts) == 1


# -- who computes it ------------------------------------------------------------------------------------------------


def potential(system):
    return system.getForce(0)


def test_the_kernel_is_compiled_unless_another_is_named():
    assert isinstance(potential(rb.dipole_fluid(2)[1]), openmm.PythonForce)
    assert isinstance(potential(rb.dipole_fluid(2, kernel="bonds")[1]), openmm.CustomCompoundBondForce)


@pytest.mark.parametrize("options", [{}, FIELD], ids=["open", "periodic"])
def test_a_system_survives_xml_copy_and_pickle(options):
    context, _ = fluid(9, kernel="compiled", **({} if not options else options | {"density": 0.15}))
    system = context.getSystem()
    for again in (
        openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(system)),
        copy.deepcopy(system),
        pickle.loads(pickle.dumps(system)),
    ):
        assert_same(evaluated(context), evaluated(resting(again, positions_of(context))), 1e-16)


def test_a_system_that_an_older_package_wrote_is_read_and_written_the_same():
    """The file is of a package whose spheres ended where the dipoles do: such a System keeps its model."""
    text = (DATA / "soft_dipoles.xml").read_text(encoding="utf-8")
    system = openmm.XmlSerializer.deserialize(text)
    assert re.sub(r'openmmVersion="[^"]*"', "", openmm.XmlSerializer.serialize(system)) == re.sub(
        r'openmmVersion="[^"]*"', "", text
    )
    boundary, edges = rb.Ewald(dielectric=4.0), 3 * (4.0 ** (1.0 / 3.0),)
    _, _, positions = rb.dipole_fluid(2, boundary=boundary, density=0.5)
    context = resting(system, positions)
    sites = positions_of(context).reshape(2, -1, 3)[:, -2:].reshape(-1, 3)
    dipoles = SoftDipoles(boundary.truncation(edges, 2), boundary.images(2, edges), wca=True)
    energy, _ = dipoles.energy_and_forces(sites, dict(context.getParameters()), np.diag(edges))
    assert evaluated(context)[0] == pytest.approx(energy, rel=1e-13)


def test_what_the_force_computes_can_be_computed_without_openmm(rng):
    x, box = arrows(8, rng)
    force = rb.soft_dipole_force(np.arange(16).reshape(8, 2).tolist(), strength=1.5, length=0.5, kernel="compiled")
    assert_same(SoftDipoles().energy_and_forces(x, PARAMETERS | {"dipole_coupling": 9.0}), energy_and_forces(force, x))
    with pytest.raises(ValueError, match="rectangular box"):
        SoftDipoles((0.4 * box, 0.2 * box, 0.0)).energy_and_forces(x, PARAMETERS)
