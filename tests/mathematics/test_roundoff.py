"""The error of a long run is that of the scheme and of roundoff without a bias, and a run can be turned back."""

import numpy as np
import pytest
from mpmath import mp
from openmm import app

import openmm_exactrb as rb
import oracle
from benchmarks.common.starts import context_of
from benchmarks.paper import problems
from benchmarks.schemes import roundoff
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.rotors import rotor_of_sums
from places import REFERENCE

# -- the flow -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["exact_numpy", "exact"])
@pytest.mark.parametrize("h", [0.1, 1e-2, 1e-4])
def test_the_roundoff_of_a_short_step_is_that_of_its_change(method, h):
    n = 12
    inertia, m = oracle.random_bodies("generic", n, seed=3)
    q = quaternions.random(np.random.default_rng(1), n)
    t = h / np.linalg.norm(m / inertia, axis=1)
    sums = rotor_of_sums(method, inertia)(*(exactly(np.ascontiguousarray(x.T)) for x in (q, m)), t)
    with mp.workdps(40):
        for k in range(n):
            q1, m1 = ([mp.mpf(high) + mp.mpf(low) for high, low in zip(*x[:, :, k], strict=True)] for x in sums)
            Q_exact, m_exact = oracle.free_rotor(inertia[k], q[k], m[k], t[k])
            Q = oracle.rotation_matrix(q1, normalise=True)
            error = max(abs(Q[i, j] - Q_exact[i, j]) for i in range(3) for j in range(3))
            assert error < 1e-15 * h
            assert max(abs(a - b) for a, b in zip(m1, m_exact, strict=True)) < 1e-15 * h * np.linalg.norm(m[k])


# -- Brouwer's law --------------------------------------------------------------------------------------------------


def rms(records):
    return np.sqrt((records**2).mean(axis=0))


def assert_random_walk(errors, steps):
    """The errors grow as the root of the steps, and their mean is that of walks without a direction (four sigma)."""
    assert 0.35 < roundoff.exponent(steps, rms(errors), steps[-1] / 1000) < 0.65
    assert abs(errors[:, -1].mean()) < 4.0 * rms(errors)[-1] / np.sqrt(len(errors))


def test_sums_keep_energy_and_direction_of_tops_better_than_rounding():
    """Over four seeds, by factors of 300 to 490 and of 59 to 98."""
    errors = {variant: roundoff.tops(0, variant, 500) for variant in ("sums", "rounded")}
    for quantity, factor in (("energy", 150.0), ("direction", 30.0)):
        assert rms(errors["sums"][quantity])[-1] < 1e-16
        assert rms(errors["rounded"][quantity])[-1] > factor * rms(errors["sums"][quantity])[-1]


def test_sums_keep_the_momenta_of_dipoles_better_than_rounding():
    errors = {variant: roundoff.dipoles(1, variant, 100) for variant in ("sums", "rounded")}
    for quantity in roundoff.QUANTITIES:
        assert np.abs(errors["sums"][quantity]).max() < 2e-15
        assert np.abs(errors["rounded"][quantity][0, -1]) > 2.0 * np.abs(errors["sums"][quantity][0, -1])


def test_forces_on_dipoles_have_no_mean_torque():
    """Rounding gives every evaluation a torque of 2e-14; where its mean is not zero, the angular momentum drifts.

    With virtual sites of weights 1/3 the sum below is 30 and more.
    """
    system, *start = roundoff.dipoles_of(1)
    context = context_of(system, rb.ExactRigidBodyIntegrator(0.001, scheme="V2"), tuple(start), "Reference")
    massive = [i for i in range(system.getNumParticles()) if not system.isVirtualSite(i)]
    torques = []
    for _ in range(300):
        context.getIntegrator().step(1)
        state = context.getState(positions=True, forces=True)
        x, F = (values(asNumpy=True)._value[massive] for values in (state.getPositions, state.getForces))
        torques.append(np.cross(x.astype(np.longdouble), F).sum(axis=0))
    means, errors = np.mean(torques, axis=0), np.std(torques, axis=0) / len(torques) ** 0.5
    assert np.sum((means / errors) ** 2) < 20.0  # 3 on average


@pytest.mark.validate
def test_tops_over_a_million_steps():
    steps, records = roundoff.recorded_steps(1_000_000), roundoff.tops(0, "sums", 1_000_000)
    for quantity in ("energy", "direction"):
        assert rms(records[quantity])[-1] < 1e-13
        assert_random_walk(records[quantity], steps)


@pytest.mark.validate
def test_dipoles_over_a_hundred_thousand_steps():
    steps, records = roundoff.recorded_steps(100_000), [roundoff.dipoles(k, "sums", 100_000) for k in range(8)]
    for quantity in roundoff.QUANTITIES:
        errors = rms(np.concatenate([record[quantity] for record in records]))
        assert errors.max() < 3e-14
        assert roundoff.exponent(steps, errors, 100) == pytest.approx(0.5, abs=0.15)


# -- reversibility --------------------------------------------------------------------------------------------------


THOUSANDS = pytest.mark.parametrize("n", [2_000, pytest.param(10_000, marks=pytest.mark.validate)])


@THOUSANDS
def test_thousands_of_steps_of_tops_and_back(n):
    """A potential a thousandth of the kinetic energy leaves the tops almost integrable."""
    top, (q, m) = problems.HeavyTop.random(np.random.default_rng(3), 1e-3, 1.0, 8)
    scheme = rb.SCHEMES["S2_2"]
    q1, m1 = problems.integrate(top, (q, m), 0.02, n, scheme)
    assert np.abs(m1 - m).max() > 0.1
    q2, m2 = problems.integrate(top, (q1, -m1), 0.02, n, scheme)
    np.testing.assert_allclose(-m2, m, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(
        quaternions.rotation_matrix(q2.T), quaternions.rotation_matrix(q.T), rtol=0.0, atol=1e-10
    )


@THOUSANDS
def test_thousands_of_steps_of_dipoles_and_back(n):
    """A cold cluster swings about its minimum, almost as a harmonic oscillator: it is not chaotic."""
    topology, system, positions = rb.dipole_fluid(4, seed=2, trap=0.5)
    simulation = app.Simulation(topology, system, rb.ExactRigidBodyIntegrator(0.02, scheme="V2"), REFERENCE)
    context, integrator = simulation.context, simulation.integrator
    context.setPositions(positions)
    simulation.minimizeEnergy(tolerance=1e-4)
    integrator.setVelocitiesToTemperature(0.1, 1)
    _, start = integrator.bodyState()
    integrator.step(n)
    _, there = integrator.bodyState()
    assert np.abs(there.R - start.R).max() > 1e-3
    context.setVelocities(-context.getState(velocities=True).getVelocities(asNumpy=True))
    integrator.step(n)
    _, back = integrator.bodyState()
    for a, b in zip(back, (start.R, -start.P, start.q, -start.m), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-10)
