"""Starts as people have them: filled by Modeller, rounded in files, far away, frozen, or broken."""

import io
import warnings

import numpy as np
import openmm
import pytest
from boxes import (
    DATA,
    FEMTOSECONDS,
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

CPU = openmm.Platform.getPlatform("CPU")
MODELS = ["tip4pew", "spce"]


def steadier_than_verlet(simulation):
    """Check that the energy swings a tenth of what it does with Verlet from the same start."""
    system, x = simulation.system, coordinates(simulation)
    verlet = simulation_of(
        simulation.topology,
        system,
        x,
        openmm.VerletIntegrator(simulation.integrator.getStepSize()),
        minimise=0,
        platform=simulation.context.getPlatform(),
    )
    assert quietly(swing, simulation) < 0.1 * swing(verlet)
    assert misfit(simulation) < 1e-6


@pytest.mark.parametrize(
    "model", [*MODELS[:1], *(pytest.param(model, marks=pytest.mark.validate) for model in MODELS[1:])]
)
def test_boxes_that_modeller_fills_run_as_they_are(model):
    topology, positions = solvent(model, 2.0)
    system = water_system(topology, f"{model}.xml")
    steadier_than_verlet(simulation_of(topology, system, positions, minimise=0, platform=CPU))


@pytest.mark.parametrize(
    "model", [*MODELS[:1], *(pytest.param(model, marks=pytest.mark.validate) for model in MODELS[1:])]
)
def test_boxes_that_a_pdb_file_rounded_run(model):
    topology, positions = solvent(model, 2.0)
    system = water_system(topology, f"{model}.xml")
    relaxed = simulation_of(topology, system, positions, openmm.VerletIntegrator(1 * FEMTOSECONDS), platform=CPU)
    text = io.StringIO()
    app.PDBFile.writeFile(topology, coordinates(relaxed) * unit.nanometer, text)
    pdb = app.PDBFile(io.StringIO(text.getvalue()))
    steadier_than_verlet(simulation_of(pdb.topology, system, pdb.positions, minimise=0, platform=CPU))


@pytest.mark.parametrize("model", MODELS)
def test_boxes_rounded_as_in_gro_files_run_with_one_warning(model):
    topology, positions = solvent(model)
    rounded = np.round(positions.value_in_unit(unit.nanometer), 3)
    simulation = simulation_of(topology, water_system(topology, f"{model}.xml"), rounded, minimise=0)
    with pytest.warns(rb.ShapeWarning, match=r"were corrected \(bodies affected: \d+\), by up to 0\.00\d+ nm") as told:
        simulation.step(2)
    assert len(told) == 1
    steadier_than_verlet(simulation)


@pytest.mark.parametrize("name", ["opc", "opc3"])
def test_droplets_of_openmm_s_own_boxes_run(name):
    pdb = app.PDBFile(str(DATA / f"{name}box_27.pdb"))
    modeller = app.Modeller(pdb.topology, pdb.positions)
    forcefield = app.ForceField(f"{name}.xml")
    modeller.addExtraParticles(forcefield)
    system = forcefield.createSystem(modeller.topology, removeCMMotion=False)
    simulation = simulation_of(modeller.topology, system, modeller.positions, minimise=0)
    steadier_than_verlet(simulation)


def test_centres_and_velocities_of_rounded_molecules_stay():
    simulation = water()
    x = np.round(coordinates(simulation), 3)
    masses = np.array([simulation.system.getParticleMass(i)._value for i in range(3)])
    centres = np.einsum("s,nsi->ni", masses / masses.sum(), x.reshape(-1, 3, 3))
    simulation.context.setPositions(x)
    quietly(simulation.integrator.kineticEnergies)
    placed = np.einsum("s,nsi->ni", masses / masses.sum(), coordinates(simulation).reshape(-1, 3, 3))
    np.testing.assert_allclose(placed, centres, atol=1e-12)
    assert misfit(simulation) < 1e-9
    assert np.abs(coordinates(simulation) - x).max() < 2e-3


def test_rounded_positions_in_mid_run_are_put_on_the_shapes():
    simulation = water()
    simulation.step(3)
    simulation.context.setPositions(np.round(coordinates(simulation), 3))
    with pytest.warns(rb.ShapeWarning) as told:
        simulation.step(1)
    assert len(told) == 1
    steadier_than_verlet(simulation)


def test_broken_molecules_are_refused_until_they_are_mended():
    simulation, twin = water(), water()
    for one in (simulation, twin):
        one.step(2)
    good = coordinates(simulation)
    broken = good.copy()
    broken[4] += 0.1
    simulation.context.setPositions(broken)
    for ask in (lambda: simulation.step(1), lambda: simulation.step(1), simulation.integrator.totalEnergy):
        with pytest.raises(ValueError, match="deviate from its shape"):
            ask()
        np.testing.assert_array_equal(coordinates(simulation), broken)
    simulation.context.setPositions(good)
    for one in (simulation, twin):
        one.step(2)
    np.testing.assert_array_equal(coordinates(simulation), coordinates(twin))


@pytest.mark.parametrize("what", ["Positions", "Velocities"])
def test_nan_is_refused_until_it_is_mended(what):
    simulation = water()
    simulation.step(2)
    state = simulation.context.getState(positions=True, velocities=True)
    good = getattr(state, f"get{what}")(asNumpy=True)
    bad = good._value.copy()
    bad[5, 1] = np.nan
    put = getattr(simulation.context, f"set{what}")
    put(bad)
    for ask in (lambda: simulation.step(1), lambda: simulation.step(1), simulation.integrator.totalEnergy):
        with pytest.raises(ValueError, match="not finite"):
            ask()
    put(good)
    simulation.step(2)
    assert np.isfinite(energy(simulation))


@pytest.mark.parametrize("named", [False, True])
def test_molecules_that_a_box_wrapped_are_taken_up(named):
    """OpenMM keeps together what bonds or constraints join, and wraps the particles of other bodies one by one."""
    topology, positions = solvent()
    system = water_system(topology)
    bodies = [[a.index for a in residue.atoms()] for residue in topology.residues()] if named else None
    simulations = []
    for _ in range(2):
        first = simulation_of(topology, system, positions)
        if named:
            for i in reversed(range(system.getNumConstraints())):
                system.removeConstraint(i)
        integrator = rb.ExactRigidBodyIntegrator(2 * FEMTOSECONDS, "SRKN4_6b", bodies=bodies)
        simulations.append(simulation_of(topology, system, coordinates(first), integrator, minimise=0))
        system = water_system(topology)
    simulation, twin = simulations
    for one in simulations:
        one.step(5)
    wrapped = simulation.context.getState(positions=True, enforcePeriodicBox=True).getPositions(asNumpy=True)
    assert np.abs(wrapped._value - coordinates(simulation)).max() > 0.5
    simulation.context.setPositions(wrapped)
    for one in simulations:
        one.step(5)
    assert energy(simulation) == pytest.approx(energy(twin), abs=1e-3)


def test_coordinates_far_away_behave_as_with_verlet():
    """The distance is that of 1e5 boxes: positions of float64 are rounded to 1e-11 nm there, energies accordingly."""
    near = water()
    x = coordinates(near)
    far = water(minimise=0)
    far.context.setPositions(x + 1e5 * np.array([1.0, -1.0, 1.0]))
    far.context.setVelocities(near.context.getState(velocities=True).getVelocities())
    start = energy(near)
    for one in (near, far):
        quietly(one.step, 5)
    assert energy(far) == pytest.approx(energy(near), abs=1e-3)
    assert energy(far) == pytest.approx(start, abs=0.5)


def test_frozen_molecules_stay_where_they_are():
    topology, positions = solvent()
    system = water_system(topology)
    for i in range(6):
        system.setParticleMass(i, 0.0)
    simulation = simulation_of(topology, system, positions, minimise=0)
    before = coordinates(simulation)
    quietly(simulation.step, 5)
    after = coordinates(simulation)
    np.testing.assert_array_equal(after[:6], before[:6])
    assert np.abs(after[6:] - before[6:]).max() > 1e-3
    assert swing(simulation) < 1e-2


def test_a_system_without_rigid_bodies_runs():
    topology, positions = solvent()
    system = water_system(topology, rigidWater=False)
    verlet = simulation_of(topology, system, positions, openmm.VerletIntegrator(0.2 * FEMTOSECONDS))
    x, v = (
        f() for f in (lambda: coordinates(verlet), lambda: verlet.context.getState(velocities=True).getVelocities())
    )
    simulation = simulation_of(
        topology, system, x, rb.ExactRigidBodyIntegrator(0.2 * FEMTOSECONDS, "SRKN4_6b"), minimise=0
    )
    simulation.context.setVelocities(v)
    assert swing(simulation) < 0.1 * swing(verlet)


def test_flexible_molecules_beside_rigid_ones_run():
    """As a flexible protein in rigid water without constraints in it: its atoms are particles beside the bodies."""
    topology, positions = solvent()
    system, rigid = (
        app.ForceField("tip3p.xml").createSystem(topology, rigidWater=rigid, removeCMMotion=False)
        for rigid in (False, True)
    )
    for i in range(rigid.getNumConstraints()):
        p, q, length = rigid.getConstraintParameters(i)
        if p >= 15:  # all but five molecules
            system.addConstraint(p, q, length)
    simulation = simulation_of(topology, system, positions, rb.ExactRigidBodyIntegrator(0.2 * FEMTOSECONDS, "SRKN4_6b"))
    quietly(simulation.step, 1)
    assert len(simulation.integrator.bodyState()[0]) == topology.getNumResidues() - 5 + 15
    verlet = simulation_of(topology, system, coordinates(simulation), openmm.VerletIntegrator(0.2 * FEMTOSECONDS))
    assert swing(simulation) < 0.1 * swing(verlet)


def test_a_box_that_changes_between_steps_is_taken_up():
    simulation, verlet = water(), water(openmm.VerletIntegrator(2 * FEMTOSECONDS))
    for one in (simulation, verlet):
        one.context.setPeriodicBoxVectors((1.02, 0, 0), (0, 1.02, 0), (0, 0, 1.02))
    verlet.context.setPositions(coordinates(simulation))
    verlet.context.setVelocities(simulation.context.getState(velocities=True).getVelocities())
    steps = swing(simulation), swing(verlet)
    assert steps[0] < 0.1 * steps[1]


@pytest.mark.parametrize("size", [2.0, 0.05])
def test_blow_ups_stop_in_the_first_bad_step_and_name_it(size):
    """A step of 2 ps, where fs were meant, and one of 50 fs."""
    topology, positions = solvent()
    droplet = app.ForceField("tip3p.xml").createSystem(topology, removeCMMotion=False)
    simulation = simulation_of(topology, droplet, positions, rb.ExactRigidBodyIntegrator(size, scheme="V2"))
    before = coordinates(simulation)
    with pytest.raises(
        rb.IntegrationError, match=r"step 1,.* (kinetic energy rose from|speeds exceeded the speed of light)"
    ):
        simulation.step(100)
    np.testing.assert_allclose(coordinates(simulation), before, atol=1e-4)


def test_hot_and_minimised_starts_are_no_false_alarm():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulation = water()
        simulation.context.setVelocitiesToTemperature(0)
        simulation.step(30)
        simulation.context.setVelocitiesToTemperature(3000, 1)
        simulation.step(10)
