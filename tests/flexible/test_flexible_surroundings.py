"""What else a System of flexible molecules has, and what changes in a run: all of it as on the host."""

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from both_engines import apart, nested, pair
from peptides import in_water, peptide
from places import platform_for
from starts import context_of as reference_of
from starts import held, positions_of

pytestmark = [pytest.mark.library, pytest.mark.opencl]


def with_everything():
    """Return a peptide with a lone pair, an alchemical charge, restraints, an anchor and a bias; and its bonds."""
    _, system, x = in_water(waters=30)
    (nonbonded,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    (bonds,) = (force for force in system.getForces() if isinstance(force, openmm.HarmonicBondForce))
    for mass in (0.0, 0.0):
        system.addParticle(mass)
    pair, anchor = len(x), len(x) + 1
    site = openmm.LocalCoordinatesSite(4, 5, 6, (1, 0, 0), (-1, 1, 0), (-1, 0, 1), (0.03, 0.02, 0.01))
    system.setVirtualSite(pair, site)
    x = np.concatenate([x, [x[4], x[8] + 0.15]])
    nonbonded.addParticle(-0.1, 0.1, 0.0)
    nonbonded.addParticle(0.0, 0.1, 0.0)
    nonbonded.addException(pair, 4, 0.0, 0.1, 0.0)
    nonbonded.addGlobalParameter("alchemical", 0.0)
    nonbonded.addParticleParameterOffset("alchemical", 5, 0.2, 0.0, 0.0)
    bonds.addBond(8, anchor, 0.2, 3000.0)
    restraint = openmm.CustomExternalForce("restraint*(x^2+y^2+z^2)")
    restraint.addGlobalParameter("restraint", 10.0)
    restraint.addParticle(14)
    torsion, bias = openmm.CustomTorsionForce("theta"), openmm.CustomCVForce("height*exp(-(psi-1)^2)")
    torsion.addTorsion(6, 8, 14, 16)
    bias.addCollectiveVariable("psi", torsion)
    bias.addGlobalParameter("height", 2.0)
    for force in (restraint, bias):
        system.addForce(force)
    return system, x, bonds


def test_sites_restraints_and_biases_change_as_on_the_host():
    system, x, bonds = with_everything()
    contexts = pair(system, x, nested("S2_2", 0.002))
    i, j, length, strength = bonds.getBondParameters(0)
    bonds.setBondParameters(0, i, j, 1.02 * length, strength)
    for changes in ({}, {"alchemical": 0.5}, {"restraint": 30.0, "height": 8.0}):
        for context in contexts:
            for name, value in changes.items():
                context.setParameter(name, value)
            context.getIntegrator().step(3)
        assert apart(*contexts) < 1e-12
    before = apart(*contexts)
    for context in contexts:
        (own,) = (f for f in context.getSystem().getForces() if isinstance(f, openmm.HarmonicBondForce))
        own.setBondParameters(0, i, j, 1.02 * length, strength)
        own.updateParametersInContext(context)
        context.getIntegrator().step(3)
    assert apart(*contexts) < 10.0 * before + 1e-12
    assert contexts[1].getIntegrator().getEngine() == "native"


def test_water_with_virtual_sites_moves_as_on_the_host():
    topology, _, x = peptide()
    field, modeller = app.ForceField("amber14-all.xml", "amber14/tip4pew.xml"), app.Modeller(topology, x)
    modeller.addSolvent(field, model="tip4pew", numAdded=10)
    system = field.createSystem(modeller.topology, constraints=app.HBonds, removeCMMotion=False)
    held_to = reference_of(system, openmm.VerletIntegrator(0.001), modeller.positions)
    held_to.applyConstraints(1e-13)
    held_to.computeVirtualSites()
    make = nested("S2_2", 0.002)
    contexts = pair(system, positions_of(held_to), make)
    for context in contexts:
        context.getIntegrator().step(3)
    assert contexts[1].getIntegrator().getEngine() == "native"
    assert apart(*contexts) < 1e-12


def test_metadynamics_and_an_exchange_of_states_are_those_of_the_host():
    """Hills are added in the run, to a force that is no bonded one; then another replica's state is taken."""
    topology, system, x = peptide()
    _, others, _ = peptide()
    ends = []
    start = reference_of(others, openmm.VerletIntegrator(0.001), x, kelvin=300.0).getState(
        positions=True, velocities=True
    )
    for engine in ("host", "native"):
        own, torsion = openmm.XmlSerializer.clone(system), openmm.CustomTorsionForce("theta")
        torsion.addTorsion(6, 8, 14, 16)
        variable = app.BiasVariable(torsion, -np.pi, np.pi, 0.5, True)
        hills = app.Metadynamics(own, [variable], 300.0, 5.0, 20.0, 2)
        integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", fast="bonded", engine=engine)
        platform, properties = platform_for("native")
        simulation = app.Simulation(topology, own, integrator, platform, properties)
        simulation.context.setState(start)
        for _ in range(2):
            hills.step(simulation, 4)
            ends.append(held(simulation.context)[0])
            simulation.context.setState(start)
        assert integrator.getEngine() == engine
    np.testing.assert_allclose(ends[2:], ends[:2], rtol=0.0, atol=1e-10)
    assert np.abs(ends[0] - ends[1]).max() > 1e-6  # the hills act
