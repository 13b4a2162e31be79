"""Small boxes of water as scripts of OpenMM's users make them."""

import functools
import warnings
from pathlib import Path

import numpy as np
import openmm
from openmm import Vec3, app, unit

import openmm_exactrb as rb
import starts
from places import REFERENCE

DATA = Path(__file__).parents[1] / "data"
CUTOFF, SWITCH = 0.45 * unit.nanometer, 0.35 * unit.nanometer
FEMTOSECONDS = unit.femtoseconds


@functools.cache
def solvent(model="tip3p", side=1.0):
    """Return topology and positions of a box that Modeller fills, of some 32 molecules where its side is 1 nm."""
    modeller = app.Modeller(app.Topology(), [])
    sides = Vec3(side, side, side) * unit.nanometer
    modeller.addSolvent(app.ForceField(f"{model}.xml"), model=model, boxSize=sides)
    return modeller.topology, modeller.positions


def water_system(topology, forcefield="tip3p.xml", **options):
    """Return a System with PME whose pair forces go smoothly to zero."""
    settings = {
        "nonbondedMethod": app.PME,
        "nonbondedCutoff": CUTOFF,
        "ewaldErrorTolerance": 1e-4,
        "removeCMMotion": False,
    } | options
    return smooth(app.ForceField(forcefield).createSystem(topology, **settings))


def smooth(system):
    """Let the pair forces of a System go smoothly to zero: an energy that jumps says nothing about an integrator."""
    for force in system.getForces():
        if isinstance(force, (openmm.NonbondedForce, openmm.CustomNonbondedForce)):
            force.setUseSwitchingFunction(True)
            force.setSwitchingDistance(SWITCH)
    return system


def simulation_of(topology, system, positions, integrator=None, minimise=10, platform=REFERENCE):
    """Return a Simulation, minimised a little and warm, of our integrator unless another is given."""
    integrator = rb.ExactRigidBodyIntegrator(2 * FEMTOSECONDS, "SRKN4_6b") if integrator is None else integrator
    simulation = starts.simulation_of(topology, system, integrator, positions, platform=platform)
    if minimise:
        ours = isinstance(integrator, rb.ExactRigidBodyIntegrator)
        minimiser = integrator if ours and integrator.getNamedBodies() else simulation
        minimiser.minimizeEnergy(maxIterations=minimise)
    simulation.context.setVelocitiesToTemperature(300, 1)
    return simulation


@functools.cache
def relaxed(minimise):
    """Return positions (nm) of the box of TIP3P after some iterations of OpenMM's minimiser."""
    topology, positions = solvent()
    return coordinates(
        simulation_of(topology, water_system(topology), positions, openmm.VerletIntegrator(0.001), minimise)
    )


def water(integrator=None, minimise=10, **options):
    """Return a Simulation of the box of TIP3P; it is minimised once, with the options of `water_system`."""
    topology, positions = solvent()
    start = relaxed(minimise) if minimise else positions
    return simulation_of(topology, water_system(topology, **options), start, integrator, minimise=0)


def coordinates(simulation):
    """Return positions in nm."""
    return simulation.context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)


def energy(simulation):
    """Return the total energy in kJ/mol, as OpenMM has it."""
    state = simulation.context.getState(energy=True)
    return (state.getPotentialEnergy() + state.getKineticEnergy())._value


def swing(simulation, steps=10):
    """Return the standard deviation of the total energy over some steps, in kJ/mol per molecule."""
    energies = []
    for _ in range(steps):
        simulation.step(1)
        energies.append(energy(simulation))
    return np.std(energies) / simulation.topology.getNumResidues()


def misfit(simulation):
    """Return the largest difference, in nm, between a distance and its constraint."""
    x, system = coordinates(simulation), simulation.system
    constraints = [system.getConstraintParameters(i) for i in range(system.getNumConstraints())]
    first, second, lengths = zip(*((p, q, length._value) for p, q, length in constraints), strict=True)
    distances = np.linalg.norm(x[list(first)] - x[list(second)], axis=1)
    return np.abs(distances - lengths).max()


def quietly(step, *arguments):
    """Call something that may say that a start was put right."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.ShapeWarning)
        return step(*arguments)
