"""The second-order error of averages, against stationary distributions by quadrature."""

import itertools
from functools import cache, partial

import numpy as np
import pytest

import openmm_exactrb as rb
from averages.stationary import Quartic, Rotor
from openmm_exactrb.schemes import scheme_for_thermostat
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.second_order import second_order
from openmm_exactrb.schemes.sequence import spelled
from openmm_exactrb.schemes.thermostatted import with_thermostat
from thermostatted import ending_at_kicks

ROTOR = "rotor in a field"
MOTIONS = {
    "quartic well": cache(Quartic),
    "with a spring in the drifts": cache(partial(Quartic, spring=2.0)),
    ROTOR: cache(Rotor),
}
# The time of a force evaluation: where it is divided by 2 and 4, what is left of higher order follows.
SCHEMES = {"BAOA": 0.16, "BAOAB": 0.16, "ABOBA": 0.16, "V2": 0.12, "S2_2": 0.08, "W2_3m": 0.1, "W2_4g": 0.06}
FRICTIONS = (1.0, 3.0, 9.0)


def steps_of(name):
    scheme = with_thermostat(scheme_for_thermostat(name))
    return scheme, SCHEMES[name] * scheme.forces * np.array([1.0, 0.5, 0.25])


def predicted(motion, order, friction):
    """Return the errors of the motion's observables over h², and for weak and for strong friction."""
    curvature, second, square, work, potential = (
        np.asarray(of(motion.z))
        for of in (motion.curvature, motion.second, motion.square, motion.work, motion.potential)
    )
    # Drifts are exact with a spring in them; v·V''v of the conserved energy is then v·V_s''v - f_fast·M⁻¹f_s.
    rest = motion.remaining(friction, 2.0 * order.alpha * friction * (curvature - second))
    found = []
    for of, slope_of in motion.observables:
        values, slope = of(motion.z), motion.mean(slope_of(motion.z))
        own = -(order.alpha + order.beta) * motion.covariance(values, square) - order.slope * slope
        weak = 2.0 * order.alpha * motion.mean(work) * motion.covariance(values, potential) / motion.freedom
        strong = -2.0 * order.alpha * slope - order.alpha * motion.covariance(values, work)
        found.append((own + motion.mean(values * rest), own + weak, own + strong))
    return np.array(found).T


@pytest.mark.parametrize(
    ("motion", "name"),
    [(motion, name) for motion in MOTIONS for name in SCHEMES if motion != ROTOR or name in ("BAOA", "W2_3m", "W2_4g")],
)
def test_the_error_of_averages_is_the_predicted_one_at_every_friction(motion, name):
    """Errors over h² approach the prediction as h²: their extrapolation to h = 0 from three steps agrees with it."""
    system, (scheme, steps) = MOTIONS[motion](), steps_of(name)
    exact = np.array([system.mean(of(system.z)) for of, _ in system.observables])
    for friction in FRICTIONS:
        full, *_ = predicted(system, second_order(scheme), friction)
        errors = [
            (system.stationary(scheme, h, friction, [of for of, _ in system.observables]) - exact) / h**2 for h in steps
        ]
        once = [(4.0 * fine - coarse) / 3.0 for coarse, fine in itertools.pairwise(errors)]
        assert (16.0 * once[1] - once[0]) / 15.0 == pytest.approx(full, rel=1e-4, abs=2e-6)
        largest = np.abs(full).argmax()
        sizes = [abs(error[largest]) * h**2 for error, h in zip(errors, steps, strict=True)]
        slopes = np.diff(np.log(sizes)) / np.diff(np.log(steps))
        assert slopes[1] == pytest.approx(2.0, abs=0.2)
        assert abs(slopes[1] - 2.0) < 0.5 * abs(slopes[0] - 2.0)


@pytest.mark.parametrize("motion", ["quartic well", ROTOR])
def test_the_error_at_strong_friction_goes_to_its_limit_as_the_square_of_the_inverse(motion):
    """The rotor's limit has the curvature of its sphere in it, which brackets leave out: it is small in a liquid."""
    system, order = MOTIONS[motion](), second_order(steps_of("W2_3m")[0])
    curved = [
        -2.0 * order.alpha * system.ricci * system.covariance(of(system.z), system.potential(system.z))
        for of, _ in system.observables
    ]
    off = [
        np.abs(of[0] - of[2] - curved).max()
        for of in (predicted(system, order, friction) for friction in (50.0, 100.0, 200.0))
    ]
    assert np.diff(np.log2(off)) == pytest.approx(-2.0, abs=0.05)


def test_baoab_has_no_error_of_positions_at_strong_friction():
    """B. Leimkuhler and C. Matthews (2013), doi:10.1063/1.4802990."""
    for name in ("BAOAB", "BAOA"):
        order = second_order(steps_of(name)[0])
        for system in (MOTIONS["quartic well"](), MOTIONS[ROTOR]()):
            assert predicted(system, order, 1.0)[2] == pytest.approx(0.0, abs=1e-12)


def test_coefficients_are_those_of_the_conserved_energy():
    """By the oscillator, whose conserved energy is known: 1 + 2 alpha h² and 1 + 2 beta h² next to the exchange."""
    order = second_order(steps_of("W2_3m")[0])
    assert (order.alpha, order.beta) == pytest.approx((-0.0008035, 0.0057183), abs=1e-7)
    assert second_order(steps_of("BAOAB")[0]) == pytest.approx((-1 / 24, 1 / 12, 0.5, 0.0, 0.5, 0.5))
    assert second_order(steps_of("V2")[0]) == pytest.approx((1 / 12, -1 / 24, 0.0, 0.0, 0.0, 0.0))
    for name in rb.SCHEMES:
        scheme = scheme_for_thermostat(name)
        if scheme.order > 2 and not scheme.processor and not scheme.generalised:
            assert second_order(with_thermostat(scheme))[:2] == pytest.approx((0.0, 0.0), abs=1e-12), name


def test_where_a_barostat_acts_errors_are_those_of_steps_that_end_there():
    """At the next kick; steps of ABOBA end between drifts too, but not after an exchange, and keep their ends."""
    own, there = second_order(steps_of("W2_3m")[0]), second_order(ending_at_kicks())
    assert own.barostat == pytest.approx(0.135)
    assert own.barostat_slope == pytest.approx(there.slope)
    assert own.barostat_slope - own.slope > 0.002
    for name in ("BAOA", "BAOAB", "ABOBA", "S2_2"):
        order = second_order(steps_of(name)[0])
        assert order.barostat_slope == order.slope


@pytest.mark.parametrize(
    "scheme",
    [
        Scheme("two exchanges", 2, spelled("B A O A B O")),
        Scheme("lopsided", 2, spelled("B O A")),
        Scheme("by groups", 2, spelled("B1 A O A B1")),
        with_thermostat(rb.SCHEMES["W2_1"]),
    ],
    ids=lambda scheme: scheme.name,
)
def test_the_theory_refuses_other_steps(scheme):
    with pytest.raises(ValueError, match="cannot be corrected: the theory holds for steps with a single heat exchange"):
        second_order(scheme)
