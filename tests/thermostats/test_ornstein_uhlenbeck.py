"""The Ornstein-Uhlenbeck flow: its law, what it leaves alone, and bodies whose distributions are known."""

import numpy as np
import pytest
from scipy import stats
from scipy.sparse import diags_array, identity, kron
from scipy.sparse.linalg import expm_multiply

from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.mathematics.quaternions import matrix
from openmm_exactrb.random.rng import Instant, Purpose
from openmm_exactrb.rotors import rotor_of_sums
from openmm_exactrb.thermostats.langevin import ornstein_uhlenbeck

MASS = np.array([18.0, 1.0, 0.0, 40.0])
MOMENTS = np.array([[1.0, 0.0], [10.0, 3.0], [1000.0, 3.0]])  # the second body is linear
AT = Instant(seed=5, step=7, substep=2)


def momenta(rng):
    return exactly(rng.standard_normal((3, 4)) * (MASS > 0.0)), exactly(rng.standard_normal((3, 2)) * (MOMENTS > 0.0))


def prepared(kT=2.5, friction=1.0, rotational_friction=3.0):
    return ornstein_uhlenbeck(MASS, MOMENTS, kT, friction, rotational_friction)


def test_without_friction_the_momenta_are_those_handed_in(rng):
    P, m = momenta(rng)
    P1, m1 = prepared(friction=0.0, rotational_friction=0.0)(P, m, 0.1, AT)
    assert P1 is P
    assert m1 is m


@pytest.mark.parametrize("still", [0, 1])
def test_each_friction_acts_on_its_own_momenta(rng, still):
    before = momenta(rng)
    frictions = [1.0, 1.0]
    frictions[still] = 0.0
    after = prepared(2.5, *frictions)(*before, 0.1, AT)
    assert after[still] is before[still]
    assert (after[1 - still][0] != before[1 - still][0]).any()


def test_inputs_are_not_changed(rng):
    P, m = momenta(rng)
    copies = P.copy(), m.copy()
    prepared()(P, m, 0.1, AT)
    np.testing.assert_array_equal(P, copies[0])
    np.testing.assert_array_equal(m, copies[1])


def test_a_step_is_the_published_formula(rng):
    P, m = momenta(rng)
    P1, m1 = prepared()(P, m, 0.1, AT)
    for x, x1, width, g, part in (
        (P, P1, np.sqrt(2.5 * MASS), 1.0, Purpose.TRANSLATION),
        (m, m1, np.sqrt(2.5 * MOMENTS), 3.0, Purpose.ROTATION),
    ):
        a = np.exp(-g * 0.1)
        expected = a * x[0] + np.sqrt(1.0 - a * a) * width * AT.normals(part, x.shape[1:])
        np.testing.assert_allclose(x1.sum(axis=0), expected, rtol=0.0, atol=1e-14)


def test_massless_bodies_and_axes_of_linear_ones_get_no_noise(rng):
    P, m = prepared()(*momenta(rng), 0.7, AT)
    assert (P[0, :, 2] == 0.0).all()
    assert m[0, 0, 1] == 0.0
    assert (P[0][:, MASS > 0.0] != 0.0).all()
    assert (m[0][MOMENTS > 0.0] != 0.0).all()


def test_two_times_are_one_time_of_both(rng):
    """Momenta fade by the product of both factors, and variances 1 - a² add up."""
    first, second = 0.03, 0.5
    cold, (P, m) = prepared(kT=0.0), momenta(rng)
    np.testing.assert_allclose(
        cold(*cold(P, m, first, AT), second, AT)[1][0], cold(P, m, first + second, AT)[1][0], rtol=1e-15
    )
    n = 50_000
    many = ornstein_uhlenbeck(np.ones(n), np.ones((3, 0)), 1.0, 2.0, 0.0)
    P, none = exactly(np.zeros((3, n))), exactly(np.zeros((3, 0)))
    twice, _ = many(*many(P, none, first, AT), second, AT._replace(substep=3))
    assert stats.kstest(twice[0].ravel(), "norm", args=(0.0, np.sqrt(1.0 - np.exp(-4.0 * 0.53)))).pvalue > 1e-3


def test_weak_friction_does_not_round_what_is_in_the_low_part(rng):
    P = np.array([np.ones((3, 4)), np.full((3, 4), 1e-17)])
    _, m = momenta(rng)
    P1, _ = prepared(kT=0.0, friction=1e-20)(P, m, 1.0, AT)
    np.testing.assert_array_equal(P1[0], P[0])
    np.testing.assert_allclose(P1[1], 1e-17 - 1e-20, rtol=1e-15)


def test_plain_arrays_are_welcome(rng):
    P, m = momenta(rng)
    rounded = prepared()(P[:1], m[:1], 0.1, AT)
    for x, high in zip(prepared()(P, m, 0.1, AT), rounded, strict=True):
        assert high.shape == (1, *x.shape[1:])
        np.testing.assert_array_equal(high[0], x[0])


# Free bodies, whose motion is known


def test_a_free_body_diffuses():
    """<(R(t) - R(0))²> / 3 = 2 D (t - (1 - exp(-g t))/g) with D = kT/(M g), from equilibrium."""
    n, g, h, steps = 10_000, 0.8, 0.125, 80
    exchange = ornstein_uhlenbeck(np.full(n, 2.0), np.ones((3, 0)), 1.5, g, 0.0)
    P = exactly(np.sqrt(1.5 * 2.0) * Instant(9, 0, 99).normals(Purpose.TRANSLATION, (3, n)))
    none = exactly(np.zeros((3, 0)))
    R = np.zeros((3, n))
    for step in range(steps):
        R += 0.5 * h * P[0] / 2.0
        P, none = exchange(P, none, h, Instant(9, step, 0))
        R += 0.5 * h * P[0] / 2.0
    t, D = steps * h, 1.5 / (2.0 * g)
    square = R**2
    exact = 2.0 * D * (t - (1.0 - np.exp(-g * t)) / g)
    width = square.std() / np.sqrt(square.size) / exact
    assert width < 0.01
    # Two halves of a drift about the thermostat are 1 + (g h)²/12 = 1.0008 times too fast.
    assert abs(square.mean() / exact - 1.0) < 4.0 * width + 0.001


def correlation_of_a_damped_sphere(times, friction, degree=16):
    """Return <u(0) . u(t)> of a sphere with friction and noise, in units where kT/I is one.

    g(w, t), the mean of u(t) in the frame of the body over all that starts with the angular velocity w, obeys the
    backward equation dg/dt = w x g + friction (-w . grad + grad²) g. In Hermite functions up to a degree multiplication
    by w is a ladder up and down, friction counts the rungs, and the answer is the first coefficient.
    """
    size = degree + 1
    ladder = diags_array([np.sqrt(np.arange(1.0, size))] * 2, offsets=[-1, 1])
    rungs, one = diags_array(np.arange(float(size))), identity(size)

    def on_axis(operator, axis):
        a, b, c = (operator if k == axis else one for k in range(3))
        return kron(kron(a, b), c)

    def turn(axis):
        return np.cross(np.eye(3)[axis], np.eye(3)).T  # of v to e x v

    generator = sum(
        kron(on_axis(ladder, k), turn(k)) - friction * kron(on_axis(rungs, k), identity(3)) for k in range(3)
    )
    start = np.zeros(generator.shape[0])
    start[0] = 1.0
    return expm_multiply(generator.tocsr(), start, start=times[0], stop=times[-1], num=len(times), endpoint=True)[:, 0]


def test_the_reference_of_the_damped_sphere_has_the_known_limits():
    times = np.linspace(0.0, 4.0, 9)
    # Without friction: (1 + 2 <cos w t>)/3 over Maxwell's distribution, <cos w t> = (1 - t²) exp(-t²/2).
    free = (1.0 + 2.0 * (1.0 - times**2) * np.exp(-0.5 * times**2)) / 3.0
    np.testing.assert_allclose(correlation_of_a_damped_sphere(times[:5], 0.0, 24), free[:5], atol=1e-4)
    # With strong friction: Debye's exp(-2 D t) with D = kT/(I g), in its form for short times.
    debye = np.exp(-2.0 / 50.0 * (times - (1.0 - np.exp(-50.0 * times)) / 50.0))
    np.testing.assert_allclose(correlation_of_a_damped_sphere(times, 50.0, 4), debye, atol=1e-4)


@pytest.mark.parametrize("friction", [1.0, pytest.param(5.0, marks=pytest.mark.validate)])
def test_the_orientation_of_a_damped_sphere_decays_as_it_must(rng, friction):
    n, h, moment = 3_000, 0.05, 1.7
    turn = rotor_of_sums("exact", np.full(3, moment))
    exchange = ornstein_uhlenbeck(np.ones(n), np.full((3, n), moment), moment, 0.0, friction)
    none, m = exactly(np.zeros((3, n))), exactly(moment * rng.standard_normal((3, n)))
    q = exactly(np.repeat([[1.0], [0.0], [0.0], [0.0]], n, axis=1))
    found = []
    for step in range(120):
        q, m = turn(q, m, 0.5 * h)
        _, m = exchange(none, m, h, Instant(1, step, 1))
        q, m = turn(q, m, 0.5 * h)
        if step % 20 == 19:
            found.append(np.einsum("iin->n", matrix(q[0])) / 3.0)
    found = np.array(found)
    exact = correlation_of_a_damped_sphere(np.linspace(0.0, 6.0, 7), friction)[1:]
    width = found.std(axis=1) / np.sqrt(n)
    assert (width < 0.013).all()
    assert (np.abs(found.mean(axis=1) - exact) < 4.0 * width + 5e-4).all()
