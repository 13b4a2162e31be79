"""The reference of the accuracy tests is right: it solves the differential equations."""

import mpmath as mp
import numpy as np
import pytest

import oracle

FEW = "generic", "separatrix at 1e-08", "on the separatrix", "I1 = I2", "thin"
MORE = [pytest.param(regime, marks=pytest.mark.validate) for regime in oracle.REGIMES if regime not in FEW]


@pytest.mark.parametrize("regime", [*FEW, *MORE])
def test_oracle_solves_the_differential_equations(regime, pytestconfig):
    inertia, m = oracle.random_bodies(regime, 2 if pytestconfig.getoption("--validate") else 1, seed=7)
    rng = np.random.default_rng(3)
    for I, m0 in zip(inertia, m, strict=True):
        q, rate = rng.standard_normal(4), max(1.0, np.linalg.norm(m0 / I))
        t = float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 6.0) / rate)
        Q, m1 = oracle.free_rotor(I, q, m0, t)
        with mp.workdps(oracle.DIGITS + 15):
            Q_taylor, m_taylor = oracle.taylor(I, q, m0, t)
            assert mp.norm(Q - Q_taylor, mp.inf) < 1e-30
            assert max(abs(a - b) for a, b in zip(m1, m_taylor, strict=True)) < 1e-30


@pytest.mark.parametrize("regime", ["generic", "separatrix at 1e-08", "within 1e-06 of axis 2", "thin"])
def test_oracle_obeys_the_group_law_over_many_turns(regime):
    (I,), (m0,) = oracle.random_bodies(regime, 1, seed=8)
    with mp.workdps(90):
        s, t = mp.mpf(700.25), mp.mpf(-313.5)
        Q1, m1 = oracle.free_rotor(I, [1.0, 0.0, 0.0, 0.0], m0, s, digits=60)
        Q2, m2 = oracle.free_rotor(I, [1.0, 0.0, 0.0, 0.0], m1, t, digits=60)
        Q, m = oracle.free_rotor(I, [1.0, 0.0, 0.0, 0.0], m0, s + t, digits=60)
        assert mp.norm(Q1 * Q2 - Q, mp.inf) < 1e-30
        assert max(abs(a - b) for a, b in zip(m, m2, strict=True)) < 1e-30
