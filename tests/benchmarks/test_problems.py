"""Problems: torques are the derivative of the energy, and the paper's numbers come out."""

import numpy as np
import pytest

import openmm_exactrb as rb
from benchmarks.paper.problems import HeavyTop, Satellite, integrate, kinetic_energy
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mathematics.compensated import exactly


@pytest.fixture(params=["top", "satellite"])
def problem(request, rng):
    inertia = rng.uniform(1.0, 3.0, (3, 10))
    if request.param == "satellite":
        return Satellite(inertia)
    u = rng.standard_normal((3, 10))
    return HeavyTop(inertia, 1e-3, u / np.linalg.norm(u, axis=0))


def force_gradient_potential(problem):
    def potential(q):
        f = problem.torque(q)
        return (f * f / problem.inertia).sum(axis=0)

    return potential


@pytest.mark.parametrize("gradient", [False, True], ids=["force", "force gradient"])
def test_torque_is_minus_the_derivative_of_the_potential(problem, rng, gradient):
    q = np.ascontiguousarray(quaternions.random(rng, 10).T)
    potential = force_gradient_potential(problem) if gradient else problem.potential
    torque, d = (problem.gradient_torque if gradient else problem.torque)(q), 1e-4
    for axis in range(3):
        turned = []
        for angle in (-2 * d, -d, d, 2 * d):
            turn = np.zeros((4, 1))
            turn[0], turn[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
            turned.append(potential(quaternions.multiply(q, turn)))
        slope = (turned[0] - 8 * turned[1] + 8 * turned[2] - turned[3]) / (12 * d)
        np.testing.assert_allclose(torque[axis], -slope, rtol=0.0, atol=1e-10 * np.abs(torque).max())


@pytest.mark.parametrize("epsilon", [1e-3, 1e-6])
@pytest.mark.parametrize("power", [2, 1, 0, -1, -2])
def test_random_tops_start_as_the_paper_says(rng, epsilon, power):
    top, (q, m) = HeavyTop.random(rng, epsilon, epsilon**power, 50)
    np.testing.assert_allclose(kinetic_energy(top.inertia, m), epsilon**power, rtol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(top.direction, axis=0), 1.0, rtol=1e-15)
    assert (top.inertia[0] == 1.0).all()
    assert (np.diff(top.inertia, axis=0) > 0.0).all()
    assert (top.inertia[2] < top.inertia[0] + top.inertia[1]).all()
    assert (q == [[1.0], [0.0], [0.0], [0.0]]).all()
    assert (np.abs(top.potential(q)) <= epsilon).all()


@pytest.mark.parametrize("name", ["V2", "V2_C17"])
def test_no_step_leaves_the_state_as_it_is(name):
    satellite, state = Satellite.paper()
    for now, then in zip(integrate(satellite, state, 0.1, 0, rb.SCHEMES[name]), state, strict=True):
        np.testing.assert_array_equal(now, then)
    sums = tuple(map(exactly, state))
    for now, then in zip(integrate(satellite, sums, 0.1, 0, rb.SCHEMES[name]), sums, strict=True):
        assert not np.shares_memory(now, then)
