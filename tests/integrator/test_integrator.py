"""ExactRigidBodyIntegrator in stock Simulations and bare Contexts."""

import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
import starts
from few_dipoles import KT, energies, simulation_of, snapshot
from places import platform_for

SHIFT = np.array([0.5, 0.0, 0.0])


# -- stock tools ------------------------------------------------------------------------------------------------


def test_the_total_energy_is_that_of_the_forces_that_act():
    simulation = simulation_of()
    simulation.step(3)
    potential, kinetic = energies(simulation)
    assert simulation.integrator.totalEnergy()._value == pytest.approx(potential + kinetic, rel=1e-13)
    simulation.system.getForce(0).setForceGroup(3)
    simulation.context.reinitialize(preserveState=True)
    simulation.integrator.setIntegrationForceGroups({1})
    assert simulation.integrator.totalEnergy()._value == pytest.approx(kinetic, rel=1e-13)
    simulation.integrator.setIntegrationForceGroups({0, 3})
    assert simulation.integrator.totalEnergy()._value == pytest.approx(potential + kinetic, rel=1e-13)


def test_energy_reporter_writes_every_digit(tmp_path):
    simulation = simulation_of()
    file = tmp_path / "energies.csv"
    reporter = rb.EnergyReporter(file, 3)
    simulation.reporters.append(reporter)
    simulation.step(6)
    reporter.close()
    head, *lines = file.read_text(encoding="utf-8").splitlines()
    assert head.startswith("step,time (ps),translational (kJ/mol),")
    assert (head.count("(kJ/mol)"), head.count("(K)")) == (5, 2)
    step, _, translational, rotational, *kelvin, kinetic, potential, total = map(float, lines[-1].split(","))
    assert (step, len(lines)) == (6, 2)
    assert kelvin == [T._value for T in simulation.integrator.temperatures()]
    assert potential == energies(simulation)[0]
    assert total == kinetic + potential
    assert kinetic == translational + rotational


# -- what a user does between steps -----------------------------------------------------------------------------


def test_positions_set_between_steps_are_taken_up():
    simulation = simulation_of()
    simulation.step(5)
    x, _ = snapshot(simulation)
    simulation.context.setPositions(x + SHIFT)
    bodies, state = simulation.integrator.bodyState()
    massive = np.concatenate([kind.particles.ravel() for kind in bodies.kinds])
    np.testing.assert_allclose(bodies.positions(state, x.copy())[massive], x[massive] + SHIFT, rtol=0.0, atol=1e-14)


def test_only_bodies_that_were_moved_are_fitted_again():
    simulation = simulation_of()
    simulation.step(5)
    _, before = simulation.integrator.bodyState()
    x, _ = snapshot(simulation)
    x[:5] += 0.01
    simulation.context.setPositions(x)
    _, after = simulation.integrator.bodyState()
    for a, b in zip(after, before, strict=True):
        np.testing.assert_array_equal(a[:, 1:], b[:, 1:])
    np.testing.assert_array_equal(after.q, before.q)
    np.testing.assert_allclose(after.R[:, 0], before.R[:, 0] + 0.01, rtol=0.0, atol=1e-14)


def test_temperature_minimiser_and_step_size_between_steps():
    simulation = simulation_of()
    simulation.step(5)
    simulation.minimizeEnergy(tolerance=0.1)
    simulation.context.setVelocitiesToTemperature(2 * KT, 5)
    kinetic = energies(simulation)[1]
    simulation.integrator.setStepSize(1.0 * unit.femtosecond)
    simulation.step(1)
    assert sum(e._value for e in simulation.integrator.kineticEnergies()) == pytest.approx(kinetic, rel=1e-3)
    assert simulation.context.getTime()._value == pytest.approx(5 * 0.02 + 0.001, rel=1e-12)


def test_cm_motion_remover_works():
    topology, system, positions = rb.dipole_fluid(8, trap=0.5)
    system.addForce(openmm.CMMotionRemover(1))
    simulation = starts.simulation_of(
        topology, system, rb.ExactRigidBodyIntegrator(0.01, "S2_2"), positions, kelvin=KT, seed=2
    )
    simulation.step(3)
    _, state = simulation.integrator.bodyState()
    np.testing.assert_allclose(state.P.sum(axis=1), 0.0, atol=1e-12)
    simulation.integrator.setVelocitiesToTemperature(300.0, 1)
    _, state = simulation.integrator.bodyState()
    np.testing.assert_allclose(state.P.sum(axis=1), 0.0, atol=1e-12 * np.abs(state.P).max())


def test_a_bare_context_is_that_of_a_simulation():
    topology, system, positions = rb.dipole_fluid(4)
    context = starts.context_of(system, rb.ExactRigidBodyIntegrator(0.01), positions)
    simulation = starts.simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.01), positions)
    context.getIntegrator().step(3)
    simulation.step(3)
    np.testing.assert_array_equal(starts.positions_of(context), starts.positions_of(simulation.context))


def test_the_cpu_platform_agrees_with_reference():
    ends = []
    for name in ("Reference", "CPU"):
        simulation = simulation_of(platform=openmm.Platform.getPlatform(name))
        x, v = snapshot(simulation_of())
        simulation.context.setPositions(x)
        simulation.context.setVelocities(v)
        simulation.step(10)
        ends.append(snapshot(simulation)[0])
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-6)


# -- what OpenMM allows a user of a CustomIntegrator ------------------------------------------------------------


@pytest.mark.parametrize("engine", ["host", "native"])
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("addComputePerDof", ("v", "0")),
        ("addComputeGlobal", ("y", "0")),
        ("addComputeSum", ("y", "v")),
        ("addConstrainPositions", ()),
        ("addConstrainVelocities", ()),
        ("addUpdateContextState", ()),
        ("addGlobalVariable", ("y", 0.0)),
        ("addPerDofVariable", ("y", 0.0)),
        ("addTabulatedFunction", ("y", None)),
        ("beginIfBlock", ("dt > 0",)),
        ("beginWhileBlock", ("dt > 0",)),
        ("endBlock", ()),
    ],
)
def test_a_program_of_ones_own_is_refused(name, arguments, engine):
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.01, engine=engine)
    before = openmm.XmlSerializer.serialize(integrator)
    with pytest.raises(ValueError, match=rf"has no {name}\(\), .* put your own Substep into the sequence"):
        getattr(integrator, name)(*arguments)
    assert openmm.XmlSerializer.serialize(integrator) == before


@pytest.mark.parametrize("engine", ["host", "native"])
def test_particles_that_were_set_to_the_origin_have_positions(engine):
    system = openmm.System()
    system.addParticle(1.0)
    system.addParticle(1.0)
    integrator = rb.ExactRigidBodyIntegrator(0.01, engine=engine)
    context = openmm.Context(system, integrator, *platform_for(engine))
    with pytest.raises(ValueError, match="no positions yet"):
        integrator.step(1)
    context.setPositions(np.zeros((2, 3)))
    integrator.step(1)
    assert context.getStepCount() == 1
