"""The paper's formulations of the exact flow: errors against 30 digits, and what they do where they are singular."""

import numpy as np
import pytest

import openmm_exactrb as rb
import oracle
from openmm_exactrb import quaternions
from openmm_exactrb.rotors import euler

EXACT = ["rotation", "quaternion_a", "quaternion_b", "quaternion_c"]
GAUSS = [f"{name}_gauss{order}" for name in ("rotation", "quaternion") for order in (6, 8, 10)]
STEPS = {"short": (1e-6, 0.3), "long": (0.3, 1e2)}


def random_steps(regime, steps, n):
    """Return inertia, q, m, t and the angles h omega of random bodies and steps."""
    inertia, m = oracle.random_bodies(regime, n, seed=3)
    rng = np.random.default_rng(n)
    rate = np.exp(rng.uniform(*np.log(STEPS[steps]), n))
    omega = np.linalg.norm(m / inertia, axis=1)
    t = rng.choice([-1.0, 1.0], n) * rate / np.where(omega > 0.0, omega, 1.0)
    return inertia, quaternions.random(rng, n), m, t, rate


def condition(inertia, m, rate):
    """Return by how much the formulas of the paper enlarge roundoff.

    The angle is b/lambda times the difference of two integrals of the third kind, each of which grows as the quarter
    period log(16/kc²)/2. The separatrix distance S, a difference, has a relative error of eps/S; from half a turn on
    it shifts the phase, which grows with the turns.
    """
    out = np.ones(len(m))
    inertia, m = np.sort(inertia, axis=1).T, np.take_along_axis(m, np.argsort(inertia, axis=1), 1).T
    covered = euler.is_regular(inertia, m)
    inertia, x = inertia[:, covered], np.abs(m[:, covered] / np.linalg.norm(m[:, covered], axis=0))
    orbit = euler.solve(inertia, x, np.zeros(x.shape[1]))
    b = 1.0 / inertia[0] - 1.0 / inertia[2]
    period = np.log(16.0 / orbit.kc2)
    rounding = orbit.kc2 + orbit.after.cn**2
    shift = np.where(rate[covered] > 1.0, rate[covered] * np.minimum(rounding, 1.0) / orbit.kc2, 0.0)
    out[covered] += b / orbit.rate * period + shift
    return out


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("regime", oracle.REGIMES)
def test_error_is_roundoff_times_the_condition(regime, steps):
    n = 30
    inertia, q, m, t, rate = random_steps(regime, steps, n)
    reference = [oracle.free_rotor(*body) for body in zip(inertia, q, m, t, strict=True)]
    for method in EXACT:
        q1, m1 = rb.free_rotor(inertia, q, m, t, method=method)
        errors = np.array([error(*body) for body in zip(reference, m, q1, m1, strict=True)])
        allowed = 1e-16 * (20.0 + 20.0 * rate) * condition(inertia, m, rate)
        print(f"XX {regime:24s} {steps:6s} {method:14s} {errors.max():.1e} {(errors / allowed).max():.3f} cond {np.median(condition(inertia, m, rate)):.0f}")


def error(reference, m, q1, m1):
    Q, momentum = reference
    rotation = np.array(Q.tolist(), dtype=np.float64) - quaternions.rotation_matrix(q1)
    norm = np.linalg.norm(m) or 1.0
    return max(np.abs(rotation).max(), np.abs(np.array(momentum, dtype=np.float64) - m1).max() / norm)
