"""The program of the device on CUDA, HIP or OpenCL; on OpenCL of the processor (PoCL) where there is no GPU."""

import copy

import numpy as np
import openmm
import pytest
from devices import REFERENCE, all_kinds, context_of, gpu_platform, pair, seeded, shown, stepped
from openmm import app, unit

import openmm_exactrb as rb
from peptides import PEPTIDE, in_water, violations

pytestmark = pytest.mark.opencl


@pytest.fixture(scope="module")
def platform():
    return gpu_platform()


def boxed(n, method=app.CutoffPeriodic, **options):
    _, system, positions = rb.rigid_water(n, nonbondedMethod=method, nonbondedCutoff=0.4, **options)
    return system, positions


def test_all_kinds_of_bodies_in_double_precision(platform):
    system, positions, bodies = all_kinds()
    host, device = pair(system, positions, bodies=bodies, platform=platform, precision="double", scheme="S2_2")
    assert device.getIntegrator().getEngine() == "device"
    np.testing.assert_allclose(stepped(device, 20)[0], stepped(host, 20)[0], rtol=0.0, atol=1e-9)


@pytest.mark.validate  # those with a cutoff, below, move by the same program
def test_dipoles_in_double_precision(platform):
    _, system, positions = rb.dipole_fluid(8, kernel="openmm")
    both = pair(system, positions, platform=platform, precision="double", scheme="S2_2", h=0.005, kelvin=100.0)
    one, other = (stepped(context, 20) for context in both)
    np.testing.assert_allclose(other[0], one[0], rtol=0.0, atol=1e-9)
    energies = [context.getState(energy=True).getPotentialEnergy()._value for context in both]
    assert abs(energies[1] - energies[0]) < 1e-5


def boxed_dipoles(kernel="openmm"):
    """Return the System and positions of dipoles with a reaction field, in a box wide enough for any kernel."""
    options = {"boundary": rb.ReactionField(cutoff=1.5), "density": 0.4, "attraction": 1.0, "dipole": (0.0, 0.0, 1.0)}
    return rb.dipole_fluid(64, seed=3, kernel=kernel, **options)[1:]


def test_dipoles_with_a_cutoff_have_the_forces_of_the_compiled_kernel(platform):
    states = []
    for kernel, where, properties in (("openmm", platform, {"Precision": "double"}), ("compiled", REFERENCE, {})):
        system, positions = boxed_dipoles(kernel)
        context = openmm.Context(system, openmm.VerletIntegrator(0.001), where, properties)
        context.setPositions(positions)
        states.append(context.getState(energy=True, forces=True))
    energies = [state.getPotentialEnergy()._value for state in states]
    one, other = (state.getForces(asNumpy=True)._value for state in states)
    assert energies[0] == pytest.approx(energies[1], rel=1e-13)
    assert np.abs(one - other).max() < 20 * 2.0**-32  # a few times the unit in which OpenMM adds forces up


def test_dipoles_with_a_cutoff_in_double_precision(platform):
    both = pair(*boxed_dipoles(), platform=platform, precision="double", scheme="S2_2", h=0.005, kelvin=100.0)
    one, other = (stepped(context, 20) for context in both)
    np.testing.assert_allclose(other[0], one[0], rtol=0.0, atol=1e-9)


def test_dipoles_with_all_their_images_in_double_precision(platform):
    _, system, positions = rb.dipole_fluid(27, kernel="openmm", boundary=rb.Ewald(tolerance=1e-3), density=0.3)
    both = pair(system, positions, platform=platform, precision="double", scheme="S2_2", h=0.005, kelvin=100.0)
    one, other = (stepped(context, 10) for context in both)
    np.testing.assert_allclose(other[0], one[0], rtol=0.0, atol=1e-9)


def test_virtual_sites_of_steps_with_a_processor_and_displaced_forces(platform):
    """The structures of rows are compared on Reference, without virtual sites, which it does not have there."""
    _, system, positions = rb.rigid_water(4, model="tip4pew")
    both = pair(system, positions, platform=platform, precision="double", scheme="W4_4")
    one, other = (stepped(context, 5) for context in both)
    np.testing.assert_allclose(other[0], one[0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(other[1], one[1], rtol=0.0, atol=1e-7)


def triclinic(system):
    """Lean the box of a System over."""
    a, b, c = (np.array(vector._value) for vector in system.getDefaultPeriodicBoxVectors())
    system.setDefaultPeriodicBoxVectors(a, b + 0.3 * a, c - 0.2 * a + 0.1 * b)


def test_molecules_that_openmm_wraps_and_reorders(platform):
    system, positions = boxed(27)
    triclinic(system)
    context = context_of(system, positions, "device", platform=platform, precision="double", scheme="V2", h=0.002)
    integrator = context.getIntegrator()
    integrator.minimizeEnergy(maxIterations=30)  # OpenMM's own crashes on PoCL
    context.setVelocities(shown(context)[1] + [4.0, 3.0, 2.0])  # all molecules leave the box
    before = integrator.totalEnergy()._value
    x = shown(context)[0]
    for _ in range(6):
        x0, (x, _) = x, stepped(context, 50)
        assert np.abs(x - x0).max() < 0.1 * 10.0  # no molecule jumps
        across = np.linalg.norm(x[1::3] - x[::3], axis=1)
        np.testing.assert_allclose(across, 0.09572, rtol=0.0, atol=1e-10)
    images = np.array(integrator.getPerDofVariableByName("image"), dtype=float)
    assert np.abs(images).max() > 0.5
    for name in ("R", "P", "L", "q", "w"):
        values = np.array(integrator.getPerDofVariableByName(name), dtype=float).reshape(-1, 3, 3)
        np.testing.assert_array_equal(values, np.repeat(values[:, :1], 3, axis=1))
    np.testing.assert_allclose(images.reshape(-1, 3, 3), np.repeat(images[::3, None], 3, axis=1), rtol=0.0, atol=1e-14)
    kinetic = sum(energy._value for energy in integrator.kineticEnergies())
    assert abs(integrator.totalEnergy()._value - before) < 0.01 * kinetic


def test_the_floor_of_the_energy_error_in_mixed_precision_is_that_of_the_host(platform):
    _, system, positions = rb.rigid_water(27)
    floors = []
    for engine in ("host", "device"):
        context = context_of(system, positions, engine, platform=platform, precision="mixed", scheme="S4_6", h=0.0005)
        integrator, energies = context.getIntegrator(), []
        for _ in range(200):
            integrator.step(1)
            energies.append(integrator.totalEnergy()._value)
        floors.append(np.std(np.diff(energies)))
    assert floors[1] <= 1.1 * floors[0], floors


def test_a_barostat_moves_whole_bodies(platform):
    system, positions = boxed(27)
    system.addForce(seeded(openmm.MonteCarloBarostat(5000.0, 300.0, 2)))
    context = context_of(system, positions, "device", platform=platform, precision="mixed", scheme="V2")
    edges = []
    for _ in range(20):
        x, _ = stepped(context, 1)
        edges.append(context.getState().getPeriodicBoxVectors()[0][0] / unit.nanometer)
        np.testing.assert_allclose(np.linalg.norm(x[1::3] - x[::3], axis=1), 0.09572, rtol=0.0, atol=1e-7)
    assert len(set(edges)) > 2


def test_a_peptide_in_water_in_mixed_precision(platform):
    """Water stays rigid; OpenMM's constraints have lengths in single precision."""
    _, system, x = in_water()
    options = {"platform": platform, "precision": "mixed", "kelvin": 0.0, "scheme": "S2_3", "h": 0.003}
    ends = []
    for engine in ("host", "device"):
        context = context_of(system, x, engine, fast="bonded", **options)
        ends.append(stepped(context, 20))
    assert context.getIntegrator().timings.fast_evaluations > 0
    assert np.abs(ends[0][0] - x).max() > 1e-3
    np.testing.assert_allclose(ends[1][0], ends[0][0], rtol=0.0, atol=1e-4)
    water = ends[1][0][22:].reshape(-1, 3, 3)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.ptp(np.linalg.norm(water[:, i] - water[:, j], axis=1)) <= 1e-13
    length, slip = violations(system, *ends[1])
    assert length <= 5e-8 * 0.1
    assert slip <= 1e-6


@pytest.fixture(scope="module")
def peptide_in_tip4p():
    """Return a System and positions near a minimum of its energy."""
    modeller = app.Modeller(app.PDBFile(str(PEPTIDE)).topology, app.PDBFile(str(PEPTIDE)).positions)
    field = app.ForceField("amber14-all.xml", "amber14/tip4pew.xml")
    modeller.addSolvent(field, model="tip4pew", boxSize=openmm.Vec3(1.9, 1.9, 1.9) * unit.nanometer)
    options = {"nonbondedMethod": app.CutoffPeriodic, "nonbondedCutoff": 0.8, "removeCMMotion": False}
    system = field.createSystem(modeller.topology, constraints=app.HBonds, **options)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    context.setPositions(modeller.positions)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 30)
    context.applyConstraints(1e-9)
    return system, shown(context)[0]


@pytest.mark.parametrize("scheme", ["BAOA", "W2_3m"])
def test_virtual_sites_move_with_water_where_the_peptide_drifts_later(platform, peptide_in_tip4p, scheme):
    """In a step whose last drift is that of rigid bodies alone; sites as OpenMM's Reference platform places them."""
    system, x = peptide_in_tip4p
    reference = openmm.Context(copy.deepcopy(system), openmm.VerletIntegrator(0.001), REFERENCE)
    thermostat = rb.thermostats.Langevin(300.0, 0.0)
    ends = []
    for engine in ("host", "device"):
        options = {"h": 0.002, "kelvin": 0.0, "scheme": scheme, "fast": "bonded", "thermostat": thermostat}
        context = context_of(system, x, engine, platform=platform, precision="double", **options)
        ends.append(stepped(context, 3)[0])
        reference.setPositions(ends[-1])
        reference.computeVirtualSites()
        np.testing.assert_allclose(ends[-1], shown(reference)[0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-4)


def test_virtual_sites_beside_a_peptide(platform, peptide_in_tip4p):
    """With a barostat, whose moves leave water rigid and bonds to hydrogen long as they are."""
    system, x = peptide_in_tip4p
    ends = []
    for engine in ("host", "device"):
        context = context_of(
            system, x, engine, platform=platform, precision="double", kelvin=0.0, scheme="S2_2", fast="bonded"
        )
        ends.append(stepped(context, 5)[0])
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-5)
    context.getSystem().addForce(seeded(openmm.MonteCarloBarostat(500.0, 300.0, 2)))
    context.reinitialize(preserveState=True)
    for _ in range(5):
        stepped(context, 4)
    state = context.getState(positions=True)
    assert state.getPeriodicBoxVectors()[0][0] != system.getDefaultPeriodicBoxVectors()[0][0]
    water = state.getPositions(asNumpy=True)._value[22:].reshape(-1, 4, 3)
    for i, j in ((0, 1), (0, 2), (1, 2), (0, 3)):
        assert np.ptp(np.linalg.norm(water[:, i] - water[:, j], axis=1)) <= (1e-13 if j < 3 else 1e-8)
