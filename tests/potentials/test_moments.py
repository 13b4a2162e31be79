"""Dipole moments and their units."""

import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
from force_laws import energy_and_forces


def test_a_dipole_moment_takes_units():
    assert rb.dipole_strength(1.5) == 1.5
    coulomb = 138.93545764438198
    e_nm = unit.elementary_charge * unit.nanometer
    assert rb.dipole_strength(0.1 * e_nm) == pytest.approx(0.1 * coulomb**0.5, rel=1e-12)
    assert rb.dipole_strength(2.35 * unit.debye) == pytest.approx(2.35 * 0.0208194334 * coulomb**0.5, rel=1e-8)
    with pytest.raises(ValueError, match="is not a dipole moment"):
        rb.dipole_strength(1.0 * unit.nanometer)
    for wrong in (float("nan") * unit.debye, float("inf") * e_nm, [1.0, 2.0] * unit.debye):
        with pytest.raises(ValueError, match="a dipole moment must be a finite number of"):
            rb.dipole_strength(wrong)


def test_two_charges_are_as_strong_as_their_dipole():
    """Far away a pair of charges +-q at a distance d is the dipole q d: OpenMM's Coulomb energy, in its own units."""
    charge, d, r = 0.4, 1e-3, 1.0
    force = openmm.NonbondedForce()
    for q in (charge, -charge, charge, -charge):
        force.addParticle(q, 1.0, 0.0)
    force.addException(0, 1, 0.0, 1.0, 0.0)
    force.addException(2, 3, 0.0, 1.0, 0.0)
    z = np.array([d / 2, -d / 2, r + d / 2, r - d / 2])
    strength = rb.dipole_strength(charge * d * unit.elementary_charge * unit.nanometer)
    energy, _ = energy_and_forces(force, np.column_stack([0 * z, 0 * z, z]))
    assert energy == pytest.approx(-2 * strength**2 / r**3, rel=1e-4)
