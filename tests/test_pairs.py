"""The compiled pair kernel against OpenMM's formula, and what comes with it: caching, threads, periodic boundaries."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
from ewald import dipole_ewald
from openmm_exactrb import kernels, pairs_compiled
from openmm_exactrb.potentials import SoftDipoles, _truncation

REFERENCE = openmm.Platform.getPlatform("Reference")
OPEN = {}
PERIODIC = {"periodic": True, "density": 0.5}
FIELD = {"periodic": True, "density": 0.5, "cutoff": 1.8, "switch": 1.0, "dielectric": 7.0}


def context_of(n, kernel, scheme="SRKN4_6b", **options):
    _, system, positions = rb.dipole_fluid(n, seed=5, perturbation=0.08, kernel=kernel, **options)
    integrator = rb.ExactRigidBodyIntegrator(0.005, scheme=scheme)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    return context, integrator


def energy_and_forces(context):
    state = context.getState(energy=True, forces=True)
    return state.getPotentialEnergy()._value, state.getForces(asNumpy=True)._value


def total_energy(context):
    state = context.getState(energy=True)
    return state.getPotentialEnergy()._value + state.getKineticEnergy()._value


def assert_same(one, other, tolerance=1e-13):
    """Compare energies and forces; an energy relative to what its pairs add up to."""
    (energy, forces), (energy2, forces2) = one, other
    assert abs(energy - energy2) <= tolerance * max(abs(energy), np.abs(forces).sum() / 12.0)
    np.testing.assert_allclose(forces2, forces, rtol=0.0, atol=tolerance * np.abs(forces).max())


def arrows(n, rng, edge=1.1):
    """Return centres and tips (2 n, 3) on a lattice, and the edge of its box."""
    side = next(k for k in range(1, n + 1) if k**3 >= n)
    centres = edge * np.argwhere(np.ones((side, side, side)))[:n] + 0.05 * rng.standard_normal((n, 3))
    tips = centres + 0.5 * rng.standard_normal((n, 3))
    return np.stack([centres, tips], axis=1).reshape(-1, 3), side * edge


def truncation_of(box):
    cutoff, switch = 0.4 * box, 0.25 * box
    return box, box, box, cutoff**2, 1.0 / (cutoff**2 - switch**2), 1.0 / cutoff**3


# -- the same energies and forces -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "options"), [(1, OPEN), (2, OPEN), *((n, o) for n in (27, 100) for o in (OPEN, PERIODIC, FIELD))]
)
def test_both_kernels_agree(n, options):
    assert_same(*(energy_and_forces(context_of(n, kernel, **options)[0]) for kernel in ("openmm", "compiled")))


def test_both_kernels_agree_for_a_body_of_its_own():
    own = {"inertia": (1.0, 1.5, 2.0), "dipole": (0.3, -0.8, 0.5), "mass": 3.0, "sigma": 0.9, "epsilon": 1.7}
    assert_same(*(energy_and_forces(context_of(30, kernel, **own)[0]) for kernel in ("openmm", "compiled")))


@pytest.mark.parametrize("wca", [False, True])
@pytest.mark.parametrize("options", [OPEN, FIELD], ids=["open", "periodic"])
def test_both_kernels_agree_for_the_stockmayer_fluid(options, wca):
    own = options | {"attraction": 0.8, "wca": wca, "sigma": 1.2 if wca else 0.9, "epsilon": 1.7}
    assert_same(*(energy_and_forces(context_of(30, kernel, **own)[0]) for kernel in ("openmm", "compiled")))


def test_two_stockmayer_spheres_have_the_energy_of_their_definition():
    """Side by side and parallel: 4 epsilon ((sigma/r)^12 - (sigma/r)^6) + mu²/r³."""
    r, mu = 1.3, 1.7
    energies = []
    for attraction in (0.0, 1.0):
        force = rb.soft_dipole_force([(0, 1), (2, 3)], strength=mu, length=0.5, sigma=1.1, attraction=attraction)
        system = openmm.System()
        for _ in range(4):
            system.addParticle(1.0)
        system.addForce(force)
        context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
        context.setPositions([[0, 0, 0], [0, 0, 0.5], [r, 0, 0], [r, 0, 0.5]])
        energies.append(energy_and_forces(context)[0])
    core, pull = 4.0 * (1.1 / r) ** 12, 4.0 * (1.1 / r) ** 6
    assert energies == pytest.approx([core + mu**2 / r**3, core - pull + mu**2 / r**3], rel=1e-13)


@pytest.mark.parametrize("kernel", ["openmm", "compiled"])
def test_spheres_of_weeks_chandler_and_andersen_only_repel(kernel):
    """Lennard-Jones up to its minimum at 2^(1/6) sigma, raised by epsilon."""
    sigma, epsilon = 1.1, 1.7
    own = {"strength": 1e-6, "length": 0.5, "sigma": sigma, "epsilon": epsilon, "attraction": 1.0, "wca": True}
    force = rb.soft_dipole_force([(0, 1), (2, 3)], kernel=kernel, **own)
    system = openmm.System()
    for _ in range(4):
        system.addParticle(1.0)
    system.addForce(force)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    for r, inside in ((0.9, True), (1.2, True), (1.234, True), (1.236, False), (3.0, False)):
        context.setPositions([[0, 0, 0], [0, 0, 0.5], [r, 0, 0], [r, 0, 0.5]])
        exact = (4.0 * epsilon * ((sigma / r) ** 12 - (sigma / r) ** 6) + epsilon) * inside
        energy, forces = energy_and_forces(context)
        assert energy == pytest.approx(exact, rel=1e-10, abs=1e-11)
        assert forces[2, 0] == pytest.approx(
            24.0 * epsilon * (2.0 * (sigma / r) ** 12 - (sigma / r) ** 6) / r * inside, abs=1e-10
        )


@pytest.mark.parametrize(("wca", "attraction"), [(False, 2.7), (True, 2.7), (False, 0.0), (True, 0.0), (True, -1.0)])
def test_both_kernels_follow_the_parameters_of_the_context(wca, attraction):
    results = []
    for kernel in ("openmm", "compiled"):
        context, _ = context_of(9, kernel, attraction=0.5, wca=wca)
        context.setParameter("soft_attraction", attraction)
        context.setParameter("soft_repulsion", 1.3)
        context.setParameter("dipole_coupling", 2.1)
        results.append(energy_and_forces(context))
    assert_same(*results)


def test_spheres_without_a_repulsion_have_no_minimum():
    context, _ = context_of(9, "compiled", attraction=1.0, wca=True)
    context.setParameter("soft_repulsion", 0.0)
    with pytest.raises(Exception, match="need a positive soft_repulsion"):
        context.getState(energy=True)


def test_the_trajectory_is_the_same_to_roundoff_growth():
    ends = []
    for kernel in ("openmm", "compiled"):
        context, integrator = context_of(27, kernel, trap=0.5)
        integrator.setVelocitiesToTemperature(12.0, 1)
        integrator.step(20)
        ends.append(context.getState(positions=True).getPositions(asNumpy=True)._value)
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-11)


# -- the kernel alone -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("attraction", [None, 3.0])
@pytest.mark.parametrize("periodic", [False, True])
def test_forces_are_finite_differences_of_the_energy(rng, periodic, attraction):
    x, box = arrows(27, rng)
    truncation = truncation_of(box) if periodic else None
    _, forces = pairs_compiled.soft_dipoles(x, 4.0, 2.0, truncation, attraction=attraction)
    d = 1e-3
    for particle, axis in ((0, 0), (1, 1), (26, 2), (27, 0), (53, 1)):

        def energy(s, particle=particle, axis=axis):
            y = x.copy()
            y[particle, axis] += s
            return pairs_compiled.soft_dipoles(y, 4.0, 2.0, truncation, attraction=attraction)[0]

        slope = (8 * (energy(d) - energy(-d)) - (energy(2 * d) - energy(-2 * d))) / (12 * d)
        assert abs(slope + forces[particle, axis]) < 1e-7 * max(1.0, np.abs(forces).max())


@pytest.mark.parametrize("periodic", [False, True])
def test_total_force_is_zero_and_without_a_box_total_torque(rng, periodic):
    x, box = arrows(64, rng)
    _, forces = pairs_compiled.soft_dipoles(x, 4.0, 2.0, truncation_of(box) if periodic else None)
    assert np.abs(forces.sum(axis=0)).max() < 1e-14 * np.abs(forces).sum()
    if not periodic:
        assert np.abs(np.cross(x, forces).sum(axis=0)).max() < 1e-13 * np.abs(forces).sum()


@pytest.mark.parametrize("periodic", [False, True])
def test_dipoles_may_change_places_and_images(rng, periodic):
    x, box = arrows(64, rng)
    truncation = truncation_of(box) if periodic else None
    energy, forces = pairs_compiled.soft_dipoles(x, 4.0, 2.0, truncation)
    order = rng.permutation(64)
    y = x.reshape(64, 2, 3)[order]
    if periodic:
        y = y + box * rng.integers(-2, 3, (64, 1, 3))
    permuted = pairs_compiled.soft_dipoles(y.reshape(-1, 3), 4.0, 2.0, truncation)
    assert_same((energy, forces.reshape(64, 2, 3)[order].reshape(-1, 3)), permuted, 1e-12)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("n", [61, 500])
def test_any_number_of_threads_gives_the_same_bits(rng, n, periodic):
    x, box = arrows(n, rng)
    truncation = truncation_of(box) if periodic else None
    energy, forces = pairs_compiled.soft_dipoles(x, 4.0, 2.0, truncation, threads=1)
    for threads in (None, 1, 2, 3, 7):
        again = pairs_compiled.soft_dipoles(x, 4.0, 2.0, truncation, threads=threads)
        assert again[0] == energy
        np.testing.assert_array_equal(again[1], forces)


def test_dipoles_in_one_place_and_positions_that_are_no_numbers_give_no_numbers(rng):
    x, box = arrows(27, rng)
    for particle, place in ((2, x[0]), (4, [np.nan, 0.0, 0.0])):
        bad = x.copy()
        bad[particle] = place
        for truncation in (None, truncation_of(box)):
            energy, forces = pairs_compiled.soft_dipoles(bad, 4.0, 2.0, truncation)
            assert not np.isfinite(energy)
            assert not np.isfinite(forces[particle]).all()


# -- periodic liquids -------------------------------------------------------------------------------------------


def test_forces_are_smooth_where_the_switch_begins_and_ends():
    """The second derivative of the force between two dipoles has no step at either end."""
    box, truncation = 10.0, truncation_of(10.0)
    u, v = np.array([0.1, 0.4, 0.2]), np.array([0.5, -0.3, 0.1])

    def pull(r):
        x = np.array([[0.0, 0.0, 0.0], u, [r, 0.0, 0.0], v + np.array([r, 0.0, 0.0])])
        return pairs_compiled.soft_dipoles(x, 4.0, 2.0, truncation)[1][2]

    d = 1e-3
    for end in (0.25 * box, 0.4 * box):
        before, after = (
            (pull(end + s + d) - 2 * pull(end + s) + pull(end + s - d)) / d**2 for s in (-1.5 * d, 1.5 * d)
        )
        assert np.abs(before - after).max() < 0.02
    assert np.abs(pull(0.4 * box + d)).max() == 0.0


def test_the_compiled_kernel_follows_the_box_of_the_context():
    results = []
    for kernel in ("openmm", "compiled"):
        context, _ = context_of(27, kernel, **(FIELD | {"cutoff": 1.7}))
        edges = np.array([3.6, 3.7, 3.9])
        context.setPeriodicBoxVectors(*np.diag(edges))
        if kernel == "openmm":
            for axis, edge in zip("xyz", edges, strict=True):
                context.setParameter(f"box_{axis}", edge)
        results.append(energy_and_forces(context))
    assert_same(*results)


def test_boxes_that_do_not_fit_are_refused():
    context, _ = context_of(27, "compiled", **FIELD)
    context.setPeriodicBoxVectors(*np.diag([3.5, 3.6, 3.9]))
    with pytest.raises(Exception, match="cutoff must be positive and at most half the box"):
        context.getState(energy=True)
    context.setPeriodicBoxVectors([4.0, 0.0, 0.0], [0.5, 4.0, 0.0], [0.0, 0.0, 4.0])
    with pytest.raises(Exception, match="rectangular"):
        context.getState(energy=True)


@pytest.mark.parametrize(("scheme", "order"), [("SRKN4_6b", 4), ("S6_10", 6)])
@pytest.mark.parametrize(
    "options",
    [{"kernel": "openmm"}, {"kernel": "compiled"}, {"kernel": "auto", "long_range": "ewald", "ewald_tolerance": 1e-2}],
    ids=["openmm", "compiled", "ewald"],
)
def test_a_liquid_keeps_its_energy_to_the_order_of_the_scheme(options, scheme, order):
    context, integrator = context_of(27, periodic=True, dipole=(0.0, 0.0, 1.0), scheme=scheme, **options)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0)
    integrator.setVelocitiesToTemperature(60.0, 3)
    start = context.getState(positions=True, velocities=True)
    swings = []
    for h in (0.004, 0.002):
        context.setPositions(start.getPositions())
        context.setVelocities(start.getVelocities())
        integrator.setStepSize(h)
        energies = [total_energy(context)]
        for _ in range(10):
            integrator.step(round(0.008 / h))
            energies.append(total_energy(context))
        swings.append(np.ptp(energies))
    assert np.log2(swings[0] / swings[1]) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"periodic": True, "density": -1.0}, "density must be positive"),
        ({"periodic": True, "cutoff": 10.0}, "at most half the box"),
        ({"periodic": True, "cutoff": 0.0}, "cutoff must be positive"),
        ({"periodic": True, "cutoff": 1.0, "switch": 1.0}, "switch must be between"),
        ({"periodic": True, "dielectric": 0.5}, "dielectric must be at least 1"),
        ({"periodic": True, "trap": 0.5}, "needs none"),
        ({"attraction": np.nan}, "attraction must be a finite number"),
        ({"wca": True}, "without an attraction there is no minimum"),
        ({"density": 0.8}, "add periodic=True"),
        ({"cutoff": 1.0}, "add periodic=True"),
        ({"kernel": "fortran"}, "unknown kernel"),
    ],
)
def test_wrong_options_get_one_sentence(options, message):
    with pytest.raises(ValueError, match=message):
        rb.dipole_fluid(**({"n": 27} | options))


def test_no_arrows_and_wrong_boxes_are_refused():
    with pytest.raises(ValueError, match="at least one arrow"):
        rb.soft_dipole_force([], strength=1.0, length=0.5)
    with pytest.raises(ValueError, match="three positive edges"):
        rb.soft_dipole_force([(0, 1)], strength=1.0, length=0.5, box=(1.0, 1.0))


def test_the_box_of_a_liquid_has_its_density():
    topology, system, _ = rb.dipole_fluid(50, periodic=True, density=0.4)
    volume = np.linalg.det([vector._value for vector in system.getDefaultPeriodicBoxVectors()])
    assert volume == pytest.approx(50 / 0.4)
    assert system.usesPeriodicBoundaryConditions()
    assert topology.getUnitCellDimensions()._value[0] ** 3 == pytest.approx(volume)


def liquid(n, seed=3):
    """Return centres, dipoles and box of soft dipolar spheres at rho* = 0.8, mu*² = 4, T* = 1.35, just molten."""
    options = {"dipole": (0.0, 0.0, 2.0), "inertia": (0.3, 0.3, 0.3)}
    _, system, positions = rb.dipole_fluid(n, seed, periodic=True, kernel="compiled", **options)
    integrator = rb.ExactRigidBodyIntegrator(0.005, scheme="S2_2")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    for k in range(4):
        integrator.setVelocitiesToTemperature(1.35 * unit.kilojoule_per_mole / unit.MOLAR_GAS_CONSTANT_R, k)
        integrator.step(60)
    x = context.getState(positions=True).getPositions(asNumpy=True)._value.reshape(n, -1, 3)[:, -2:]
    return x[:, 0], 4.0 * (x[:, 1] - x[:, 0]), (n / 0.8) ** (1.0 / 3.0)


def amoeba_energy(R, mu, box):
    """Return the energy of the same dipoles from the particle mesh Ewald sum of OpenMM's AMOEBA."""
    force, system = openmm.AmoebaMultipoleForce(), openmm.System()
    force.setNonbondedMethod(force.PME)
    force.setPolarizationType(force.Direct)
    force.setCutoffDistance(0.499 * box)
    force.setAEwald(8.0 / box)
    force.setPmeGridDimensions([64, 64, 64])
    strength = float(np.linalg.norm(mu[0])) / rb.dipole_strength(1.0 * unit.elementary_charge * unit.nanometer)
    for i in range(len(R)):
        system.addParticle(1.0)
        system.addParticle(1.0)
        force.addMultipole(0.0, [0, 0, strength], [0] * 9, force.ZOnly, 2 * i + 1, -1, -1, 0.39, 0.0, 0.0)
        force.addMultipole(0.0, [0, 0, 0], [0] * 9, force.NoAxisType, -1, -1, -1, 0.39, 0.0, 0.0)
    system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*(box * np.eye(3)))
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    context.setPositions(np.stack([R, R + 0.1 * mu], axis=1).reshape(-1, 3))
    return context.getState(energy=True).getPotentialEnergy()._value


def test_the_ewald_sum_is_right():
    """It does not depend on its splitting, has minus the gradient as its field, and agrees with OpenMM's AMOEBA."""
    R, mu, box = liquid(27)
    energy, field = dipole_ewald(R, mu, box, 13.0 / box)
    assert dipole_ewald(R, mu, box, 15.0 / box)[0] == pytest.approx(energy, rel=1e-11)
    step = np.zeros_like(mu)
    step[3] = 0.01, 0.02, -0.03
    rise = dipole_ewald(R, mu + step, box, 13.0 / box)[0] - dipole_ewald(R, mu - step, box, 13.0 / box)[0]
    assert rise == pytest.approx(-2.0 * np.sum(field * step), rel=1e-9)
    assert amoeba_energy(R, mu, box) == pytest.approx(energy, rel=1e-5)


def reaction_field(box, **options):
    """Return the truncation at half the box as the kernel takes it."""
    cutoff, switch, reaction = _truncation((box, box, box), 0.5 * box, **options)
    return box, box, box, cutoff**2, 1.0 / (cutoff**2 - switch**2), reaction


@pytest.mark.parametrize("switch", [0.0, 1.3, 2.4])
def test_a_uniform_polarisation_has_the_reaction_field_that_was_asked_for(switch):
    """The field of unit dipoles that fill the switched sphere, 4 pi/3 between conductors, on the one in its middle."""
    box, dielectric = 5.0, 4.0
    truncation = reaction_field(box, switch=switch, dielectric=dielectric)

    def reaction(r):
        """Return the field of a dipole on one like it, mean over the angles between field and direction."""
        fields = []
        for axis in np.eye(3):
            x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], r * axis, r * axis + [0.0, 0.0, 1.0]])
            fields.append(pairs_compiled.soft_dipoles(x, 0.0, 1.0, truncation)[1][1, 2])
        return np.mean(fields)

    x, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for low, high in ((1e-6, max(switch, 1e-6)), (max(switch, 1e-6), 0.5 * box)):
        r = 0.5 * (low + high + (high - low) * x)
        total += 0.5 * (high - low) * np.sum(weights * 4.0 * np.pi * r**2 * [reaction(a) for a in r])
    wanted = 4.0 * np.pi / 3.0 * 2.0 * (dielectric - 1.0) / (2.0 * dielectric + 1.0)
    assert total == pytest.approx(wanted, rel=1e-6)


def test_a_reaction_field_comes_close_to_the_ewald_sum_in_a_large_box():
    """Largest root mean square errors of the field on a dipole: 0.12 for 125, 0.05 for 512; more without it."""
    for n, most in ((125, 0.12), (512, 0.05)):
        R, mu, box = liquid(n)
        _, exact = dipole_ewald(R, mu, box, 9.0 / box)
        x = np.stack([R, R + mu], axis=1).reshape(-1, 3)
        errors = []
        for dielectric in (np.inf, 1.0):
            truncation = reaction_field(box, switch=0.375 * box, dielectric=dielectric)
            field = pairs_compiled.soft_dipoles(x, 0.0, 1.0, truncation)[1][1::2]
            errors.append(np.linalg.norm(field - exact) / np.linalg.norm(exact))
        assert errors[0] < most
        assert errors[0] < 0.75 * errors[1]


# -- who computes it --------------------------------------------------------------------------------------------


def potential(system):
    return system.getForce(0)


def test_auto_takes_the_compiled_kernel_where_numba_is_installed(monkeypatch):
    assert isinstance(potential(rb.dipole_fluid(2)[1]), openmm.PythonForce)
    monkeypatch.setitem(sys.modules, "numba", None)
    assert isinstance(potential(rb.dipole_fluid(2)[1]), openmm.CustomCompoundBondForce)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "openmm-exactrb\[fast\]"'):
        rb.dipole_fluid(2, kernel="compiled")


def test_a_system_read_without_numba_says_what_is_missing(monkeypatch):
    context, _ = context_of(2, "compiled")
    monkeypatch.setitem(sys.modules, "numba", None)
    kernels.load.cache_clear()
    with pytest.raises(Exception, match=r'pip install "openmm-exactrb\[fast\]"'):
        context.getState(energy=True)


@pytest.mark.parametrize("options", [OPEN, FIELD], ids=["open", "periodic"])
def test_the_force_survives_xml_copy_and_pickle(options):
    context, _ = context_of(27, "compiled", **options)
    x = context.getState(positions=True).getPositions()
    system = context.getSystem()
    for again in (
        openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(system)),
        copy.deepcopy(system),
        pickle.loads(pickle.dumps(system)),
    ):
        other = openmm.Context(again, openmm.VerletIntegrator(0.001), REFERENCE)
        other.setPositions(x)
        assert_same(energy_and_forces(context), energy_and_forces(other), 1e-16)
    assert pickle.loads(pickle.dumps(SoftDipoles((1.0, 0.5, 0.0)))).truncation == (1.0, 0.5, 0.0)


SCRIPT = """
import sys
import openmm_exactrb as rb, openmm
_, system, positions = rb.dipole_fluid(8, kernel="compiled")
assert "numba" not in sys.modules, "imported too early"
context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
context.setPositions(positions)
print(context.getState(energy=True).getPotentialEnergy()._value)
from openmm_exactrb import pairs_compiled
print(sum(sum(f.stats.cache_misses.values()) for f in (pairs_compiled._split, pairs_compiled._rows)))
"""


def test_the_first_process_says_what_it_waits_for_and_the_second_does_not_compile(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    first, second = (
        subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True) for _ in range(2)
    )
    assert first.stderr.count("compiling kernels") == 1
    assert second.stderr == ""
    energy, misses = first.stdout.split()
    assert int(misses) > 0
    assert second.stdout.split() == [energy, "0"]
