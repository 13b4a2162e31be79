"""What a script changes between steps: parameters, groups, masses, constraints, the whole Context."""

import copy

import numpy as np
import openmm
import pytest
from boxes import (
    FEMTOSECONDS,
    REFERENCE,
    coordinates,
    energy,
    misfit,
    quietly,
    simulation_of,
    solvent,
    swing,
    water,
    water_system,
)
from openmm import app, unit

import openmm_exactrb as rb


def heavier(simulation):
    for i in range(simulation.system.getNumParticles()):
        simulation.system.setParticleMass(i, 2 * simulation.system.getParticleMass(i))


def longer(simulation):
    for i in range(simulation.system.getNumConstraints()):
        p, q, length = simulation.system.getConstraintParameters(i)
        simulation.system.setConstraintParameters(i, p, q, 1.01 * length)


@pytest.mark.parametrize("change", [heavier, longer])
def test_reinitialize_takes_up_what_was_changed(change):
    simulation = water(rb.ExactRigidBodyIntegrator(1 * FEMTOSECONDS, "SRKN4_6b"))
    quietly(simulation.step, 2)
    change(simulation)
    simulation.context.reinitialize(preserveState=True)
    quietly(simulation.step, 1)
    ours = sum(simulation.integrator.kineticEnergies(), 0 * unit.kilojoule_per_mole)
    theirs = simulation.context.getState(energy=True).getKineticEnergy()
    assert ours._value == pytest.approx(theirs._value, rel=1e-9)
    assert misfit(simulation) < 1e-6
    assert swing(simulation, 20) < 1e-3


def test_reinitialize_and_new_positions_start_over():
    simulation = water()
    quietly(simulation.step, 2)
    x = coordinates(simulation)
    simulation.context.reinitialize()
    simulation.context.setPositions(x)
    simulation.context.setVelocitiesToTemperature(300, 1)
    assert quietly(swing, simulation) < 1e-3


def test_force_groups_select_what_acts():
    topology, positions = solvent()
    system = water_system(topology)
    for force in system.getForces():
        force.setForceGroup(1 if isinstance(force, openmm.NonbondedForce) else 0)
    integrator = rb.ExactRigidBodyIntegrator(2 * FEMTOSECONDS, "SRKN4_6b")
    integrator.setIntegrationForceGroups({0})
    simulation = simulation_of(topology, system, positions, integrator)
    quietly(simulation.step, 1)
    kinetic = [simulation.integrator.kineticEnergies()[k]._value for k in (0, 1)]
    simulation.step(5)  # nothing acts: both parts are kept
    np.testing.assert_allclose([e._value for e in simulation.integrator.kineticEnergies()], kinetic, rtol=1e-12)
    integrator.setIntegrationForceGroups({0, 1})
    simulation.step(5)
    assert abs(simulation.integrator.kineticEnergies()[0]._value - kinetic[0]) > 1e-3


def test_copies_keep_the_tolerance_of_constraints_and_the_groups():
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme="V2")
    integrator.setConstraintTolerance(1e-9)
    integrator.setIntegrationForceGroups({0, 3})
    twin = copy.copy(integrator)
    assert twin.getConstraintTolerance() == 1e-9
    assert twin.getIntegrationForceGroups() == integrator.getIntegrationForceGroups()
    assert twin.getScheme() is integrator.getScheme()


# -- copies in C++ ----------------------------------------------------------------------------------------------


@pytest.mark.library
def test_the_step_of_the_base_class_is_a_step():
    one, other = water(), water()
    quietly(one.step, 3)
    quietly(lambda: [openmm.CustomIntegrator.step(other.integrator, n) for n in (1, 2)])
    np.testing.assert_array_equal(coordinates(one), coordinates(other))


def test_a_cluster_job_reads_everything_from_xml(tmp_path):
    simulation = water()
    quietly(simulation.step, 1)
    simulation.saveState(str(tmp_path / "state.xml"))
    for name, what in (("system", simulation.system), ("integrator", simulation.integrator)):
        (tmp_path / f"{name}.xml").write_text(openmm.XmlSerializer.serialize(what))
    files = [str(tmp_path / f"{name}.xml") for name in ("system", "integrator", "state")]
    job = app.Simulation(simulation.topology, *files[:2], REFERENCE, state=files[2])
    for one in (simulation, job):
        quietly(one.step, 3)
    np.testing.assert_array_equal(coordinates(job), coordinates(simulation))


# -- other integrators ------------------------------------------------------------------------------------------


def test_from_langevin_to_ours_and_back(tmp_path):
    theirs = openmm.LangevinMiddleIntegrator(300, 1, 0.002)
    theirs.setRandomNumberSeed(1)
    langevin = water(theirs)
    langevin.step(5)
    file = str(tmp_path / "equilibrated.xml")
    langevin.saveState(file)
    simulation = water(minimise=0)
    rb.loadState(simulation, file)
    np.testing.assert_allclose(coordinates(simulation), coordinates(langevin), atol=1e-12)
    assert simulation.currentStep == 5
    assert quietly(swing, simulation) < 1e-3
    simulation.saveState(file)
    langevin.loadState(file)
    np.testing.assert_allclose(coordinates(langevin), coordinates(simulation), atol=1e-12)
    assert energy(langevin) == pytest.approx(energy(simulation), abs=1e-6)
    langevin.step(2)
