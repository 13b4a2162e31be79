"""What is measured: energies at full steps, of runs from one start that conserve them."""

import math

import numpy as np
import openmm
import pytest
from equilibrium import arrays
from openmm import unit

import openmm_exactrb as rb
from openmm_exactrb.openmm_access import platforms
from openmm_exactrb.tuning import Choice
from openmm_exactrb.tuning.benchmark import Benchmark, Method
from openmm_exactrb.tuning.budget import Budget
from openmm_exactrb.tuning.initial_state import conservative, initial_state, thermalised
from places import device_platform
from small_molecules import MOLECULES, placed, system_of
from starts import simulation_of

VERLET = Method()
PLENTY = Budget(1e6)


def at_rest(system, positions, **options):
    return initial_state(system, positions, platform="Reference", **options)[0]


def error(bench, method, step, duration):
    """Return the standard deviation of the energy of a run, infinite if it was unstable."""
    run = bench.run(method, step, duration, bench.state)
    return math.inf if run is None else np.std(run.values)


def made(system, state, platform="Reference", **options):
    """Return a benchmark of a System from a State or positions."""
    return Benchmark(initial_state(system, state, platform=platform, **options)[0], PLENTY)


def test_verlet_is_read_at_full_steps(droplet):
    """Velocity Verlet and SETTLE are of the same order and nearly the same method."""
    bench = made(*droplet)
    errors = [error(bench, method, 0.001, 0.5) for method in (Method(rb.SCHEMES["V2"]), VERLET)]
    assert errors[1] == pytest.approx(errors[0], rel=0.5)


def test_a_run_that_blows_up_is_unstable(droplet):
    bench = made(*droplet)
    for method in (Method(rb.SCHEMES["SRKN4_6b"]), VERLET):
        assert bench.run(method, 0.1, 1.0, bench.state) is None


def test_what_the_cpu_platform_finds_not_finite_is_unstable(droplet):
    bench = made(*droplet, platform="CPU")
    assert bench.run(VERLET, 0.1, 1.0, bench.state) is None


@pytest.mark.opencl
@pytest.mark.parametrize(
    ("reason", "engine"), [pytest.param(None, "native", marks=pytest.mark.library), ("a CPU", "host")]
)
def test_what_is_timed_is_what_a_choice_will_run(droplet, monkeypatch, reason, engine):
    device_platform(["OpenCL"])
    monkeypatch.setattr(platforms, "no_gpu", lambda context: reason)
    system, state = droplet
    forces = system.getNumForces()
    bench = made(system, state, "OpenCL", properties={"Precision": "mixed"})
    tested = bench.under_test(Method(rb.SCHEMES["S2_2"]))
    tested.begin(0.001, bench.state)
    before = tested.energy()
    tested.integrator.step(5)
    assert tested.integrator.getEngine() == engine
    assert system.getNumForces() == forces
    assert tested.energy() == pytest.approx(before, abs=0.01)
    assert tested.timings.total > 0.0
    integrator = Choice("S2_2", 0.001, 1e-3, 1.0, True).integrator()
    context = bench.state.context(integrator)
    assert context.getIntegrator().getEngine() == engine


def test_bodies_far_apart_have_the_time_in_which_they_turn():
    """Two waters 3 nm apart: 1/omega from the forces would be some hundred times as long."""
    _, system, positions = rb.rigid_water(2)
    x = positions._value.copy()
    x[3:] += [3.0, 0.0, 0.0]
    start = thermalised(at_rest(system, x), 300.0, 1, False, PLENTY)
    scales = Benchmark(start, PLENTY).characteristics
    masses = np.array([system.getParticleMass(i)._value for i in range(3)])
    r = x[:3] - masses @ x[:3] / masses.sum()
    inertia = np.einsum(
        "s,sij->ij", masses, np.einsum("si,si->s", r, r)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None]
    )
    kT = scales.kinetic / 3.0
    assert scales.free == pytest.approx(1.0 / np.sqrt(kT * (1.0 / np.linalg.eigvalsh(inertia)).mean()), rel=1e-3)
    assert scales.time == scales.free


def test_what_does_not_conserve_the_energy_is_left_out():
    _, system, _ = rb.rigid_water(2, removeCMMotion=True)
    system.addForce(openmm.AndersenThermostat(300.0, 1.0))
    system.addForce(openmm.MonteCarloBarostat(1.0, 300.0, 0))  # which never acts
    twin, left_out = conservative(system)
    assert left_out == ["CMMotionRemover", "AndersenThermostat"]
    assert twin.getNumForces() == system.getNumForces() - 3


def test_a_start_is_thermalised():
    _, system, positions = rb.rigid_water(27)
    x = positions._value
    start = thermalised(at_rest(system, x), 300.0, 1, True, PLENTY)
    temperature = (
        Benchmark(start, PLENTY).characteristics.kinetic
        / 3.0
        / unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
    )
    assert 150.0 < temperature < 600.0


@pytest.mark.parametrize(
    ("name", "n", "seed"), [("C6H6", 8, 1), pytest.param("SF6", 27, 2, marks=pytest.mark.validate)]
)
def test_molecules_of_a_gas_collide_on_the_way_to_a_temperature(name, n, seed):
    """A step that suits forces between bodies far apart was lost at the first collision."""
    molecule = MOLECULES[name]
    x, edge = placed(molecule, n, seed)
    system = system_of(molecule, n, edge, cutoff=0.6, tolerance=1e-3)
    warm = thermalised(at_rest(system, x), 200.0, seed, True, PLENTY)
    probe, _context = warm.probe()
    freedom = sum(probe.degreesOfFreedom())
    kinetic = sum(energy._value for energy in probe.kineticEnergies())
    expected = 0.5 * freedom * unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin) * 200.0
    assert abs(kinetic / expected - 1.0) < 0.2 + 5.0 * math.sqrt(2.0 / freedom)


def test_bodies_named_by_hand_are_minimised():
    """Two of four molecules overlap: without a minimum first they fly apart."""
    _, system, positions = rb.rigid_water(4)
    while system.getNumConstraints():
        system.removeConstraint(0)
    x = positions._value.copy()
    x[3:6] = x[:3] + np.array([0.12, 0.0, 0.0])
    start = at_rest(system, x, bodies=[[3 * i, 3 * i + 1, 3 * i + 2] for i in range(4)])
    warm = thermalised(start, 100.0, 1, True, PLENTY)
    assert Benchmark(warm, PLENTY).characteristics.kinetic / 3.0 < 5.0 * 0.831
    x, _ = arrays(warm.state)
    assert np.abs(x).max() < 3.0
    assert np.linalg.norm(x[1] - x[0]) == pytest.approx(0.09572, abs=1e-4)


def test_bodies_named_in_a_simulation_are_those_that_are_measured():
    topology, system, positions = rb.rigid_water(2)
    while system.getNumConstraints():
        system.removeConstraint(0)
    named = [[0, 1, 2], [3, 4, 5]]
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=named)
    simulation = simulation_of(topology, system, integrator, positions)
    begin, _ = initial_state(simulation)
    assert begin.bodies == named
    begin.bodies[0][0] = 7
    assert integrator.getNamedBodies() == named
