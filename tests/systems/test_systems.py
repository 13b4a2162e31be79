"""dipole_fluid: sites with exactly the wanted mass, inertia and dipole, and clear words about wrong input."""

import mdtraj
import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.systems.fluids import rigid_sites
from starts import context_of, force_of, simulation_of


def inertia_tensor(sites, mass):
    m = mass / len(sites)
    return sum(m * ((b @ b) * np.eye(3) - np.outer(b, b)) for b in sites)


@pytest.mark.parametrize("planar", [False, True])
def test_sites_have_exactly_the_wanted_inertia(rng, planar):
    for _ in range(50):
        spread = rng.uniform(0.01, 1.0, 3)
        if planar:
            spread[rng.integers(3)] = 0.0
        inertia, mass = spread.sum() - spread, rng.uniform(0.1, 10.0)
        sites = rigid_sites(mass, inertia)
        assert len(sites) == (3 if planar else 4)
        np.testing.assert_allclose(sites.mean(axis=0), 0.0, atol=1e-15)
        np.testing.assert_allclose(inertia_tensor(sites, mass), np.diag(inertia), rtol=0.0, atol=3e-15 * inertia.max())


@pytest.fixture(params=[(1.0, 1.88, 2.88), (1.0, 1.5, 2.0)], ids=["planar", "tetrahedral"])
def droplet(request):
    return *rb.dipole_fluid(11, seed=4, inertia=request.param, trap=0.3), request.param


def test_virtual_sites_and_constraints_fit_the_positions(droplet):
    _, system, positions, _ = droplet
    context = context_of(system, openmm.VerletIntegrator(0.001), positions)
    context.computeVirtualSites()
    x = context.getState(positions=True).getPositions(asNumpy=True)._value
    np.testing.assert_allclose(x, positions._value, rtol=0.0, atol=2e-13)  # weights are 5e-14 off simple fractions
    for i in range(system.getNumConstraints()):
        p, q, d = system.getConstraintParameters(i)
        assert abs(np.linalg.norm(x[p] - x[q]) - d._value) < 1e-14


def test_openmm_counts_six_degrees_of_freedom_a_body(droplet):
    _, system, _, _ = droplet
    massive = sum(system.getParticleMass(i)._value > 0 for i in range(system.getNumParticles()))
    assert 3 * massive - system.getNumConstraints() == 6 * 11


def test_the_dipole_points_along_the_arrow_in_the_principal_axes(droplet):
    _, system, positions, inertia = droplet
    k = system.getNumParticles() // 11
    x = positions._value.reshape(11, k, 3)
    for body in x:
        sites, arrow = body[:-2] - body[-2], body[-1] - body[-2]
        tensor = inertia_tensor(sites, 1.0)
        moments, axes = np.linalg.eigh(tensor)
        np.testing.assert_allclose(moments, np.sort(inertia), rtol=1e-13)
        # (0, 1, 1) in the principal axes, up to the signs of the eigenvectors.
        np.testing.assert_allclose(np.abs(axes.T @ arrow) / 0.5, [0.0, 0.5**0.5, 0.5**0.5], rtol=0.0, atol=1e-12)


def test_the_lattice_has_the_wanted_constant():
    _, _, positions = rb.dipole_fluid(27, spacing=1.3, perturbation=0.0)
    centres = positions._value.reshape(27, 5, 3)[:, 3]
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=2) + 9 * np.eye(27)
    np.testing.assert_allclose(distances.min(axis=1), 1.3, rtol=1e-13)
    np.testing.assert_allclose(centres.mean(axis=0), 0.0, atol=1e-14)


def test_the_box_of_a_liquid_has_its_density():
    topology, system, _ = rb.dipole_fluid(50, boundary=rb.ReactionField(), density=0.4)
    edges = [vector.value_in_unit(unit.nanometer) for vector in system.getDefaultPeriodicBoxVectors()]
    assert np.linalg.det(edges) == pytest.approx(50 / 0.4)
    assert system.usesPeriodicBoundaryConditions()
    assert topology.getUnitCellDimensions()[0].value_in_unit(unit.nanometer) ** 3 == pytest.approx(50 / 0.4)


def test_the_seed_decides():
    one, again, other = (rb.dipole_fluid(8, seed=s)[2]._value for s in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.01


def test_openmms_minimiser_works(droplet):
    topology, system, positions, _ = droplet
    simulation = simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.01), positions)
    before = simulation.context.getState(energy=True).getPotentialEnergy()
    simulation.minimizeEnergy(tolerance=0.5)
    assert simulation.context.getState(energy=True).getPotentialEnergy() < before
    simulation.step(2)


def test_mdtraj_reads_the_pdb_with_its_arrows(droplet, tmp_path):
    topology, system, positions, _ = droplet
    with (tmp_path / "droplet.pdb").open("w") as file:
        app.PDBFile.writeFile(topology, positions, file)
    read = mdtraj.load(str(tmp_path / "droplet.pdb"))
    assert read.n_atoms == system.getNumParticles()
    assert read.topology.n_residues == 11
    assert sum({a.name, b.name} == {"C", "D"} for a, b in read.topology.bonds) == 11
    np.testing.assert_allclose(read.xyz[0], positions._value, atol=1e-4)


def test_quantities_are_taken_as_their_numbers():
    nm, kJ = unit.nanometer, unit.kilojoule_per_mole
    plain = rb.dipole_fluid(8, mass=2.0, sigma=1.1, epsilon=0.5, spacing=1.3, trap=0.4)
    units = {"mass": 2.0 * unit.dalton, "sigma": 11 * unit.angstrom, "epsilon": 0.5 * kJ, "spacing": 1.3 * nm}
    same = rb.dipole_fluid(8, **units, trap=0.4 * kJ / nm**2)
    np.testing.assert_allclose(same[2]._value, plain[2]._value, rtol=1e-14)
    assert openmm.XmlSerializer.serialize(same[1]) == openmm.XmlSerializer.serialize(plain[1])
    with pytest.raises(ValueError, match=r"sigma .* not 3 K"):
        rb.dipole_fluid(8, sigma=3 * unit.kelvin)


def test_tip4p_2005_has_the_charges_and_the_size_that_were_published():
    """Abascal and Vega 2005: a dipole of 2.305 D and a quadrupole of 2.297 D A, table II; epsilon/k = 93.2 K."""
    _, system, positions = rb.rigid_water(1, seed=3, model="tip4p2005")
    nonbonded = force_of(system)
    parameters = [nonbonded.getParticleParameters(i) for i in range(4)]
    charges = np.array([q._value for q, _, _ in parameters])
    x = positions._value
    middle = 0.5 * (x[1] + x[2])
    axis = (middle - x[0]) / np.linalg.norm(middle - x[0])
    assert np.linalg.norm(x[3] - x[0]) == pytest.approx(0.01546, abs=1e-8)
    assert (x[3] - x[0]) @ axis == pytest.approx(0.01546, abs=1e-8)
    debye = 0.0208194  # e nm
    assert np.linalg.norm(charges @ x) / debye == pytest.approx(2.305, abs=5e-4)
    half = 0.5 * np.linalg.norm(x[1] - x[2])
    quadrupole = 1.5 * charges[1] * half**2  # (Qxx - Qyy)/2 with Qij = 3/2 sum q xi xj: two protons
    assert quadrupole / (0.1 * debye) == pytest.approx(2.297, abs=5e-4)
    _, sigma, epsilon = parameters[0]
    assert sigma._value == 0.31589
    assert epsilon / unit.MOLAR_GAS_CONSTANT_R / unit.kelvin == pytest.approx(93.2, abs=1e-3)
    assert [e._value for _, _, e in parameters[1:]] == [0.0] * 3
    assert system.getNumConstraints() == 3


def test_moments_may_be_quantities_one_by_one():
    nm, angstrom = unit.dalton * unit.nanometer**2, unit.dalton * unit.angstrom**2
    moments = np.array([1.0, 1.88, 2.88])
    expected = rigid_sites(2.0, moments)
    for inertia in (moments * nm, list(moments) * nm, 100.0 * moments * angstrom, [1.0 * nm, 188.0 * angstrom, 2.88]):
        np.testing.assert_allclose(rigid_sites(2.0 * unit.dalton, inertia), expected, rtol=1e-14)
        _, system, _ = rb.dipole_fluid(1, mass=2.0, inertia=inertia)
        distance = system.getConstraintParameters(0)[2]._value
        assert distance == pytest.approx(np.linalg.norm(expected[0] - expected[1]), rel=1e-14)


@pytest.mark.parametrize(
    "inertia",
    [
        [1.0 * unit.kelvin] * 3,
        [1.0, 1.0, 1.5] * unit.nanometer,
        "abc",
        [1.0, 2.0, "x"],
        np.array([1.0 + 1.0j, 1.0, 1.5]),
        [[1.0, 2.0], [1.0]],
        [None, 1.0, 1.0],
    ],
)
def test_moments_of_something_else_get_one_sentence(inertia):
    for call in (lambda: rigid_sites(1.0, inertia), lambda: rb.dipole_fluid(1, inertia=inertia)):
        with pytest.raises(ValueError, match=r"^inertia must be three positive moments") as caught:
            call()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
def test_the_thinnest_bodies_have_the_wanted_moments(part):
    inertia = np.array([1.0, 2e-6, 1.0 + part * 2e-6])
    np.testing.assert_allclose(np.diag(inertia_tensor(rigid_sites(1.0, inertia), 1.0)), inertia, rtol=1e-9)


@pytest.mark.parametrize("options", [{"rigidWater": False}, {"rigidWater": False, "constraints": app.HBonds}])
def test_tip4p_2005_does_not_bend(options):
    with pytest.raises(ValueError, match=r"^tip4p2005 has no force constants"):
        rb.rigid_water(2, model="tip4p2005", **options)
    assert rb.rigid_water(2, model="tip4pew", **options)[1].getNumConstraints() < 6
    assert rb.rigid_water(2, model="tip4p2005", rigidWater=True)[1].getNumConstraints() == 6


def nearest(x, edge):
    """Return the smallest distance between places in a periodic cube."""
    apart = x[:, None] - x[None]
    apart -= edge * np.round(apart / edge)
    return np.sqrt((apart**2).sum(axis=2))[np.triu_indices(len(x), 1)].min()


@pytest.mark.parametrize("n", [2, 3, 4, 5, 7, 8, 12, 26, 27, 28, 63, 65, 90, 99, 100, 101, 128, 217, 250, 251, 500])
def test_water_fills_a_periodic_box_at_its_density_for_every_number(n):
    """No molecules are nearer to each other than two of ice, but for two to five in a box."""
    _, system, positions = rb.rigid_water(n, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.19)
    edge = system.getDefaultPeriodicBoxVectors()[0][0]._value
    assert n * 18.01528 / 0.602214076 / edge**3 == pytest.approx(1000.0, rel=1e-3)
    assert nearest(positions._value[::3], edge) > (0.276 if n > 5 else 0.258)


def test_as_many_molecules_as_a_cube_has_are_where_they_were():
    """On the cubic lattice, with and without a box."""
    _, _, droplet = rb.rigid_water(27)
    _, system, box = rb.rigid_water(27, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.4)
    assert (box._value == droplet._value).all()
    assert system.getDefaultPeriodicBoxVectors()[0][0]._value == pytest.approx(3 * 0.3104, abs=1e-15)


def test_a_box_that_is_no_cube_of_molecules_is_easy_to_minimise():
    """No molecules overlap at the start, and a few iterations bind them, in kJ/mol per molecule; the liquid has -47."""
    options = {"nonbondedMethod": app.CutoffPeriodic, "nonbondedCutoff": 0.6}
    _, system, positions = rb.rigid_water(70, model="spce", **options)
    platform = openmm.Platform.getPlatform("CPU")
    context = context_of(
        system, openmm.VerletIntegrator(0.001), positions, platform=platform, properties={"Threads": "1"}
    )
    energies = []
    for iterations in (1, 100):
        openmm.LocalEnergyMinimizer.minimize(context, 10.0, iterations)
        energies.append(context.getState(energy=True).getPotentialEnergy()._value / 70)
    assert energies[0] < 10.0
    assert energies[1] < -30.0
