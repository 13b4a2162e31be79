"""What the populations of the peptide rest on: one peptide and several copies are the same model."""

import numpy as np
import openmm
import pytest
from openmm import app

from benchmarks.proteins import peptide_populations as script
from places import REFERENCE
from starts import context_of


def forces_at(system, x, platform=REFERENCE):
    context = context_of(system, openmm.VerletIntegrator(0.001), x, platform=platform)
    return context.getState(forces=True).getForces(asNumpy=True)._value


@pytest.fixture(scope="module")
def conformations():
    """Return the positions of one peptide along a run at 600 K."""
    _, system, x = script.peptides(1)
    integrator = openmm.LangevinMiddleIntegrator(600.0, 5.0, 0.002)
    integrator.setRandomNumberSeed(1)
    context = context_of(system, integrator, x)
    openmm.LocalEnergyMinimizer.minimize(context)
    found = []
    for _ in range(3):
        integrator.step(3_000)
        found.append(context.getState(positions=True).getPositions(asNumpy=True)._value)
    return found


def test_copies_on_the_cpu_platform_feel_the_forces_of_one_peptide(conformations):
    one, three = (script.peptides(n)[1] for n in (1, 3))
    for x in conformations:
        alone = forces_at(one, x)
        copies = np.concatenate(x + script.places(3)[:, None])
        together = forces_at(three, copies, openmm.Platform.getPlatform("CPU"))
        # In single precision; a reaction field would be a percent.
        np.testing.assert_allclose(together.reshape(3, *x.shape), [alone] * 3, rtol=0.0, atol=1e-4 * np.std(alone))


def test_the_solvent_is_that_of_the_force_field(conformations):
    topology, system, _ = script.peptides(1)
    plain = app.ForceField("amber14-all.xml", "implicit/obc2.xml").createSystem(topology, constraints=app.HBonds)
    umbrella = openmm.XmlSerializer.clone(system)
    while umbrella.getNumForces() > 1:  # the last one
        umbrella.removeForce(0)
    for x in conformations:
        expected = forces_at(plain, x) + forces_at(umbrella, x)
        np.testing.assert_allclose(forces_at(system, x), expected, rtol=0.0, atol=1e-4 * np.std(expected))


def test_weights_undo_the_umbrella_that_the_system_has(conformations):
    topology, system, _ = script.peptides(1)
    while system.getNumForces() > 1:
        system.removeForce(0)
    script.peptides.cache_clear()
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    atoms = script.torsions_of(topology, 1)["psi"]
    for x in conformations:
        context.setPositions(x)
        energy = context.getState(energy=True).getPotentialEnergy()._value
        assert script.umbrella(script.dihedrals(*x[atoms.T]))[0] == pytest.approx(energy, abs=1e-6)


def test_a_weighted_mean_is_that_of_the_model_and_its_error_the_scatter_of_runs():
    """Normal numbers, drawn about 1 and weighted back to 0."""
    generator = np.random.default_rng(1)
    found = []
    for _ in range(400):
        x = generator.normal(1.0, 1.0, (640, 1))
        found.append(script.weighted(x, np.exp(0.5 - x)))
    means, errors = np.transpose(found)
    assert abs(means.mean()) <= 4.0 * means.std() / 20.0 + 0.01  # a ratio of sums is biased by 1/640
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(means.std(), rel=0.15)
