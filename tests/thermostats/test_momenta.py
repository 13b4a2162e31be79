"""Momenta drawn at intervals."""

import numpy as np
import pytest
from openmm import unit

import openmm_exactrb as rb
from starts import simulation_of, velocities_of

R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


def test_momenta_are_canonical_and_depend_on_seed_and_step_only():
    topology, system, positions = rb.dipole_fluid(64, seed=1)
    integrator = rb.ExactRigidBodyIntegrator(0.01, scheme="S2_2")
    simulation = simulation_of(topology, system, integrator, positions)
    simulation.reporters.append(rb.CanonicalMomenta(1.5 / R, 10, seed=1))
    simulation.step(10)
    first = velocities_of(simulation)
    for energy in simulation.integrator.kineticEnergies():
        assert energy._value == pytest.approx(1.5 * 64 * 1.5, rel=4.0 * (2.0 / 192) ** 0.5)
    simulation.step(10)
    assert np.abs(velocities_of(simulation) - first).max() > 0.1
    simulation.currentStep = 10
    simulation.reporters[0].report(simulation, None)
    # The attitudes have changed, and with them the velocities of the sites; those of the centres have not.
    again = velocities_of(simulation)
    np.testing.assert_allclose(
        again.reshape(64, -1, 3)[:, :4].mean(axis=1), first.reshape(64, -1, 3)[:, :4].mean(axis=1), atol=1e-12
    )
