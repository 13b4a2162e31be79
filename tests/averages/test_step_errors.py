"""The step-size error of averages, against stationary distributions by quadrature."""

import itertools
from functools import cache, partial

import numpy as np
import pytest
from scipy import linalg

import openmm_exactrb as rb
from averages.stationary import Quartic, Rotor
from openmm_exactrb.schemes import scheme_for_thermostat
from openmm_exactrb.schemes.stability import oscillated
from openmm_exactrb.schemes.step_errors import _around_exchange, step_errors
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


#: Each scheme with one motion at one friction; with `--validate` also with the others.
ONCE = [*zip(["quartic well", "with a spring in the drifts"] * 4, SCHEMES, strict=False), (ROTOR, "W2_3m")]
ALWAYS = [(*case, friction) for case, friction in zip(ONCE, FRICTIONS * 3, strict=False)]
OF_ROTORS = "BAOA", "W2_3m", "W2_4g"
ALL = [
    (motion, name, friction)
    for motion in MOTIONS
    for name in SCHEMES
    for friction in FRICTIONS
    if motion != ROTOR or name in OF_ROTORS
]


@pytest.mark.parametrize(
    ("motion", "name", "friction"),
    [pytest.param(*case, marks=[] if case in ALWAYS else pytest.mark.validate) for case in ALL],
)
def test_the_error_of_averages_is_the_predicted_one_at_every_friction(motion, name, friction):
    """Errors over h² approach the prediction as h²: their extrapolation to h = 0 from three steps agrees with it."""
    system, (scheme, steps) = MOTIONS[motion](), steps_of(name)
    exact = np.array([system.mean(of(system.z)) for of, _ in system.observables])
    full, *_ = predicted(system, step_errors(scheme), friction)
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
    system, order = MOTIONS[motion](), step_errors(steps_of("W2_3m")[0])
    curved = [
        -2.0 * order.alpha * system.ricci * system.covariance(of(system.z), system.potential(system.z))
        for of, _ in system.observables
    ]
    off = [
        np.abs(of[0] - of[2] - curved).max()
        for of in (predicted(system, order, friction) for friction in (50.0, 100.0, 200.0))
    ]
    assert np.diff(np.log2(off)) == pytest.approx(-2.0, abs=0.05)


def oscillator(scheme, x, friction):
    """Return <q²> of an oscillator of frequency 1 and kT = 1 at the ends of steps x, at a friction."""
    behind, before = _around_exchange(scheme)
    end = np.array(oscillated(behind, x))
    cycle, kept = end @ np.array(oscillated(before, x)), np.exp(-friction * x)
    heat = end @ np.diag([0.0, 1.0 - kept**2]) @ end.T
    return linalg.solve_discrete_lyapunov(end @ np.diag([1.0, kept]) @ np.linalg.solve(end, cycle), heat)[0, 0]


@pytest.mark.parametrize("name", SCHEMES)
def test_the_energy_of_an_oscillator_is_right_to_fourth_order(name):
    """Its distribution is normal: Cov(U, S) = Var(S)/2 = <q²>² and the slope of U is -<q²>, as they are in frames."""
    scheme, order = steps_of(name)[0], step_errors(steps_of(name)[0])
    steps = scheme.forces * np.array([0.2, 0.1])
    for friction in FRICTIONS:
        left = []
        for x in steps:
            q2 = oscillator(scheme, x, friction)
            own, strong = -(order.alpha + order.beta) * q2**2 + order.slope * q2, order.alpha * (2.0 * q2 - q2**2)
            left.append(0.5 * (q2 - 1.0) - x**2 * (own + strong) - x**4 * order.quartic * 2.0 * q2**2 / 4.0)
        assert abs(left[1]) < 1e-12 or np.log2(left[0] / left[1]) == pytest.approx(6.0, abs=0.3)


@pytest.mark.validate
@pytest.mark.parametrize("field", [10.0, 20.0])
def test_the_fourth_order_of_oscillators_is_most_of_that_of_a_rotor_in_a_strong_field(field):
    """Librations of water are less anharmonic: they have the amplitude of a rotor in a field of more than 20 kT."""
    system, scheme, friction = Rotor(field), steps_of("W2_3m")[0], 0.3 * np.sqrt(field)
    order, square = step_errors(scheme), system.square(system.z)
    second = -field * predicted(system, order, friction)[0][0]  # the potential energy is -field u
    for libration in (0.8, 1.6):  # h times the frequency
        h = libration / np.sqrt(field)
        error = system.stationary(scheme, h, friction, [system.potential])[0] - system.mean(system.potential(system.z))
        fourth = h**4 * order.quartic * system.covariance(square, square) / 4.0
        assert 0.5 < fourth / (error - h**2 * second) < 0.8


def test_baoab_has_no_error_of_positions_at_strong_friction():
    """B. Leimkuhler and C. Matthews (2013), doi:10.1063/1.4802990."""
    for name in ("BAOAB", "BAOA"):
        order = step_errors(steps_of(name)[0])
        for system in (MOTIONS["quartic well"](), MOTIONS[ROTOR]()):
            assert predicted(system, order, 1.0)[2] == pytest.approx(0.0, abs=1e-12)


def test_coefficients_are_those_of_the_conserved_energy():
    """By the oscillator, whose conserved energy is known: 1 + 2 alpha h² and 1 + 2 beta h² next to the exchange."""
    order = step_errors(steps_of("W2_3m")[0])
    assert (order.alpha, order.beta) == pytest.approx((-0.0008035, 0.0057183), abs=1e-7)
    assert step_errors(steps_of("BAOAB")[0]) == pytest.approx((-1 / 24, 1 / 12, 0.5, 0.0, 0.5, 0.5, 0.0))
    assert step_errors(steps_of("V2")[0])[:6] == pytest.approx((1 / 12, -1 / 24, 0.0, 0.0, 0.0, 0.0))
    for name in rb.SCHEMES:
        scheme = scheme_for_thermostat(name)
        if scheme.order > 2 and not scheme.processor and not scheme.generalised:
            assert step_errors(with_thermostat(scheme))[:2] == pytest.approx((0.0, 0.0), abs=1e-12), name


def test_where_a_barostat_acts_errors_are_those_of_steps_that_end_there():
    """At the next kick; steps of ABOBA end between drifts too, but not after an exchange, and keep their ends."""
    own, there = step_errors(steps_of("W2_3m")[0]), step_errors(ending_at_kicks())
    assert own.barostat == pytest.approx(0.135)
    assert own.barostat_slope == pytest.approx(there.slope)
    assert own.barostat_slope - own.slope > 0.002
    for name in ("BAOA", "BAOAB", "ABOBA", "S2_2"):
        order = step_errors(steps_of(name)[0])
        assert order.barostat_slope == order.slope
