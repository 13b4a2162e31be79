"""How tests begin: Contexts and Simulations, and what is seen in them."""

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from places import REFERENCE

#: The gas constant in kJ/mol/K.
R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


def system_of(masses, constraints=()):
    """Return a System of particles without forces, with constraints (i, j, length)."""
    system = openmm.System()
    for mass in masses:
        system.addParticle(mass)
    for constraint in constraints:
        system.addConstraint(*constraint)
    return system


def apart(x):
    """Return the distances (n, n) of all pairs of places."""
    return np.linalg.norm(x[:, None] - x[None], axis=2)


def put(context, start, velocities=None):
    """Put a Context to a State, or to positions and velocities."""
    if isinstance(start, openmm.State):
        context.setPeriodicBoxVectors(*start.getPeriodicBoxVectors())
        start, velocities = start.getPositions(), start.getVelocities()
    context.setPositions(start)
    if velocities is not None:
        context.setVelocities(velocities)


def context_of(system, integrator, start, velocities=None, *, kelvin=None, seed=1, platform=REFERENCE, properties=None):
    """Return a Context at a State or at positions; with a temperature it draws velocities."""
    context = openmm.Context(system, integrator, platform, properties or {})
    put(context, start, velocities)
    if kelvin is not None:
        context.setVelocitiesToTemperature(kelvin, seed)
    return context


def topology_of(system):
    """Return a Topology of atoms without elements or bonds, for Systems that have none."""
    topology = app.Topology()
    residue = topology.addResidue("ALL", topology.addChain())
    for i in range(system.getNumParticles()):
        topology.addAtom(f"A{i}", None, residue)
    return topology


def simulation_of(
    topology, system, integrator, start, velocities=None, *, kelvin=None, seed=1, platform=REFERENCE, properties=None
):
    """Return a Simulation, started as the Context of `context_of`; without a Topology, of atoms without bonds."""
    simulation = app.Simulation(topology or topology_of(system), system, integrator, platform, properties)
    put(simulation.context, start, velocities)
    if kelvin is not None:
        simulation.context.setVelocitiesToTemperature(kelvin, seed)
    return simulation


def droplet_of(integrator, n=4, trap=0.5, platform=REFERENCE):
    """Return a Simulation of some dipoles in a trap, at 30 K."""
    topology, system, positions = rb.dipole_fluid(n, seed=1, trap=trap)
    return simulation_of(topology, system, integrator, positions, kelvin=30.0, seed=2, platform=platform)


def warm(topology, system, positions, h=0.002, scheme="S2_2", platform=REFERENCE, **options):
    """Return a Simulation of our integrator, minimised and at 300 K."""
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, **options)
    simulation = simulation_of(topology, system, integrator, positions, platform=platform)
    simulation.minimizeEnergy(tolerance=50)
    simulation.context.setVelocitiesToTemperature(300.0, 3)
    return simulation


def state_of(context):
    """Return positions and velocities of a Context or a Simulation."""
    return getattr(context, "context", context).getState(positions=True, velocities=True)


def positions_of(context):
    """Return the positions (n, 3) in nm of a Context or a Simulation."""
    return state_of(context).getPositions(asNumpy=True)._value.copy()


def velocities_of(context):
    """Return the velocities (n, 3) in nm/ps of a Context or a Simulation."""
    return state_of(context).getVelocities(asNumpy=True)._value.copy()


def held(context):
    """Return positions and velocities (2, n, 3) of a Context or a Simulation."""
    state = state_of(context)
    return np.array([state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value])


def energy_of(context):
    """Return the potential energy in kJ/mol of a Context or a Simulation."""
    return getattr(context, "context", context).getState(energy=True).getPotentialEnergy()._value


def total_energy(context):
    """Return potential and kinetic energy in kJ/mol of a Context or a Simulation, as OpenMM has them."""
    state = getattr(context, "context", context).getState(energy=True)
    return (state.getPotentialEnergy() + state.getKineticEnergy())._value


def masses_of(system):
    """Return the masses of all particles in amu."""
    return np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])


def force_of(system, kind=openmm.NonbondedForce):
    """Return the force of a kind, of which there is one."""
    (force,) = (force for force in system.getForces() if isinstance(force, kind))
    return force


def periodic_water(n=216, **options):
    """Return rigid water in a box, with PME and a switched cutoff unless options say otherwise."""
    settings = {
        "nonbondedMethod": app.PME,
        "nonbondedCutoff": 0.7 * unit.nanometer,
        "switchDistance": 0.6 * unit.nanometer,
    }
    return rb.rigid_water(n, **(settings | options))
