"""What runs at a thermostat sample, beside what they must."""

import numpy as np
import openmm
import pytest
from scipy import stats
from scipy.linalg import solve_discrete_lyapunov

import openmm_exactrb as rb
from openmm_exactrb.schemes import scheme_for_thermostat, shadow
from starts import context_of
from thermostatted import (
    KT,
    dipoles_in_a_field,
    mean_and_error,
    molecules,
    reduced_energies,
    simulation_of,
    trapped,
)

FIELD = 20.0  # mu E / kT: the dipoles swing by 0.3 radians, with a period of 95 fs


def langevin(h, scheme="W2_3m", friction=5.0, **options):
    return rb.ExactRigidBodyLangevinIntegrator(300.0, friction, h, scheme=scheme, **options)


def hybrid(h, scheme="S2_2", **options):
    return rb.ExactRigidBodyHybridIntegrator(300.0, 5.0, h, scheme=scheme, **options)


# -- a dipole in a field ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["W2_3m", pytest.param("BAOAB", marks=pytest.mark.validate)])
def test_dipoles_in_a_field_obey_langevin(scheme):
    error, width = mean_and_error(reduced_energies(langevin(0.008, scheme), 500, FIELD, 200, 1000, 5))
    assert width < 0.012
    assert abs(error) < 0.005 + 3.0 * width


def test_hybrid_monte_carlo_is_exact_where_langevin_dynamics_is_not():
    """O V2 O at 12 fs with few enough bodies that proposals are taken."""
    plain, width = mean_and_error(reduced_energies(langevin(0.012, "V2"), 400, FIELD, 100, 500, 5))
    assert plain > 0.1 + 3.0 * width
    integrator = hybrid(0.012, "V2")
    exact, width = mean_and_error(reduced_energies(integrator, 16, FIELD, 300, 3000, 5))
    assert 0.2 < integrator.acceptanceRate() < 0.9
    assert width < 0.05
    assert abs(exact) < 3.5 * width


@pytest.mark.validate
@pytest.mark.parametrize("scheme", ["W2_3m", "W2_3", "W2_4g", "S2_2", "BAOAB", "BAOA"])
def test_dipoles_in_a_field_obey_langevin_to_five_thousandths(scheme):
    error, width = mean_and_error(reduced_energies(langevin(0.008, scheme), 4000, FIELD, 400, 8000, 5))
    assert width < 0.001
    assert abs(error) < 0.005 - 2.0 * width


@pytest.mark.validate
@pytest.mark.parametrize(("scheme", "h", "proposals"), [("V2", 0.012, 1), ("S2_2", 0.032, 2), ("W2_4", 0.036, 1)])
def test_hybrid_monte_carlo_is_exact_to_a_hundredth(scheme, h, proposals):
    integrator = hybrid(h, scheme, stepsPerProposal=proposals)
    error, width = mean_and_error(reduced_energies(integrator, 16, FIELD, 500, 60_000, 5))
    assert width < 0.008
    assert abs(error) < 3.5 * width


# -- a harmonic trap ---------------------------------------------------------------------------------------------


def trap_for_ions(n, angle, h):
    """Return a System of ions in a trap with omega h = angle, places at its centre, and its strength."""
    strength = 23.0 * (angle / h) ** 2
    system, places = molecules(ions=n)
    trap = openmm.CustomExternalForce(f"{strength}/2*(x^2+y^2+(z-0.02)^2)")
    for i in range(n):
        trap.addParticle(i)
    system.addForce(trap)
    return system, places, strength


def one_step(scheme, angle, friction, temperature, q, p, h=0.02):
    """Return where a step leads from q and p (n, 3), in the widths of the canonical distribution at 300 K."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(temperature, friction, h, scheme=scheme)
    integrator.setRandomNumberSeed(1)
    system, places, strength = trap_for_ions(len(q), angle, h)
    wide, fast = np.sqrt(KT / strength), np.sqrt(23.0 * KT)
    _context = context_of(system, integrator, places + wide * q, fast * p / 23.0)
    integrator.step(1)
    _, state = integrator.bodyState()
    return (state.R.T - places) / wide, state.P.T / fast


def stationary(scheme, angle, friction, n=10_000):
    """Return <z²> and <p²> over their exact values, in the stationary state of the steps.

    A step is linear, x -> A x + noise: A is what steps at 0 K do to unit vectors, and the covariance of the noise is
    that of n ions which begin at rest in the centre. So the error of either is sqrt(2/3n), and that of the ratio none.
    """
    unit, rest = np.diag([1.0, 0.0, 0.0])[:2], np.zeros((n, 3))  # of two ions one is displaced, the other moves
    ends = one_step(scheme, angle, friction, 0.0, unit, unit[::-1])
    A = np.array([x[:, 0] for x in ends])
    noise = np.array([x.ravel() for x in one_step(scheme, angle, friction, 300.0, rest, rest)])
    return np.diag(solve_discrete_lyapunov(A, noise @ noise.T / noise.shape[1]))


#: Four standard errors of a variance from 30 000 numbers: a false alarm in 16 000.
FOUR_SIGMA = 4.0 * np.sqrt(2.0 / 30_000)

OF_TRAPS = [("V2", 1.0), ("S2_2", 2.2), ("W2_3", 4.2), ("W2_3m", 4.2), ("W2_4g", 3.4), ("BAOA", 1.0)]


def test_baoab_has_the_places_of_a_trap_at_any_step():
    """With w h = 1.44: <z²> is exact, and <p²> at the end of a step is 1 - (w h)²/4."""
    place, momentum = stationary("BAOAB", 1.44, friction=20.0)
    assert place == pytest.approx(1.0, abs=FOUR_SIGMA)
    assert momentum / place == pytest.approx(1.0 - 1.44**2 / 4.0, rel=1e-9)


@pytest.mark.parametrize(("scheme", "angle"), OF_TRAPS)
def test_a_trap_is_as_wide_as_the_shadow_energy_says(scheme, angle):
    """Weak friction: the thermostat holds <p²> of the only mode there is, and <z²> follows from the energy kept.

    Steps of these schemes end with the momenta that the thermostat left.
    """
    place, momentum = stationary(scheme, angle, friction=0.05)
    kinetic, potential = shadow(scheme_for_thermostat(scheme), angle)
    assert momentum == pytest.approx(1.0, abs=FOUR_SIGMA)
    assert place / momentum == pytest.approx(kinetic / potential, rel=1e-4)


# -- all degrees of freedom get their share ---------------------------------------------------------------------


def shares(integrator, counts, burn, steps, every):
    """Return the mean of p²/(m kT) for each degree of freedom of each kind of body, and its width, from rest."""
    simulation = simulation_of(integrator, *trapped(*counts))
    integrator.setRandomNumberSeed(2)
    integrator.step(burn)
    bodies, _ = integrator.bodyState()
    rows = []
    for _ in range(steps // every):
        integrator.step(every)
        _, state = integrator.bodyState()
        row = []
        for kind in bodies.kinds:
            row += list((state.P[:, kind.bodies] ** 2).mean(axis=1) / (kind.mass * KT))
            if kind.turns:
                moments = kind.inertia[0]
                squares = (state.m[:, kind.bodies] ** 2).mean(axis=1)
                row += list(squares[moments > 0.0] / (moments[moments > 0.0] * KT))
                assert not squares[moments == 0.0].any()
        rows.append(row)
    rows = np.array(rows)
    assert simulation.context.getStepCount() == burn + steps
    assert integrator.degreesOfFreedom() == (3 * sum(counts), 3 * counts[0] + 2 * counts[1])
    blocks = rows[len(rows) % 10 :].reshape(10, -1, rows.shape[1]).mean(axis=1)
    return blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / np.sqrt(10)


def test_water_a_linear_molecule_and_an_ion_share_the_energy():
    """From rest, with different frictions: 6 + 5 + 3 degrees of freedom."""
    integrator = langevin(0.004, rotationalFriction=12.0)
    found, width = shares(integrator, (60, 60, 60), 600, 2000, 10)
    assert len(found) == 6 + 5 + 3
    assert width.mean() < 0.025
    assert (np.abs(found - 1.0) < 4.5 * width + 0.005).all()


def test_baoab_is_right_around_its_thermostat_and_cold_at_the_end_of_its_step():
    """With w h = 1 in a trap: <p²> at the end is 1 - (w h)²/4 of the exact one, and in the middle nearly exact."""
    integrator = langevin(0.02, "BAOAB")
    system, places, _ = trap_for_ions(400, 1.0, 0.02)
    simulation = simulation_of(integrator, system, places)
    integrator.setVelocitiesToTemperature(300.0, 1)
    integrator.setRandomNumberSeed(1)
    integrator.step(200)
    ends, middles = [], []
    for _ in range(1000):
        simulation.step(1)
        ends.append(integrator.temperatures()[0]._value / 300.0)
        middles.append(integrator.temperaturesAroundThermostat()[0]._value / 300.0)
    (end, width), (middle, width_of_middle) = mean_and_error(ends), mean_and_error(middles)
    assert abs(end - 0.75) < 4.0 * width
    assert abs(middle - 1.0) < 4.0 * width_of_middle
    assert max(width, width_of_middle) < 0.006


@pytest.mark.validate
def test_the_canonical_state_has_no_direction_in_time():
    """<A(0)² A(t)> = <A(0) A(t)²> in equilibrium, here of the cosine of dipoles in a field."""
    integrator, n = langevin(0.008), 400
    simulation = simulation_of(integrator, *dipoles_in_a_field(n, 2.0))
    integrator.setVelocitiesToTemperature(300.0, 1)
    integrator.setRandomNumberSeed(1)
    integrator.step(300)
    series = []
    for _ in range(400):
        simulation.step(3)
        _, state = integrator.bodyState()
        q = state.q
        series.append(q[0] ** 2 - q[1] ** 2 - q[2] ** 2 + q[3] ** 2)
    series = np.array(series)
    A = series - series.mean()
    for lag in (2, 5, 10):
        difference = (A[:-lag] ** 2 * A[lag:] - A[:-lag] * A[lag:] ** 2).mean(axis=0)  # bodies are independent
        width = difference.std() / np.sqrt(n)
        assert abs(difference.mean()) < 4.0 * width
        assert width < 0.01
    assert np.abs((A**2).mean() * 3.0 - 1.0) < 0.9  # they do swing


# -- rescaling --------------------------------------------------------------------------------------------------


def rescaling(time=0.1, h=0.002, **options):
    integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, time, h, "S2_2", **options)
    integrator.setRandomNumberSeed(5)
    return integrator


@pytest.mark.parametrize("together", [True, False])
def test_rescaling_gives_the_kinetic_energy_its_law(together):
    """Free bodies, a step much longer than the relaxation time: independent draws of a gamma distribution."""
    integrator = rescaling(0.001, 0.05, together=together)
    simulation = simulation_of(integrator, *molecules(waters=3, rods=1, ions=2))
    integrator.setVelocitiesToTemperature(100.0, 1)
    energies = []
    for _ in range(400):
        simulation.step(1)
        energies.append([e._value / KT for e in integrator.kineticEnergies()])
    energies = np.array(energies)
    for part, freedom in [(energies.sum(axis=1), 29)] if together else zip(energies.T, (18, 11), strict=True):
        assert stats.kstest(part, stats.gamma(freedom / 2.0).cdf).pvalue > 1e-3


# -- decisions --------------------------------------------------------------------------------------------------


def test_refused_proposals_leave_places_and_turn_momenta():
    """A step far beyond any: infinite or huge energies are refused, whatever the forces make of them."""
    integrator = rb.ExactRigidBodyHybridIntegrator(300.0, 0.0, 1e3, scheme="V2")
    simulation = simulation_of(integrator, *trapped(5, 1, 1))
    integrator.setVelocitiesToTemperature(300.0, 1)
    _, before = integrator.bodyState()
    simulation.step(3)
    _, after = integrator.bodyState()
    np.testing.assert_array_equal(after.R, before.R)
    np.testing.assert_array_equal(after.P, -before.P)
    np.testing.assert_array_equal(after.m, -before.m)
    assert integrator.tally() == (0, 3)
    integrator.resetTally()
    assert np.isnan(integrator.acceptanceRate())


def test_small_steps_are_all_taken_and_need_no_forces_for_the_energy():
    for scheme, proposals, more in (("S2_2", 1, 1), ("S2_2", 3, 1), ("W2_4", 1, 21)):
        integrator = hybrid(0.0005 * proposals, scheme, stepsPerProposal=proposals, checkDivergence=False)
        integrator.setRandomNumberSeed(1)
        simulation = simulation_of(integrator, *trapped(4, 1, 1))
        integrator.setVelocitiesToTemperature(300.0, 1)
        integrator.step(20)
        assert integrator.tally() == (20, 20)
        assert integrator.timings.evaluations == 20 * integrator.forceEvaluationsPerStep + more
        assert simulation.context.getTime()._value == pytest.approx(0.01 * proposals)
