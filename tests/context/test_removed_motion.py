"""A CMMotionRemover where something pushes the centre of mass: the energy errs at first order."""

import warnings

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.errors import RemovedMotionWarning
from places import REFERENCE


def droplet(remover, frozen=False, trapped=False, waters=8):
    """Return a System of rigid waters, the first of which is frozen, and positions."""
    _, system, positions = rb.rigid_water(waters)
    if frozen:
        for k in reversed(range(system.getNumConstraints())):
            if min(system.getConstraintParameters(k)[:2]) < 3:
                system.removeConstraint(k)
        for i in range(3):
            system.setParticleMass(i, 0.0)
    if trapped:
        trap = openmm.CustomExternalForce("50*(x^2+y^2+z^2)")
        for i in range(0, system.getNumParticles(), 3):
            trap.addParticle(i)
        system.addForce(trap)
    if remover:
        system.addForce(openmm.CMMotionRemover())
    return system, positions


def spread(remover, h, **options):
    """Return the standard deviation of the total energy (kJ/mol)."""
    system, positions = droplet(remover, **options)
    integrator = rb.ExactRigidBodyIntegrator(h, "S2_2")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    energies = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RemovedMotionWarning)
        integrator.setVelocitiesToTemperature(100.0, 1)
        for _ in range(40):
            integrator.step(round(0.004 / h))
            energies.append(integrator.totalEnergy()._value)
    del context
    return np.std(energies)


@pytest.mark.parametrize("pushed", [{"frozen": True}, {"trapped": True}], ids=str)
@pytest.mark.parametrize(("remover", "order"), [(False, 2.0), (True, 1.0)], ids=["without", "remover"])
def test_the_remover_lowers_the_order_of_the_energy(pushed, remover, order):
    found = [spread(remover, h, **pushed) for h in (0.002, 0.001, 0.0005)]
    np.testing.assert_allclose(-np.diff(np.log2(found)), order, atol=0.15)


def test_frozen_particles_are_pointed_out_once():
    system, positions = droplet(True, frozen=True)
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    message = r"that frozen particles .mass 0. transfer.*removeCMMotion=False"
    with pytest.warns(RemovedMotionWarning, match=message) as said:
        integrator.step(1)
    assert len(said) == 1
    integrator.step(1)  # warnings are errors here
    integrator.temperatures()


@pytest.mark.parametrize("options", [{"remover": True}, {"remover": False, "frozen": True}], ids=str)
def test_elsewhere_nothing_is_said(options):
    """Warnings are errors here."""
    system, positions = droplet(**options)
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    integrator.step(1)


def test_virtual_sites_are_not_frozen():
    _, system, positions = rb.dipole_fluid(4, seed=1)
    system.addForce(openmm.CMMotionRemover())
    integrator = rb.ExactRigidBodyIntegrator(0.01)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    integrator.step(1)
    assert any(map(system.isVirtualSite, range(system.getNumParticles())))
