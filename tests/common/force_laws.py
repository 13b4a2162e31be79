"""What every force obeys, whoever computes it, and energies and forces without units."""

import copy

import numpy as np
import openmm
import pytest
from openmm import unit

import starts
from openmm_exactrb.openmm_access import arrays


def resting(system, positions):
    """Return a Context of a System on the Reference platform, with these positions (nm)."""
    return starts.context_of(system, openmm.VerletIntegrator(0.001), positions)


def of_free_particles(force, positions, box=None):
    """Return a Context of a force that acts on particles of mass 1; the box has edges in nm."""
    system = openmm.System()
    for _ in positions:
        system.addParticle(1.0)
    system.addForce(copy.deepcopy(force))
    if box is not None:
        system.setDefaultPeriodicBoxVectors(*np.diag(box))
    return resting(system, positions)


def evaluated(context):
    """Return the potential energy (kJ/mol) and the forces (n_particles, 3) in kJ/mol/nm."""
    state = context.getState(energy=True, forces=True)
    return state.getPotentialEnergy().value_in_unit(unit.kilojoule_per_mole), arrays.forces(state)


def energy_and_forces(force, positions, box=None):
    """Return energy and forces of a force that acts on particles."""
    return evaluated(of_free_particles(force, positions, box))


def slope(function, d=1e-3):
    """Return the derivative at 0, to the fourth order in d."""
    return (8.0 * (function(d) - function(-d)) - (function(2.0 * d) - function(-2.0 * d))) / (12.0 * d)


def assert_gradient(energy, positions, forces, particles, tolerance=1e-8):
    """Compare forces with finite differences of energy(positions), for some particles and all axes."""
    for particle in particles:
        for axis in range(3):

            def moved(s, particle=particle, axis=axis):
                x = positions.copy()
                x[particle, axis] += s
                return energy(x)

            assert abs(slope(moved) + forces[particle, axis]) < tolerance * max(1.0, np.abs(forces).max())


def assert_lawful(force, positions, box=None):
    """Forces are the gradient of the energy, add up to nothing, and are the same after XML, which is kept too.

    Without periodic boundaries they have no torque either.
    """
    context = of_free_particles(force, positions, box)
    energy, forces = evaluated(context)

    def energy_at(x):
        context.setPositions(x)
        return evaluated(context)[0]

    assert_gradient(energy_at, positions, forces, range(0, len(positions), max(1, len(positions) // 5)))
    assert np.abs(forces.sum(axis=0)).max() < 1e-13 * np.abs(forces).sum()
    if not force.usesPeriodicBoundaryConditions():
        assert np.abs(np.cross(positions, forces).sum(axis=0)).max() < 1e-12 * np.abs(forces).sum()
    text = openmm.XmlSerializer.serialize(force)
    again = openmm.XmlSerializer.deserialize(text)
    assert openmm.XmlSerializer.serialize(again) == text
    energy_again, forces_again = energy_and_forces(again, positions, box)
    assert energy_again == pytest.approx(energy, rel=1e-15)
    np.testing.assert_array_equal(forces_again, forces)
