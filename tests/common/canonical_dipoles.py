"""Runs of dipoles in the canonical ensemble, and the moments that they report."""

import io

import numpy as np
import openmm
from openmm import unit

import openmm_exactrb as rb
import starts

KB = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


def simulation_of(n, density, kT, mu2, *, step, draw=0.5, sample=0.1, seed=1, **options):
    """Return a Simulation in the canonical ensemble, and the text that its moments go to."""
    own = {"dipole": (0.0, 0.0, mu2**0.5), "inertia": (0.2, 0.2, 0.2), "density": density}
    topology, system, positions = rb.dipole_fluid(n, seed, **own, **({"boundary": rb.ReactionField()} | options))
    ends = {"C": -2.0 * mu2**0.5, "D": 2.0 * mu2**0.5}
    charges = [ends.get(atom.name, 0.0) for atom in topology.atoms()]
    integrator = rb.ExactRigidBodyIntegrator(step, scheme="S2_2")
    simulation = starts.simulation_of(topology, system, integrator, positions)
    openmm.LocalEnergyMinimizer.minimize(simulation.context, 100.0, 50)
    integrator.setVelocitiesToTemperature(kT / KB, seed)
    text = io.StringIO()
    simulation.reporters.append(rb.MomentReporter(text, round(sample / step), charges))
    simulation.reporters.append(rb.CanonicalMomenta(kT / KB, round(draw / step), seed))
    return simulation, text


def moments_in(text):
    return np.loadtxt(io.StringIO(text.getvalue()), delimiter=",", skiprows=1, ndmin=2)[:, 2:]
