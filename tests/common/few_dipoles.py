"""A few dipoles in a Simulation."""

from openmm import unit

import openmm_exactrb as rb
import starts
from openmm_exactrb.openmm_access import arrays
from places import REFERENCE

KT = 0.2 / unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


def simulation_of(
    n=8, h=0.02, scheme="SRKN4_6b", rotor="exact", platform=REFERENCE, trap=0.5, engine="auto", seed=1, **options
):
    """Return a Simulation of n dipoles that is about to start, at the temperature `KT` (K)."""
    topology, system, positions = rb.dipole_fluid(n, seed=seed, trap=trap, **options)
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, rotor=rotor, engine=engine)
    return starts.simulation_of(topology, system, integrator, positions, kelvin=KT, seed=seed + 1, platform=platform)


def snapshot(simulation):
    """Return positions (nm) and velocities (nm/ps) of all particles."""
    state = simulation.context.getState(positions=True, velocities=True)
    return arrays.positions(state), arrays.velocities(state)


def energies(simulation):
    """Return potential and kinetic energy in kJ/mol."""
    state = simulation.context.getState(energy=True)
    return state.getPotentialEnergy()._value, state.getKineticEnergy()._value
