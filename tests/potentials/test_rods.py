"""Dipoles as rods of charges: what the two forces of OpenMM's add up to, and what they refuse."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
import starts
from force_laws import assert_lawful, evaluated, resting
from openmm_exactrb.potentials import dipole_rod_forces, rod_length
from places import platform_for

STATE = {"seed": 3, "perturbation": 0.08, "density": 0.6, "dipole": (0.0, 0.6, 0.8), "epsilon": 1e-9}


def energy_forces_torques(n, kernel, tolerance, **options):
    """Return the energy, and forces and torques (n, 3) on the bodies."""
    _, system, positions = rb.dipole_fluid(
        n, kernel=kernel, boundary=rb.Ewald(cutoff=1.5, tolerance=tolerance), **STATE | options
    )
    energy, forces = evaluated(resting(system, positions))
    x = positions._value.reshape(n, -1, 3)
    on_masses = forces.reshape(x.shape)[:, :3]
    return energy, on_masses.sum(axis=1), np.cross(x[:, :3] - x[:, -2:-1], on_masses).sum(axis=1)


def apart(one, other):
    """Return the root mean square difference, as a part of the other's root mean square."""
    return np.linalg.norm(one - other) / np.linalg.norm(other)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_rods_have_the_forces_and_torques_of_point_dipoles_to_the_tolerance(tolerance):
    _, force, torque = energy_forces_torques(27, "openmm", tolerance)
    _, exact_force, exact_torque = energy_forces_torques(27, "compiled", 1e-10)
    errors = apart(force, exact_force), apart(torque, exact_torque)
    assert max(errors) < tolerance, errors


@pytest.mark.parametrize("own", [{"attraction": 0.8}, {"attraction": 0.8, "wca": True}], ids=["lj", "wca"])
def test_the_spheres_are_those_of_the_compiled_kernel(own):
    own |= {"epsilon": 50.0, "dipole": (0.0, 1e-3, 0.0)}
    energy, force, _ = energy_forces_torques(27, "openmm", 1e-2, **own)
    exact, exact_force, _ = energy_forces_torques(27, "compiled", 1e-2, **own)
    assert energy == pytest.approx(exact, rel=1e-7)
    assert apart(force, exact_force) < 1e-7


def test_what_is_added_within_the_cutoff_is_lawful(rng):
    edge, length = 5.2, 0.1
    centres = 1.3 * np.argwhere(np.ones((2, 2, 2))) + 0.05 * rng.standard_normal((8, 3))
    half = rng.standard_normal((8, 3))
    half *= 0.5 * length / np.linalg.norm(half, axis=1, keepdims=True)
    x = np.stack([centres + half, centres - half, centres], axis=1).reshape(-1, 3)
    rods, middles = np.arange(24).reshape(8, 3)[:, :2].tolist(), list(range(2, 24, 3))
    settings = {
        "centres": middles,
        "strength": 1.5,
        "length": length,
        "box": 3 * [edge],
        "boundary": rb.Ewald(cutoff=2.0, tolerance=1e-2),
    }
    charges, near = dipole_rod_forces(rods, 24, **settings)
    assert_lawful(near, x, 3 * [edge])
    moments = sum(charges.getParticleParameters(i)[0]._value * x[i] for i in (0, 1))
    assert np.linalg.norm(moments) * 138.93545764438198**0.5 == pytest.approx(1.5, rel=1e-12)


@pytest.mark.parametrize("boundary", [rb.Ewald(cutoff=1.5, tolerance=1e-3), rb.ReactionField(cutoff=0.7)])
def test_a_device_has_the_energies_and_forces_of_reference(boundary):
    _, system, positions = rb.dipole_fluid(27, kernel="openmm", boundary=boundary, **STATE | {"epsilon": 1.0})
    energy, forces = evaluated(resting(system, positions))
    platform, properties = platform_for("native")
    on_device, forces_there = evaluated(
        starts.context_of(system, openmm.VerletIntegrator(0.001), positions, platform=platform, properties=properties)
    )
    assert on_device == pytest.approx(energy, rel=1e-4)  # each platform has its own mesh
    assert apart(forces_there, forces) < 1e-4


def test_the_topology_ends_in_centre_and_tip_as_with_every_kernel():
    topology, system, positions = rb.dipole_fluid(27, kernel="openmm", boundary=rb.Ewald(tolerance=1e-3), density=0.3)
    names = [atom.name for atom in next(topology.residues()).atoms()]
    assert names == ["M1", "M2", "M3", "P", "N", "C", "D"]
    kinds = [openmm.NonbondedForce, openmm.CustomHbondForce, openmm.CustomVolumeForce]
    assert [type(force) for force in system.getForces()] == kinds
    x = positions._value.reshape(27, 7, 3)
    np.testing.assert_allclose(x[:, 3] + x[:, 4], 2.0 * x[:, 5], atol=1e-14)
    boundary = rb.Ewald(tolerance=1e-3)
    length = rod_length(27, 3 * [(27 / 0.3) ** (1 / 3)], boundary)
    np.testing.assert_allclose(np.linalg.norm(x[:, 3] - x[:, 4], axis=1), length, rtol=1e-12)
