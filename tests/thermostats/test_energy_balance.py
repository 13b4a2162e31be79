"""What a run with a thermostat conserves, at the default scheme of each integrator: of order 2 in the step."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import WITH_THERMOSTAT
from openmm_exactrb.schemes.thermostatted import with_thermostat
from openmm_exactrb.steps.sequence import behind_exchange, palindromic
from openmm_exactrb.steps.substeps import DRIFT
from peptides import in_water
from places import REFERENCE
from starts import droplet_of, simulation_of
from thermostatted import snapshot

KELVIN = 30.0
STEPS = 0.02, 0.01, 0.005


def langevin(h, friction=1e-6, **options):
    return rb.ExactRigidBodyLangevinIntegrator(KELVIN, friction, h, **options)


def rescaling(h, time=0.5, **options):
    return rb.ExactRigidBodyRescalingIntegrator(KELVIN, time, h, **options)


def nose_hoover(h, frequency=2.0, **options):
    return rb.ExactRigidBodyNoseHooverIntegrator(KELVIN, frequency, h, **options)


def balance(integrator):
    energy = integrator.effectiveEnergy
    return energy()._value


def spreads(made, time=1.28, every=0.04):
    """Return the standard deviations of the balance and of the sum of the energies at the ends of steps (kJ/mol)."""
    simulation = droplet_of(made, 8)
    made.setRandomNumberSeed(2)
    h, balances, sums = made.getStepSize()._value, [], []
    for _ in range(round(time / every)):
        simulation.integrator.step(round(every / h))
        balances.append(balance(made))
        sums.append(made.totalEnergy()._value)
    return np.std(balances), np.std(sums)


def slopes(values):
    return np.diff(np.log(values)) / np.log(0.5)


@pytest.mark.parametrize(
    "make",
    [langevin, lambda h: langevin(h, 0.5), rescaling, nose_hoover, lambda h: nose_hoover(h, scheme="BAOA")],
    ids=["Langevin without friction", "Langevin", "rescaling", "Nosé-Hoover", "Nosé-Hoover with BAOA"],
)
def test_the_balance_is_of_order_2_over_three_steps(make):
    found = np.array([spreads(make(h))[0] for h in STEPS])
    np.testing.assert_allclose(slopes(found), 2.0, atol=0.3)


def test_at_the_end_of_a_step_of_the_default_the_sum_of_the_energies_is_of_order_1():
    """As the docstring and the page say: momenta are those of half a step before."""
    balances, sums = np.transpose([spreads(langevin(h)) for h in STEPS])
    np.testing.assert_allclose(slopes(sums), 1.0, atol=0.2)
    assert (sums > 5.0 * balances).all()


def test_a_symmetric_scheme_gives_the_sum_of_the_energies_as_constant_as_the_balance():
    balances, sums = spreads(langevin(0.01, 0.0, scheme="S2_2"))
    assert sums == pytest.approx(balances, rel=1e-9)


@pytest.mark.parametrize("scheme", [None, "W2_3m", "S2_2", "BAOAB"])
def test_asking_changes_no_bit_of_the_run(scheme):
    ends = []
    for asks in (False, True):
        integrator = langevin(0.01, 1.0, scheme=scheme)
        integrator.setRandomNumberSeed(3)
        simulation = droplet_of(integrator)
        for _ in range(5):
            integrator.step(3)
            if asks:
                integrator.effectiveEnergy()
        ends.append((snapshot(simulation), simulation.context.getTime()._value, simulation.context.getStepCount()))
    assert ends[0] == ends[1]


def test_heat_is_what_exchanges_add_to_the_kinetic_energy():
    """Particles without forces: all kinetic energy that they have is heat."""
    system = openmm.System()
    for mass in (20.0, 30.0, 5.0):
        system.addParticle(mass)
    integrator = langevin(0.01, 2.0)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(np.eye(3))
    for _ in range(3):
        integrator.step(10)
        assert integrator.heat()._value == pytest.approx(integrator.totalEnergy()._value, rel=1e-12)
    assert integrator.effectiveEnergy()._value == pytest.approx(0.0, abs=1e-12)
    state = context.getState(positions=True, velocities=True, integratorParameters=True)
    other = langevin(0.01, 2.0)
    second = openmm.Context(system, other, REFERENCE)
    second.setState(state)
    assert other.heat() == integrator.heat()


def test_with_inner_steps_the_balance_is_of_order_2_too():
    """Bodies with inner steps end a step at the heat exchange, the others half a drift behind it."""
    found = []
    for h in (0.002, 0.001, 0.0005):
        steps = round(16 * h / 0.002)
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1e-6, h, fast="bonded", innerSteps=steps)
        _, system, positions = in_water()
        context = openmm.Context(system, integrator, REFERENCE)
        context.setPositions(positions)
        integrator.setVelocitiesToTemperature(300.0, 1)
        values = []
        for _ in range(10):
            integrator.step(round(0.004 / h))
            values.append(integrator.effectiveEnergy()._value)
        found.append(np.std(values))
    assert (slopes(found) > 1.6).all()


def test_the_deterministic_thermostat_has_a_default_that_is_symmetric_in_time():
    scheme = nose_hoover(0.01).getScheme()
    assert scheme.forces == 1
    assert palindromic(scheme.sequence)
    assert not palindromic(langevin(0.01).getScheme().sequence)


def test_drifts_behind_the_last_heat_exchange():
    found = {name: [part for _, part in behind_exchange(scheme.sequence)] for name, scheme in WITH_THERMOSTAT.items()}
    assert found["BAOA"] == [0.5]
    assert found["BAOAB"] == found["ABOBA"] == []
    assert len(found["W2_3m"]) == 1
    assert 0.0 < found["W2_3m"][0] < 0.135
    assert behind_exchange(with_thermostat(rb.SCHEMES["S2_2"]).sequence) == ()
    assert behind_exchange(((DRIFT, 1.0),)) == ()


@pytest.mark.parametrize("scheme", ["BAOA", "W2_3m", "BAOAB"])
def test_the_heat_accounts_for_the_motion_that_a_remover_takes_away(scheme):
    """Friction of 10/ps heats the centre of mass by 3 kT times 10/ps, which the remover takes away at every step."""
    spread = {}
    for removes in (False, True):
        topology, system, positions = rb.rigid_water(8)
        if removes:
            system.addForce(openmm.CMMotionRemover())
        integrator = rb.ExactRigidBodyLangevinIntegrator(KELVIN, 10.0, 0.001, scheme=scheme)
        integrator.setRandomNumberSeed(2)
        simulation = simulation_of(topology, system, integrator, positions)
        simulation.minimizeEnergy(maxIterations=50)
        integrator.setVelocitiesToTemperature(KELVIN, 1)
        found = []
        for _ in range(20):
            simulation.step(10)
            found.append(integrator.effectiveEnergy()._value)
        spread[removes] = np.ptp(found)
    assert spread[True] < 2.0 * spread[False] < 0.2 * 3.0 * 8.314e-3 * KELVIN * 10.0 * 0.2
