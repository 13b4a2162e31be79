"""The flow of a Nosé-Hoover chain: order, reversal, measure."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from chains import FREQUENCY, chain_of, nose_hoover, stirred
from openmm_exactrb.context import variables
from openmm_exactrb.openmm_access.units import gas_constant_times
from openmm_exactrb.thermostats.nose_hoover import WEIGHTS
from orders import exponent
from thermostatted import (
    KT,
    molecules,
    simulation_of,
)

# -- the flow of a chain ----------------------------------------------------------------------------------------------


REPEATED = (24, 34, 48)


def equations(chain, freedom):
    """Return the equations of motion of Martyna, Klein and Tuckerman (1992) for (log of momenta, x, v), from masses."""
    Q, kT, n = chain.masses(freedom), gas_constant_times(chain.temperature), chain.chainLength

    def rate(kinetic, y):
        v = y[1 + n :]
        heat = np.append(2.0 * kinetic * np.exp(2.0 * y[0]) - freedom * kT, Q[:-1] * v[:-1] ** 2 - kT)
        return np.concatenate([[-v[0]], v, heat / Q - v * np.append(v[1:], 0.0)])

    return rate


@pytest.mark.parametrize(("number", "order"), [(1, 2), (3, 4), (5, 4), (7, 6)])
@pytest.mark.parametrize("length", [1, 4])
def test_the_flow_has_the_order_of_its_weights(number, order, length, rng):
    chain, freedom, kinetic, tau = chain_of(chainLength=length), 7, 15.0, 0.1
    begin = stirred(chain, rng)
    rate = equations(chain, freedom)
    exact = solve_ivp(
        lambda t, y: rate(kinetic, y), (0.0, tau), [0.0, *begin.ravel()], "DOP853", rtol=1e-13, atol=1e-13
    ).y[:, -1]
    errors = []
    for repeated in REPEATED:
        scale, moved = chain_of(chainLength=length, numMTS=repeated, numYoshidaSuzuki=number).moved(
            begin, kinetic, freedom, tau
        )
        errors.append(np.abs(np.array([math.log(scale), *moved.ravel()]) - exact).max())
    assert min(errors) > 1e-9  # not of rounding
    assert abs(exponent(REPEATED, errors) + order) < 0.35


def test_weights_fulfil_the_conditions_of_their_order():
    for number, weights in WEIGHTS.items():
        assert len(weights) == number
        assert weights == weights[::-1]
        powers = [math.fsum(w**k for w in weights) for k in (1, 3, 5)]
        conditions = {1: 1, 3: 2, 5: 2, 7: 3}[number]
        np.testing.assert_allclose(powers[:conditions], [1.0, 0.0, 0.0][:conditions], atol=1e-14)


def test_repetitions_are_flows_one_after_the_other(rng):
    begin, kinetic, tau = stirred(chain_of(), rng), 9.0, 0.02
    at_once, moved = chain_of(numMTS=4).moved(begin, kinetic, 6, tau)
    total, chain = 1.0, begin
    for _ in range(4):
        scale, chain = chain_of(numMTS=1).moved(chain, kinetic * total**2, 6, tau / 4)
        total *= scale
    assert total == pytest.approx(at_once, rel=1e-13)
    np.testing.assert_allclose(chain, moved, rtol=1e-12)


@pytest.mark.parametrize("number", WEIGHTS)
def test_the_time_backwards_leads_back(number, rng):
    chain, kinetic, tau = chain_of(chainLength=5, numYoshidaSuzuki=number), 9.0, 0.05
    begin = stirred(chain, rng)
    scale, there = chain.moved(begin, kinetic, 6, tau)
    back, here = chain.moved(there, kinetic * scale**2, 6, -tau)
    assert abs(scale - 1.0) > 0.1
    assert scale * back == pytest.approx(1.0, rel=1e-13)
    np.testing.assert_allclose(here, begin, rtol=1e-11)


@pytest.mark.parametrize("number", WEIGHTS)
@pytest.mark.parametrize("length", [1, 3])
def test_the_measure_of_the_extended_phase_space_is_kept(number, length, rng):
    """exp(f x_1 + x_2 + ...) d^f p d^n x d^n v: by coarse substeps too, of which the trajectory is a poor one."""
    chain, f, tau = chain_of(chainLength=length, numMTS=1, numYoshidaSuzuki=number), 3, 0.03
    begin = np.concatenate([2.0 * rng.standard_normal(f), stirred(chain, rng).ravel()])

    def flow(y):
        scale, moved = chain.moved(y[f:].reshape(2, -1), 0.5 * y[:f] @ y[:f], f, tau)
        return np.concatenate([scale * y[:f], moved.ravel()])

    steps = np.diag(1e-5 * np.maximum(1.0, np.abs(begin)))
    jacobian = np.array([(flow(begin + d) - flow(begin - d)) / (2.0 * d.max()) for d in steps]).T
    along = (flow(begin) - begin)[f : f + length]
    along[0] *= f
    assert abs(along.sum()) > 0.3
    assert np.linalg.det(jacobian) == pytest.approx(math.exp(-along.sum()), rel=1e-8)


def test_without_degrees_of_freedom_nothing_happens(rng):
    chain = chain_of()
    begin = stirred(chain, rng)
    scale, moved = chain.moved(begin, 3.0, 0, 0.1)
    assert scale == 1.0
    np.testing.assert_array_equal(moved, begin)
    integrator = nose_hoover(temperature=300.0)
    simulation = simulation_of(integrator, *molecules(ions=3))  # which do not rotate
    integrator.setVelocitiesToTemperature(400.0, 1)
    simulation.step(5)
    values = {name: variables.get(integrator, name) for name in integrator.getThermostat().own_numbers}
    assert all((value == 0.0) == name.startswith("chain1") for name, value in values.items())
    assert math.isfinite(integrator.effectiveEnergy()._value)


def test_the_first_link_has_the_mass_of_all_degrees_of_freedom():
    """Martyna, Klein and Tuckerman: Q_1 = f kT / w², Q_j = kT / w²."""
    chain = chain_of(chainLength=3)
    np.testing.assert_allclose(chain.masses(12), np.array([12.0, 1.0, 1.0]) * KT / FREQUENCY**2, rtol=1e-14)
