"""What a user changes is taken up however small it is: perturbations of Lyapunov exponents and responses are 1e-12."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from peptides import moving, peptide, positions_of
from places import platform_for
from starts import force_of, held

SMALL = 1e-12  # nm, nm/ps
BODY, ION = slice(3, 6), 6


@pytest.fixture(scope="module")
def system():
    """Two molecules of water and an ion, and positions."""
    _, system, positions = rb.rigid_water(2)
    nonbonded = force_of(system)
    nonbonded.addParticle(1.0, 0.25, 0.5)
    system.addParticle(23.0)
    return system, np.array([*positions._value, (0.3, 0.6, 0.3)])


def started(system, engine, scheme):
    system, positions = system
    integrator = rb.ExactRigidBodyIntegrator(0.001, scheme=scheme, engine=engine)
    context = openmm.Context(openmm.XmlSerializer.clone(system), integrator, *platform_for(engine))
    context.setPositions(positions)
    integrator.setVelocitiesToTemperature(300.0, 1)
    integrator.step(3)
    return context


def perturb(context):
    """Move a molecule, and push an ion, by `SMALL`."""
    x, v = held(context)
    x[BODY, 0] += SMALL
    v[ION, 1] += SMALL
    context.setPositions(x)
    context.setVelocities(v)


def loaded(context, how):
    """Return the Context with its own state loaded."""
    if how == "checkpoint":
        context.loadCheckpoint(context.createCheckpoint())
    elif how == "state":
        options = {"positions": True, "velocities": True, "integratorParameters": True}
        context.setState(context.getState(**options))
    return context


@pytest.mark.parametrize("how", ["stepped", "checkpoint", "state"])
@pytest.mark.parametrize(("engine", "scheme"), [("host", "S2_2"), ("host", "W2_1"), ("native", "S2_2")])
def test_changes_of_one_in_a_thousand_billion_are_taken_up(system, engine, scheme, how):
    context = loaded(started(system, engine, scheme), how)
    integrator = context.getIntegrator()
    _, before = integrator.bodyState()
    perturb(context)
    _, after = integrator.bodyState()
    moved, pushed = after.R - before.R, after.P - before.P
    assert moved[0, 1] == pytest.approx(SMALL, abs=2e-15)
    assert pushed[1, 2] == pytest.approx(23.0 * SMALL, abs=23.0 * 2e-15)
    np.testing.assert_array_equal(moved[:, [0, 2]], 0.0)
    np.testing.assert_array_equal(pushed[:, 0], 0.0)
    integrator.step(1)
    x, _ = held(context)
    assert np.isfinite(x).all()


@pytest.mark.parametrize("how", ["stepped", "checkpoint", "state"])
@pytest.mark.parametrize("scheme", ["S2_2", "W2_1"])
def test_what_nobody_touches_keeps_its_bits(system, scheme, how):
    """Though what the Context holds is rounded, and the state is not."""
    one, other = (started(system, "host", scheme) for _ in range(2))
    loaded(other, how)
    for context in (one, other):
        context.getIntegrator().step(5)
    np.testing.assert_array_equal(held(one), held(other))


@pytest.mark.parametrize("scheme", ["S2_2", "W2_1", "W4_4"])
def test_the_response_to_a_small_change_is_linear(system, scheme):
    """A displacement of 1e-12 grows as one of 1e-10 does, a hundredfold smaller, beside a run that nobody touched.

    So the inner state of a processed scheme follows it: through what was shown it would be off by far more.
    """
    ends = []
    for size in (0.0, 1e-12, 1e-10):
        context = started(system, "host", scheme)
        x, _ = held(context)
        x[ION, 0] += size
        context.setPositions(x)
        context.getIntegrator().step(20)
        ends.append(held(context)[0])
    small, large = (end - ends[0] for end in ends[1:])
    assert np.abs(1e2 * small - large).max() < 0.02 * np.abs(large).max()


@pytest.mark.parametrize("fast", ["bonded", None])
@pytest.mark.parametrize("scheme", ["S2_2", "W2_1", "W4_4"])
def test_the_response_of_a_molecule_with_constraints_is_linear_with_and_without_inner_steps(scheme, fast):
    """Momenta of a state within inner steps have a part along constraints, which a user's positions do not."""
    _, molecule, x = peptide()
    ends, evaluations = [], []
    for size in (0.0, 1e-12, 1e-10):
        integrator, context = moving(molecule, x, 0.001, scheme, fast=fast)
        integrator.step(5)
        if size:
            context.setPositions(positions_of(context) + np.array([size, 0.0, 0.0]) * (np.arange(len(x)) % 2)[:, None])
            context.setVelocities(held(context)[1] + np.array([0.0, size, 0.0]))
        integrator.timings.reset()
        integrator.step(1)
        ends.append(positions_of(context))
        evaluations.append(integrator.timings.evaluations)
    small, large = (end - ends[0] for end in ends[1:])
    assert len(set(evaluations)) == 1
    assert np.abs(1e2 * small - large).max() < 0.02 * np.abs(large).max()
