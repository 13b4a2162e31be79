"""Types of constraints are an argument of an integrator."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

import openmm_exactrb as rb
import starts
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.runs.identity import identity_of
from peptides import peptide

WATERS = rb.rigid_water(8)
MAKERS = {
    "plain": lambda h, **options: rb.ExactRigidBodyIntegrator(h, **options),
    "Langevin": lambda h, **options: rb.ExactRigidBodyLangevinIntegrator(300.0, 10.0, h, **options),
    "rescaling": lambda h, **options: rb.ExactRigidBodyRescalingIntegrator(300.0, 0.1, h, **options),
    "chain": lambda h, **options: rb.ExactRigidBodyNoseHooverIntegrator(300.0, 10.0, h, **options),
    "hybrid": lambda h, **options: rb.ExactRigidBodyHybridIntegrator(300.0, 10.0, h, **options),
}


def in_place(axes, chosen=slice(None)):
    """Return a type of constraint that keeps some centres from moving along some axes."""

    def constrain(free, bodies):
        columns = np.arange(len(bodies))[chosen]

        def held(array):
            array = array.copy()
            array[..., np.ix_(axes, columns)[0], np.ix_(axes, columns)[1]] = 0.0
            return array

        def tangent(state):
            return (along := free.tangent(state))._replace(P=held(along.P))

        def drift(state, tau):
            return free.drift(tangent(state), tau)

        def displaced(state, push):
            return free.displaced(state, held(push))

        lost = free.lost[0] + len(axes) * len(columns), free.lost[1]
        return replace(free, drift=drift, displaced=displaced, tangent=tangent, lost=lost)

    return constrain


ON_A_PLANE, ON_A_LINE, FIRST_STAYS = in_place([2]), in_place([0, 1]), in_place([0, 1, 2], [0])


def on_a_plane(free, bodies):
    """The same at the top of a module, where pickle finds it."""
    return ON_A_PLANE(free, bodies)


def run(integrator, n=10, start=WATERS, kelvin=300.0):
    """Return the state before and after n steps, and the Context."""
    context = starts.context_of(copy.deepcopy(start[1]), integrator, start[2])
    integrator.setVelocitiesToTemperature(kelvin, 1)
    before = integrator.bodyState()[1]
    integrator.step(n)
    return before, integrator.bodyState()[1], context


SETTINGS = {
    "Verlet": {"scheme": "S2_2"},
    "processed": {"scheme": "W2_1"},
    "high order": {"scheme": "SRKN4_6b"},
    "gradients": {"scheme": "Chin4A"},
}


@pytest.mark.parametrize("name", SETTINGS)
def test_constraints_hold_exactly_and_momenta_satisfy_them(name):
    integrator = rb.ExactRigidBodyIntegrator(0.001, constraints=[ON_A_PLANE], **SETTINGS[name])
    before, after, _ = run(integrator)
    np.testing.assert_array_equal(after.R[2], before.R[2])
    np.testing.assert_array_equal(after.P[2], 0.0)
    assert np.abs(after.R[:2] - before.R[:2]).min() > 0.0


@pytest.mark.parametrize("name", MAKERS)
def test_constraints_hold_with_every_thermostat(name):
    integrator = MAKERS[name](0.001, constraints=(ON_A_PLANE,))
    before, after, _ = run(integrator)
    np.testing.assert_array_equal(after.R[2], before.R[2])
    np.testing.assert_array_equal(after.P[2], 0.0)
    assert np.abs(after.R[:2] - before.R[:2]).min() > 0.0
    assert integrator.degreesOfFreedom() == (2 * 8, 3 * 8)


def test_several_constraints_act_together():
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", constraints=[ON_A_PLANE, ON_A_LINE])
    before, after, _ = run(integrator)
    np.testing.assert_array_equal(after.R, before.R)
    assert np.abs(after.q - before.q).max() > 1e-3
    assert integrator.degreesOfFreedom() == (0, 3 * 8)


def test_the_energy_is_conserved_on_the_constraint():
    """With the order of the scheme, because momenta across the constraint never count."""
    errors = []
    for n in (16, 32):
        integrator = rb.ExactRigidBodyIntegrator(0.016 / n, "S2_2", constraints=[ON_A_PLANE])
        _context = starts.context_of(copy.deepcopy(WATERS[1]), integrator, WATERS[2])
        integrator.setVelocitiesToTemperature(100.0, 1)
        state = integrator.bodyState()[1]
        integrator.setBodyState(BodyState(state.R, state.P * [[1.0], [1.0], [0.0]], state.q, state.m))
        begin = integrator.totalEnergy()
        integrator.step(n)
        errors.append((integrator.totalEnergy() - begin)._value)
    assert 1e-6 < abs(errors[0]) < 1.0
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_temperatures_count_the_remaining_degrees_of_freedom():
    """A thermostat that needs their number: the mean energy of each is kT/2."""
    system = starts.system_of([18.0] * 200)
    integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.01, 0.02, "S2_2", constraints=[ON_A_PLANE])
    integrator.setRandomNumberSeed(3)
    context = starts.context_of(system, integrator, np.arange(600.0).reshape(200, 3))
    integrator.setVelocitiesToTemperature(300.0, 1)
    temperatures, energies = [], []
    for _ in range(200):
        integrator.step(1)
        temperatures.append(integrator.temperatures()[0]._value)
        energies.append(context.getState(energy=True).getKineticEnergy()._value)
    error = 4.0 * 300.0 * np.sqrt(2.0 / (400 * 50))
    assert np.mean(temperatures) == pytest.approx(300.0, abs=error)
    assert np.mean(energies) == pytest.approx(0.5 * 400 * starts.R * 300.0, rel=error / 300.0)


@pytest.mark.parametrize("fast", ["bonded", (1,)])
def test_constraints_name_the_same_bodies_within_inner_steps(fast):
    """Bodies with and without fast forces: an atom of the water beside a peptide stays where it is."""
    _, system, x = peptide("None")
    n = system.getNumParticles()
    for mass in (16.0, 40.0):
        system.addParticle(mass)
        starts.force_of(system).addParticle(0.0, 0.3, 0.5)
    if fast != "bonded":
        rb.separate_bonded(system)
    start = None, system, np.vstack([x, [[3.0, 3.0, 3.0], [3.3, 3.0, 3.0]]])
    free = rb.ExactRigidBodyIntegrator(0.001, "S2_2", fast=fast)
    begin, without, _ = run(free, 3, start)
    bodies = free.bodyState()[0]
    chosen = [int(bodies.owner[n]), int(bodies.owner[n - 1])]  # beside the peptide, and within it
    held = rb.ExactRigidBodyIntegrator(0.001, "S2_2", fast=fast, constraints=[in_place([0, 1, 2], chosen)])
    _, after, _ = run(held, 3, start)
    others = np.setdiff1d(np.arange(len(bodies)), chosen)
    np.testing.assert_array_equal(after.R[:, chosen], begin.R[:, chosen])
    assert np.abs(after.R[:, others] - begin.R[:, others]).max(axis=0).min() > 0.0
    assert np.abs(without.R[:, chosen] - begin.R[:, chosen]).max(axis=0).min() > 0.0
    assert held.timings.fast_evaluations >= free.timings.fast_evaluations > 0


@pytest.mark.parametrize("fast", ["bonded", (1,)])
def test_a_constraint_that_holds_nothing_changes_no_trajectory_with_inner_steps(fast):
    _, system, x = peptide()
    if fast != "bonded":
        rb.separate_bonded(system)
    ends = []
    for constraints in ([], [lambda free, bodies: free]):
        integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", fast=fast, constraints=constraints)
        ends.append(run(integrator, 3, (None, system, x))[1])
    for one, other in zip(*ends, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-10)


def test_other_integrators_of_the_process_are_free():
    held = rb.ExactRigidBodyIntegrator(0.001, "S2_2", constraints=[ON_A_PLANE])
    before, after, _context = run(held)
    _, free, _ = run(rb.ExactRigidBodyIntegrator(0.001, "S2_2"))
    np.testing.assert_array_equal(after.R[2], before.R[2])
    assert np.abs(free.R[2] - before.R[2]).min() > 0.0
    held.step(3)
    np.testing.assert_array_equal(held.bodyState()[1].R[2], before.R[2])


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
@pytest.mark.parametrize("name", MAKERS)
def test_copies_keep_constraints(name, duplicate):
    integrator = MAKERS[name](0.001, constraints=[on_a_plane])
    twin = duplicate(integrator)
    assert twin.getSettings()["arguments"]["constraints"] == (on_a_plane,)
    before, after, _ = run(twin)
    np.testing.assert_array_equal(after.R[2], before.R[2])


def test_the_identity_of_a_run_contains_them():
    texts = []
    for constraints in ((), [on_a_plane]):
        integrator = rb.ExactRigidBodyIntegrator(0.001, engine="host", constraints=constraints)
        texts.append(identity_of(starts.simulation_of(*WATERS[:2], integrator, WATERS[2])))
    assert {name for name in texts[0] if texts[0][name] != texts[1][name]} == {"integrator constraints"}


@pytest.mark.parametrize("name", MAKERS)
def test_the_native_engine_does_not_serve_them_and_auto_says_so(name):
    with pytest.raises(ValueError, match="supports only constraints of the System, not <function on_a_plane"):
        MAKERS[name](0.001, constraints=[on_a_plane], engine="native")
    integrator = MAKERS[name](0.001, constraints=[on_a_plane])
    assert integrator.getEngine() == "host"
    assert "supports only constraints of the System" in integrator.engineNote()
