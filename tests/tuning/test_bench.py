"""What is measured: energies at full steps, of runs from one start that conserve them."""

import numpy as np
import openmm
import pytest
from equilibrium import arrays
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.tuning.bench import Bench
from openmm_exactrb.tuning.movers import VERLET
from openmm_exactrb.tuning.scales import scales_of
from openmm_exactrb.tuning.start import Start, conservative, start_of
from openmm_exactrb.tuning.thermal import thermalised


def test_verlet_starts_with_the_same_energy_and_is_read_at_full_steps(droplet):
    system, state = droplet
    bench = Bench(Start(system, *arrays(state), platform="Reference"))
    ours, theirs = bench.mover(rb.SCHEMES["V2"]), bench.mover(VERLET)
    energies = []
    for mover in (ours, theirs):
        mover.begin(0.001)
        energies.append(mover.energy())
    assert energies[1] == pytest.approx(energies[0], abs=1e-6)
    # Velocity Verlet and SETTLE are of the same order and nearly the same method.
    errors = [bench.run(m, 0.001, 0.5).error(0.5) for m in (rb.SCHEMES["V2"], VERLET)]
    assert errors[1] == pytest.approx(errors[0], rel=0.5)


def test_a_run_that_blows_up_is_unstable(droplet):
    system, state = droplet
    bench = Bench(Start(system, *arrays(state), platform="Reference"))
    for method in (rb.SCHEMES["SRKN4_6b"], VERLET):
        assert not bench.run(method, 0.1, 1.0).stable


def test_what_does_not_conserve_the_energy_is_left_out():
    _, system, _ = rb.rigid_water(2, removeCMMotion=True)
    system.addForce(openmm.AndersenThermostat(300.0, 1.0))
    twin, left_out = conservative(system)
    assert left_out == ["CMMotionRemover", "AndersenThermostat"]
    assert twin.getNumForces() == system.getNumForces() - 2


def test_a_start_is_thermalised():
    _, system, positions = rb.rigid_water(27)
    x = positions._value
    start = thermalised(Start(system, x, np.zeros_like(x), platform="Reference"), 300.0, 1, minimise=True)
    temperature = (
        scales_of(start).kinetic / 3.0 / unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
    )
    assert 150.0 < temperature < 600.0


def test_bodies_named_in_a_simulation_are_those_that_are_measured():
    topology, system, positions = rb.rigid_water(2)
    while system.getNumConstraints():
        system.removeConstraint(0)
    named = [[0, 1, 2], [3, 4, 5]]
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=named)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    simulation.context.setPositions(positions)
    begin, _ = start_of(simulation, None, None, None, None, None)
    assert begin.bodies == named
    begin.bodies[0][0] = 7
    assert integrator.getNamedBodies() == named
