"""Schemes with a thermostat within them."""

import math
from dataclasses import replace

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import WITH_THERMOSTAT, scheme_for_thermostat, shadow, stability_limit
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.thermostatted import reading_point
from openmm_exactrb.steps.substeps import DRIFT, HEAT_EXCHANGE, KICK

SPLIT = WITH_THERMOSTAT["W2_3m"].sequence


@pytest.mark.parametrize(("name", "momenta", "places"), [("BAOAB", 1 / 6, -1 / 12), ("BAOA", -1 / 12, -1 / 12)])
def test_the_shadow_of_a_scheme_with_a_thermostat_is_that_of_its_splitting(name, momenta, places):
    """Leapfrog: the momenta of whole steps look cold, those of half steps hot, and its places are too wide."""
    found = shadow(WITH_THERMOSTAT[name], 0.01)
    assert [(part - 1.0) / 0.01**2 for part in found] == pytest.approx([momenta, places], abs=2e-5)


def test_w2_3m_has_canonical_momenta_up_to_fast_librations():
    """Half a percent up to 160/ps at 6 fs per force, and it passes half a period of an oscillator, at 166/ps."""
    scheme = WITH_THERMOSTAT["W2_3m"]
    for frequency in (20.0, 50.0, 80.0, 110.0, 130.0, 145.0, 160.0):
        assert shadow(scheme, 0.018 * frequency).kinetic == pytest.approx(1.0, abs=0.005)
    assert stability_limit(scheme) == pytest.approx(4.807, abs=0.002)  # 267/ps
    assert shadow(WITH_THERMOSTAT["BAOA"], 0.006 * 130.0).kinetic < 0.95


def canonical(scheme, step):
    """Return w² <q²> / <p²> less 1 of an oscillator at the ends of steps."""
    kinetic, potential = shadow(scheme, step)
    return kinetic / potential - 1.0


def test_the_places_of_w2_3m_are_canonical_in_the_fourth_order_where_a_step_ends():
    """The place where it ends moves its places and nothing else: behind the next drift they are off in second order."""
    scheme = WITH_THERMOSTAT["W2_3m"]
    *_, (_, read) = scheme.sequence
    assert scheme.sequence[0][1] + read == pytest.approx(0.135)  # the drift of the thermostat's other side
    at_the_kick = replace(scheme, sequence=(*scheme.sequence[1:], scheme.sequence[0]))
    steps = np.array([0.05, 0.1, 0.2])
    for made, order in ((scheme, 4), (at_the_kick, 2)):
        errors = [abs(canonical(made, step)) for step in steps]
        assert np.diff(np.log(errors)) / np.diff(np.log(steps)) == pytest.approx(order, abs=0.02)
    assert canonical(scheme, 0.012 * 160.0) == pytest.approx(0.0036, abs=1e-4)  # 4 fs per force
    assert canonical(at_the_kick, 0.012 * 160.0) == pytest.approx(0.0227, abs=1e-4)


def test_places_are_canonical_with_friction_too():
    """The stationary covariance of an oscillator with friction of 5/ps and 30/ps is that without."""
    w, h, scheme = 160.0, 0.012, WITH_THERMOSTAT["W2_3m"]
    for friction in (5.0, 30.0):
        step, noise = np.eye(2), np.zeros((2, 2))
        for substep, part in scheme.sequence:
            matrix, added = np.array(substep.oscillator(part * w * h)), 0.0
            if substep == HEAT_EXCHANGE:
                matrix = np.diag([1.0, np.exp(-friction * h)])
                added = np.diag([0.0, 1.0 - matrix[1, 1] ** 2])
            step, noise = matrix @ step, matrix @ noise @ matrix.T + added
        covariance = np.linalg.solve(np.eye(4) - np.kron(step, step), noise.ravel()).reshape(2, 2)
        assert np.diag(covariance) - 1.0 == pytest.approx([canonical(scheme, w * h), 0.0], abs=2e-14)


def test_the_reading_point_of_one_kick_is_the_kick():
    """BAOA's steps end there."""
    assert reading_point([(1.0, 0.5)]) == pytest.approx(0.5)
    assert canonical(WITH_THERMOSTAT["BAOA"], 0.5) == pytest.approx(0.0, abs=1e-14)


def test_names_are_looked_up_among_all_schemes_that_a_thermostat_can_be_joined_to():
    assert scheme_for_thermostat("W2_3m") is WITH_THERMOSTAT["W2_3m"]
    assert scheme_for_thermostat("W2_3") is rb.SCHEMES["W2_3"]
    for typo in ("w2_3m", "W2_3M"):
        with pytest.raises(ValueError, match=f"'{typo}'.* did you mean 'W2_3m'"):
            scheme_for_thermostat(typo)


def frequency_error(drifts, kicks):
    """Return α + β of a symmetric splitting, by turns, in squares of the time per force evaluation."""
    n, h = len(kicks), 0.01
    turns = zip(drifts, [*kicks, 0.0], strict=True)
    sequence = tuple((substep, part / n) for pair in turns for substep, part in zip((DRIFT, KICK), pair, strict=True))
    of = shadow(Scheme("turns", 2, sequence), n * h)
    return (math.sqrt(of.kinetic * of.potential) - 1.0) / h**2


def test_no_splitting_of_positive_lengths_has_less_than_the_frequency_error_of_leapfrog():
    """Nor has a processed one, whose frequencies are those of its kernel."""
    rng = np.random.default_rng(3)
    assert frequency_error([0.5, 0.5], [1.0]) == pytest.approx(1.0 / 24.0, rel=1e-4)
    for kicks in (1, 2, 3, 4, 5):
        for _ in range(200):
            b, a = rng.dirichlet(np.full(kicks, 2.0)), rng.dirichlet(np.full(kicks + 1, 2.0))
            b, a = kicks * 0.5 * (b + b[::-1]), kicks * 0.5 * (a + a[::-1])
            assert frequency_error(a, b) >= (1.0 - 1e-4) / 24.0
    lengths = {symbol: [3.0 * part for substep, part in SPLIT if substep.symbol == symbol] for symbol in "AB"}
    first, *inner, early, late = lengths["A"]
    outer = 0.5 * (first + early + late)  # from one middle of the drift with the thermostat to the next
    assert frequency_error([outer, *inner, outer], lengths["B"]) == pytest.approx(1.0616 / 24.0, rel=1e-3)
