"""The laws of a splitting through OpenMM, for a few pairings: the loop is one, and tops go through all of them."""

import numpy as np
import openmm
import pytest

import charts
import openmm_exactrb as rb
import starts
from few_dipoles import energies, simulation_of, snapshot
from openmm_exactrb.mechanics.state import BodyState
from orders import slope
from places import REFERENCE

pytestmark = pytest.mark.usefixtures("every_engine")

#: Kick first and drift first, low and high order, exact and not.
FEW = [("V2", "mclachlan_reich"), ("SRKN4_6b", "exact"), pytest.param(("S6_10", "exact"), marks=pytest.mark.validate)]
PROCESSED = ("V2_C17", "exact")


def name_of(pairing):
    return "-".join(pairing)


@pytest.fixture(params=FEW, ids=name_of)
def few(request):
    return request.param


@pytest.fixture(params=[*FEW, PROCESSED], ids=name_of)
def few_and_processed(request):
    return request.param


def test_the_state_of_the_context_is_that_of_the_bodies(few_and_processed):
    simulation = simulation_of(scheme=few_and_processed[0], rotor=few_and_processed[1])
    simulation.step(7)
    potential, kinetic = energies(simulation)
    translational, rotational = simulation.integrator.kineticEnergies()
    assert kinetic == pytest.approx(translational._value + rotational._value, rel=1e-13)
    fresh = openmm.Context(simulation.system, openmm.VerletIntegrator(0.001), REFERENCE)
    x, _ = snapshot(simulation)
    fresh.setPositions(x)
    fresh.computeVirtualSites()
    assert potential == pytest.approx(fresh.getState(energy=True).getPotentialEnergy()._value, rel=1e-13)
    np.testing.assert_allclose(fresh.getState(positions=True).getPositions(asNumpy=True)._value, x, atol=1e-15)
    assert simulation.context.getTime()._value == pytest.approx(0.14, rel=1e-12)
    assert simulation.context.getStepCount() == simulation.currentStep == 7


def test_step_ten_times_ten_is_step_a_hundred_to_the_bit(few):
    once, often = (simulation_of(4, scheme=few[0], rotor=few[1]) for _ in range(2))
    once.integrator.step(100)
    for _ in range(10):
        often.integrator.step(10)
    for a, b in zip(snapshot(once), snapshot(often), strict=True):
        np.testing.assert_array_equal(a, b)


def test_turned_velocities_bring_the_start_back(few):
    simulation = simulation_of(scheme=few[0], rotor=few[1])
    simulation.step(1)
    x, v = snapshot(simulation)
    simulation.integrator.step(50)
    simulation.context.setVelocities(-snapshot(simulation)[1])
    simulation.integrator.step(50)
    x_back, v_back = snapshot(simulation)
    np.testing.assert_allclose(x_back, x, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(v_back, -v, rtol=0.0, atol=1e-9)


# Steps a unit of time at which errors are asymptotic and above roundoff.
STEPS = {"V2": 100, "V2_C17": 120, "SRKN4_6b": 60, "S6_10": 42}


def test_measured_order_is_the_declared_one(few_and_processed):
    scheme, rotor = few_and_processed
    order = rb.SCHEMES[scheme].order

    def end(n):
        simulation = simulation_of(h=1.0 / n, scheme=scheme, rotor=rotor, spacing=1.4)
        simulation.integrator.step(n)
        return simulation.integrator.bodyState()[1].R

    assert abs(slope(end, [round(STEPS[scheme] * factor) for factor in (1.0, 1.3, 1.7)]) - order) < 0.35


def test_momenta_of_an_isolated_droplet_are_kept(few_and_processed):
    scheme, rotor = few_and_processed
    simulation = simulation_of(scheme=scheme, rotor=rotor, trap=0.0)

    def momenta():
        _, state = simulation.integrator.bodyState()
        spin = np.einsum("ijn,jn->i", rb.mathematics.quaternions.matrix(state.q), state.m)
        return np.concatenate([state.P.sum(1), spin + np.cross(state.R.T, state.P.T).sum(0)])

    start = momenta()
    simulation.integrator.step(100)
    np.testing.assert_allclose(momenta(), start, rtol=0.0, atol=1e-12)


def test_higher_orders_keep_the_energy_better():
    """At the same number of force evaluations: the reason for this package."""
    errors = {}
    for name, rotor, h in (("V2", "mclachlan_reich", 0.02 / 6), ("SRKN4_6b", "exact", 0.02)):
        simulation = simulation_of(27, h=h, scheme=name, rotor=rotor)
        start, worst = sum(energies(simulation)), 0.0
        for _ in range(20):
            simulation.integrator.step(round(0.1 / h))
            worst = max(worst, abs(sum(energies(simulation)) / start - 1.0))
        errors[name] = worst
    assert errors["SRKN4_6b"] < errors["V2"] / 20


def test_a_step_in_openmm_is_symplectic(few_and_processed):
    """The Jacobian of a step of two dipoles keeps the symplectic form."""
    scheme, rotor = few_and_processed
    topology, system, positions = rb.dipole_fluid(2, seed=1, spacing=1.4)
    integrator = rb.ExactRigidBodyIntegrator(0.05, scheme=scheme, rotor=rotor)
    _simulation = starts.simulation_of(topology, system, integrator, positions)
    integrator.setVelocitiesToTemperature(50.0, 1)
    _, start = integrator.bodyState()

    def after(state):
        integrator.setBodyState(state)
        integrator.step(1)
        return integrator.bodyState()[1]

    def state(x):
        centres, turning = x.reshape(4, 6)[:2], x.reshape(4, 6)[2:]
        turned = [charts.state_at(start.q[:, k : k + 1], turning[k]) for k in range(2)]
        R, P = (np.ascontiguousarray(part.T) for part in np.hsplit(centres, 2))
        return BodyState(R, P, *(np.concatenate(parts, axis=1) for parts in zip(*turned, strict=True)))

    def coordinates(state, q_ref):
        turning = [
            charts.coordinates_of(q_ref[:, k : k + 1], state.q[:, k : k + 1], state.m[:, k : k + 1]) for k in range(2)
        ]
        return np.concatenate([*np.hstack([state.R.T, state.P.T]), *turning])

    end, x0 = after(start), coordinates(start, start.q)
    J = charts.jacobian(lambda x: np.stack([coordinates(after(state(column)), end.q) for column in x.T], axis=1), x0)
    assert charts.symplectic_defect(J) < 1e-8
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(J, np.eye(24), rtol=0.0, atol=1e-2)
