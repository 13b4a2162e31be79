"""Whatever steps have OpenMM evaluate is counted, and energies are compared only where a user wants it."""

import copy
import pickle

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.context import outside_forces
from openmm_exactrb.steps.substeps import Substep
from starts import context_of

pytestmark = pytest.mark.usefixtures("host_is_advised")


def counted(integrator, barostat=None, n=8, energy=0.05):
    """Return a Context of dipoles in a trap that counts its evaluations, and the list that grows with each."""
    _, system, positions = rb.dipole_fluid(n, seed=1)
    calls = []

    def trap(state):
        calls.append(None)
        x = state.getPositions(asNumpy=True)._value
        return energy * float((x * x).sum()), -0.1 * x

    force = openmm.PythonForce(trap)
    if barostat is not None:
        force.setUsesPeriodicBoundaryConditions(True)
        system.setDefaultPeriodicBoxVectors(*(4.0 * np.eye(3)))
        barostat.setRandomNumberSeed(3)
        system.addForce(barostat)
    system.addForce(force)
    context = context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(20.0, 1)
    return context, calls


def barostats():
    stretched = openmm.MonteCarloAnisotropicBarostat(openmm.Vec3(1.0, 1.0, 1.0), 300.0, True, True, False, 2)
    return [
        openmm.MonteCarloBarostat(1.0, 300.0, 2),
        stretched,
        openmm.MonteCarloMembraneBarostat(1.0, 1.0, 300.0, 0, 0, 3),
        openmm.MonteCarloFlexibleBarostat(1.0, 300.0, 3),
    ]


@pytest.mark.parametrize("barostat", [None, *barostats()], ids=lambda force: type(force).__name__)
@pytest.mark.parametrize(
    "maker",
    [
        lambda: rb.ExactRigidBodyIntegrator(0.01, "S2_2"),
        lambda: rb.ExactRigidBodyIntegrator(0.01, "W2_1"),
        lambda: rb.ExactRigidBodyIntegrator(0.01, "W4_4"),
        lambda: rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.01),
        lambda: rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, 0.05),
    ],
    ids=["S2_2", "W2_1", "W4_4", "Langevin", "hybrid"],
)
def test_every_evaluation_is_counted(maker, barostat):
    integrator = maker()
    context, calls = counted(integrator, copy.copy(barostat))
    for _ in range(3):
        integrator.timings.reset()
        calls.clear()
        integrator.step(7)
        assert integrator.timings.evaluations == len(calls)
    assert context.getStepCount() == 21


def test_energies_of_the_check_for_divergence_are_counted(monkeypatch):
    monkeypatch.setattr("openmm_exactrb.engines.host.propagator.conserve_energy", lambda system: True)
    numbers = []
    for check in (True, False):
        integrator = rb.ExactRigidBodyIntegrator(0.01, "S2_2", checkDivergence=check)
        _, calls = counted(integrator)
        calls.clear()
        integrator.setBodyState(integrator.bodyState()[1]._replace(P=np.zeros((3, 8)), m=np.zeros((3, 8))))
        integrator.step(7)
        assert integrator.timings.evaluations == len(calls)
        numbers.append(len(calls))
    assert numbers[0] > numbers[1] == 7 * 2 + 1


def driven(check=True, force=True):
    """Return an integrator of a particle that a force, or a parameter, drives from rest."""
    system = openmm.System()
    system.addParticle(1.0)
    if force:
        system.addForce(openmm.PythonForce(lambda state: (0.0, np.array([[50.0, 0.0, 0.0]]))))
    integrator = rb.ExactRigidBodyIntegrator(0.01, "S2_2", checkDivergence=check)
    context = context_of(system, integrator, [(0.0, 0.0, 0.0)])
    return integrator, context


def test_the_dipoles_of_the_package_conserve_energy_and_other_functions_may_not():
    system = rb.dipole_fluid(2)[1]
    assert outside_forces.conserve_energy(system)
    system.addForce(openmm.PythonForce(len))
    assert not outside_forces.conserve_energy(system)


def test_a_force_without_an_energy_may_drive():
    integrator, context = driven()
    integrator.step(100)
    v = context.getState(velocities=True).getVelocities(asNumpy=True)._value
    assert v[0, 0] == pytest.approx(50.0)


class Motor(Substep):
    """An active particle's propulsion."""

    symbol, moves = "M", False

    def bind(self, environment):
        return lambda state, tau: state._replace(P=state.P + np.array([50.0 * tau, 0.0]).reshape(2, 1, 1))


def test_the_comparison_of_energies_can_be_switched_off():
    scheme = rb.schemes.Scheme("active", 1, ((Motor(), 1.0), *rb.SCHEMES["V2"].sequence))
    integrator = rb.ExactRigidBodyIntegrator(0.01, scheme)
    system = openmm.System()
    system.addParticle(1.0)
    context = context_of(system, integrator, [(0.0, 0.0, 0.0)])
    with pytest.raises(rb.IntegrationError, match="total energy"):
        integrator.step(1)
    integrator.checkDivergence = False
    integrator.step(10)
    assert context.getStepCount() == 10
    context.setVelocities([(np.inf, 0.0, 0.0)])
    with pytest.raises(ValueError, match="not finite"):
        integrator.step(1)


@pytest.mark.parametrize("twin_of", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_the_switch_is_a_setting_that_copies_have(twin_of):
    assert rb.ExactRigidBodyIntegrator(0.01).checkDivergence
    for maker in (rb.ExactRigidBodyHybridIntegrator, rb.ExactRigidBodyLangevinIntegrator):
        assert not twin_of(maker(300.0, 1.0, 0.01, checkDivergence=False)).checkDivergence
    with pytest.raises(ValueError, match="checkDivergence must be True or False, not 'no'"):
        rb.ExactRigidBodyIntegrator(0.01, checkDivergence="no")
