"""Nosé-Hoover chains: their flow against its equations of motion, what runs conserve and sample, and what persists."""

import copy
import math
import pickle

import numpy as np
import openmm
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

import openmm_exactrb as rb
from openmm_exactrb.context import variables
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.openmm_access.units import gas_constant_times
from openmm_exactrb.thermostats import Langevin, NoseHooverChain
from openmm_exactrb.thermostats.nose_hoover import WEIGHTS
from thermostatted import (
    KT,
    R,
    droplet_of,
    ideal_gas,
    mean_and_error,
    molecules,
    simulation_of,
    snapshot,
    trapped,
)

H = 0.01
FREQUENCY = 20.0


def chain_of(**options):
    return NoseHooverChain(**({"temperature": 300.0, "collisionFrequency": FREQUENCY} | options))


def nose_hoover(h=H, temperature=30.0, frequency=FREQUENCY, **options):
    return rb.ExactRigidBodyNoseHooverIntegrator(temperature, frequency, h, **{"scheme": "S2_2"} | options)


def stirred(chain, rng):
    """Return coordinates and velocities of the links as they may be in equilibrium."""
    coordinates, velocities = rng.standard_normal((2, chain.chainLength))
    return np.array([coordinates, 0.7 * FREQUENCY * velocities])


# -- the flow of a chain ----------------------------------------------------------------------------------------------


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
    for repeated in (24, 48):
        scale, moved = chain_of(chainLength=length, numMTS=repeated, numYoshidaSuzuki=number).moved(
            begin, kinetic, freedom, tau
        )
        errors.append(np.abs(np.array([math.log(scale), *moved.ravel()]) - exact).max())
    assert errors[1] > 1e-9  # not of rounding
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.35


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
    assert math.isfinite(integrator.conservedEnergy()._value)


def test_the_first_link_has_the_mass_of_all_degrees_of_freedom():
    """Martyna, Klein and Tuckerman: Q_1 = f kT / w², Q_j = kT / w²."""
    chain = chain_of(chainLength=3)
    np.testing.assert_allclose(chain.masses(12), np.array([12.0, 1.0, 1.0]) * KT / FREQUENCY**2, rtol=1e-14)


# -- what a run conserves -----------------------------------------------------------------------------------------


def wander(h, time=0.64, **options):
    """Return how far the conserved energy of a droplet wanders that begins at twice the temperature (kJ/mol)."""
    integrator = nose_hoover(h, **options)
    simulation = droplet_of(integrator)
    integrator.setVelocitiesToTemperature(60.0, 1)
    begin, energy = integrator.conservedEnergy()._value, integrator.totalEnergy()._value
    values = []
    for _ in range(16):
        simulation.integrator.step(round(time / 16 / h))
        values.append(integrator.conservedEnergy()._value - begin)
    assert abs(integrator.totalEnergy()._value - energy) > 0.1  # the total energy is not conserved
    return np.sqrt(np.mean(np.square(values)))


@pytest.mark.parametrize(
    ("options", "order"),
    [
        ({}, 2),
        ({"together": True}, 2),
        ({"scheme": "BAOAB"}, 2),
        ({"scheme": "PEFRL"}, 4),
        ({"scheme": "PEFRL", "numYoshidaSuzuki": 1, "numMTS": 2, "frequency": 40.0}, 2),
        ({"scheme": "PEFRL", "numYoshidaSuzuki": 3, "numMTS": 2, "frequency": 40.0}, 4),
    ],
    ids=["S2_2", "together", "BAOAB", "PEFRL", "chain of order 2", "chain of order 4"],
)
def test_the_conserved_energy_has_the_smaller_order_of_scheme_and_chain(options, order):
    """Each of them keeps its part by itself, so that the splitting between them does not show."""
    coarse, fine = (wander(h, **options) for h in (0.01, 0.005))
    assert abs(np.log2(coarse / fine) - order) < 0.35
    assert fine < 2e-3


def flipped(integrator):
    """Turn momenta and chains around."""
    _, state = integrator.fullState()
    integrator.setBodyState(State(state.R, -state.P, state.q, -state.m))
    for name in integrator.getThermostat().own_numbers:
        if "velocity" in name:
            variables.put(integrator, name, -variables.get(integrator, name))


@pytest.mark.parametrize("together", [True, False])
def test_a_run_retraces_its_steps_when_momenta_and_chains_are_turned_around(together):
    integrator = nose_hoover(together=together)
    simulation = droplet_of(integrator)
    integrator.setVelocitiesToTemperature(60.0, 1)
    _, begin = integrator.bodyState()
    for _ in range(2):
        simulation.integrator.step(40)
        flipped(integrator)
    _, end = integrator.bodyState()
    for a, b in zip(begin, end, strict=True):
        np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-11 * np.abs(a).max())
    for name in integrator.getThermostat().own_numbers:
        assert abs(variables.get(integrator, name)) < 1e-9


def test_a_chain_that_is_hardly_coupled_gives_the_trajectory_of_constant_energy():
    runs = [droplet_of(i) for i in (nose_hoover(frequency=1e-12), rb.ExactRigidBodyIntegrator(H, scheme="S2_2"))]
    for run in runs:
        run.integrator.step(50)
    assert snapshot(runs[0]) == snapshot(runs[1])


def test_a_weak_coupling_leaves_that_trajectory_with_its_square():
    places = []
    for frequency in (1e-3, 2e-3, 1e-9):
        integrator = nose_hoover(frequency=frequency)
        simulation = droplet_of(integrator)
        integrator.setVelocitiesToTemperature(60.0, 1)
        simulation.integrator.step(100)
        places.append(integrator.bodyState()[1].R)
    near, far = (np.abs(x - places[2]).max() for x in places[:2])
    assert far / near == pytest.approx(4.0, rel=1e-2)


# -- what a run samples -------------------------------------------------------------------------------------------


def lopsided_droplet(integrator):
    """Return a Simulation of four dipoles in a trap that shares all energy out.

    In a harmonic one the centre of mass is an oscillator by itself, and in an isotropic one the angular momentum keeps
    its direction: chains alone do not make these canonical.
    """
    _, system, positions = rb.dipole_fluid(4, seed=1, trap=0.5)
    wall = openmm.CustomExternalForce("0.1*(x^4+2*y^4+0.5*z^4)+0.2*x*y*z+0.1*x^2*y")
    for i in range(system.getNumParticles()):
        if not system.isVirtualSite(i):
            wall.addParticle(i)
    system.addForce(wall)
    return simulation_of(integrator, system, positions)


@pytest.mark.parametrize("together", [True, pytest.param(False, marks=pytest.mark.validate)])
def test_translation_and_rotation_of_a_droplet_find_the_temperature(together):
    """From rotation at rest: with one chain for both, the forces between the dipoles share the energy out."""
    integrator = nose_hoover(0.02, together=together)
    simulation = lopsided_droplet(integrator)
    integrator.setVelocitiesToTemperature(60.0, 3)
    _, state = integrator.fullState()
    integrator.setBodyState(state._replace(m=0.0 * state.m))
    simulation.integrator.step(500)
    series = []
    for _ in range(600):
        simulation.integrator.step(5)
        series.append([T._value for T in integrator.temperatures()])
    for temperatures in np.transpose(series):
        mean, error = mean_and_error(temperatures)
        assert error < 2.5
        assert abs(mean - 30.0) < 4.0 * error


def canonical_energies(steps, every):
    """Return kinetic energies over kT of translation and rotation, with their degrees of freedom, from a droplet."""
    integrator = nose_hoover(0.02)
    simulation = lopsided_droplet(integrator)
    integrator.setVelocitiesToTemperature(30.0, 3)
    simulation.integrator.step(500)
    energies = []
    for _ in range(steps // every):
        simulation.integrator.step(every)
        energies.append([energy._value / (30.0 * R) for energy in integrator.kineticEnergies()])
    return np.transpose(energies), integrator.degreesOfFreedom()


def assert_canonical(energies, freedoms):
    """Compare with chi-square: a KS test and a fourth central moment, each with a false alarm in a thousand."""
    for energy, f in zip(energies, freedoms, strict=True):
        assert stats.kstest(energy, "gamma", args=(0.5 * f,)).pvalue > 1e-3
        for power in (2, 4):
            mean, error = mean_and_error((energy - 0.5 * f) ** power)
            exact = 0.5 * f if power == 2 else 0.75 * f * f + 3.0 * f
            assert abs(mean - exact) < stats.t.isf(5e-4, 19) * error


@pytest.mark.validate
def test_kinetic_energies_are_canonical():
    energies, freedoms = canonical_energies(120_000, 24)
    assert_canonical(energies, freedoms)
    assert abs(np.corrcoef(energies)[0, 1]) < 0.05


@pytest.mark.validate
@pytest.mark.parametrize("together", [True, False])
def test_each_momentum_of_a_droplet_is_canonical(together):
    """Those of the centres, and the angular ones in the frame of the body along each axis."""
    integrator = nose_hoover(0.02, together=together)
    simulation = lopsided_droplet(integrator)
    integrator.setVelocitiesToTemperature(30.0, 3)
    simulation.integrator.step(500)
    series = []
    for _ in range(6000):
        simulation.integrator.step(20)
        bodies, state = integrator.bodyState()
        turns = bodies.principal_moments > 0.0
        angular = state.m[turns] ** 2 / bodies.principal_moments[turns]
        series.append(np.append((state.P**2 / bodies.mass).ravel(), angular) / (30.0 * R))
    for values in np.transpose(series):
        mean, error = mean_and_error(values)
        assert error < 0.1
        assert abs(mean - 1.0) < stats.t.isf(1e-5, 19) * error


# -- bits, and what persists ------------------------------------------------------------------------------------------

CHAINS = {"separate": {}, "together": {"together": True, "chainLength": 5}, "BAOAB": {"scheme": "BAOAB"}}


@pytest.fixture(params=CHAINS)
def options(request):
    return CHAINS[request.param]


def test_ten_times_ten_steps_are_a_hundred(options):
    once, often = (droplet_of(nose_hoover(**options)) for _ in range(2))
    once.integrator.step(100)
    for _ in range(10):
        often.integrator.step(10)
    assert snapshot(once) == snapshot(often)
    assert once.integrator.conservedEnergy() == often.integrator.conservedEnergy()


def test_a_thermostat_that_is_handed_over_makes_the_bits_of_the_integrator_named_after_it():
    named = nose_hoover()
    handed = rb.ExactRigidBodyIntegrator(H, "S2_2", thermostat=NoseHooverChain(30.0, FREQUENCY))
    runs = [droplet_of(integrator) for integrator in (named, handed)]
    for run in runs:
        run.integrator.step(20)
    assert snapshot(runs[0]) == snapshot(runs[1])
    assert named.getThermostat() == handed.getThermostat()


EVERYTHING = {"positions": True, "velocities": True, "parameters": True, "integratorParameters": True}


def saved(context, kind):
    if kind == "checkpoint":
        return context.createCheckpoint()
    return openmm.XmlSerializer.serialize(context.getState(**EVERYTHING))


def load(context, kind, what):
    if kind == "checkpoint":
        context.loadCheckpoint(what)
    else:
        context.setState(openmm.XmlSerializer.deserialize(what))


@pytest.mark.parametrize("kind", ["checkpoint", "State"])
def test_a_new_context_continues_with_the_same_bits(kind, options):
    run = droplet_of(nose_hoover(**options))
    run.integrator.step(6)
    taken = saved(run.context, kind)
    run.integrator.step(7)
    again = droplet_of(nose_hoover(**options))
    again.integrator.step(2)
    load(again.context, kind, taken)
    again.integrator.step(7)
    assert snapshot(again) == snapshot(run)
    assert again.integrator.conservedEnergy() == run.integrator.conservedEnergy()


def test_chains_outlive_a_reinitialisation():
    run = droplet_of(nose_hoover())
    run.integrator.step(6)
    before = run.integrator.conservedEnergy()._value
    run.context.reinitialize(preserveState=True)
    assert run.integrator.conservedEnergy()._value == pytest.approx(before, rel=1e-12)


def test_a_step_that_fails_leaves_the_chains_of_the_step_before():
    run, twin = droplet_of(nose_hoover()), droplet_of(nose_hoover())
    for each in (run, twin):
        each.integrator.step(5)
    run.integrator.setStepSize(1e3)
    with pytest.raises(rb.IntegrationError):
        run.integrator.step(1)
    run.integrator.setStepSize(H)
    for each in (run, twin):
        each.integrator.step(5)
    assert snapshot(run) == snapshot(twin)


# Whose checkpoints are rows of other numbers.
def langevin(engine="host"):
    return rb.ExactRigidBodyLangevinIntegrator(30.0, 2.0, H, engine=engine)


OTHERS = {
    "Langevin": langevin,
    "Langevin, auto": lambda: langevin("auto"),
    "constant energy": lambda: rb.ExactRigidBodyIntegrator(H, scheme="S2_2"),
    "processed": lambda: rb.ExactRigidBodyIntegrator(H, scheme="W4_4"),
    "device": lambda: langevin("device"),
    "shorter": lambda: nose_hoover(chainLength=2),
    "longer": lambda: nose_hoover(chainLength=4),
    "together": lambda: nose_hoover(together=True),
    "as many numbers": lambda: nose_hoover(together=True, chainLength=6),
}


@pytest.mark.parametrize("kind", ["checkpoint", "State"])
@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("there", [True, False], ids=["there", "back"])
def test_a_chain_is_never_read_from_other_numbers(other, there, kind):
    """Nor they from a chain: OpenMM puts the numbers of a checkpoint into any variables, in their order.

    States have names, and OpenMM itself refuses those of variables that an integrator does not have.
    """
    makers = (nose_hoover, OTHERS[other]) if there else (OTHERS[other], nose_hoover)
    if other == "device":  # on Reference it has no virtual sites
        source, target = (simulation_of(make(), *trapped(1, 1, 2)) for make in makers)
    else:
        source, target = (droplet_of(make()) for make in makers)
    for run in (source, target):
        run.integrator.step(4)
    good, bad = saved(target.context, kind), saved(source.context, kind)
    target.integrator.step(3)
    expected, refusals = snapshot(target), []

    def use_bad(how):
        load(target.context, kind, bad)
        how()

    for how in (lambda: target.integrator.step(1), target.integrator.temperatures):
        with pytest.raises((ValueError, openmm.OpenMMException)) as refusal:
            use_bad(how)
        refusals.append(str(refusal.value))
    ours, theirs = "is of another kind of integrator", "Illegal"
    assert all(ours in text or (kind == "State" and theirs in text) for text in refusals)
    load(target.context, kind, good)
    target.integrator.step(3)
    parted = kind == "State" and "Langevin" in type(target.integrator).__name__  # it goes on with noise of its own
    assert (snapshot(target) == expected) != parted


def test_numbers_of_another_integrator_are_noticed_where_positions_are_the_same():
    run = droplet_of(nose_hoover())
    other = droplet_of(langevin())
    other.integrator.step(3)
    for setter, name in ((run.context.setPositions, "Positions"), (run.context.setVelocities, "Velocities")):
        setter(getattr(other.context.getState(positions=True, velocities=True), f"get{name}")(asNumpy=True))
    run.integrator.temperatures()
    run.context.loadCheckpoint(other.context.createCheckpoint())
    for use in (run.integrator.conservedEnergy, lambda: run.integrator.setVelocitiesToTemperature(30.0)):
        with pytest.raises(ValueError, match="is of another kind of integrator"):
            use()


def test_a_checkpoint_of_openmm_s_own_integrator_is_refused():
    theirs = droplet_of(openmm.LangevinMiddleIntegrator(30.0, 2.0, 1e-4))
    theirs.step(2)
    run = droplet_of(nose_hoover())
    run.integrator.step(1)
    run.context.loadCheckpoint(theirs.context.createCheckpoint())
    with pytest.raises(ValueError, match="is of another kind of integrator"):
        run.integrator.step(1)


def test_equilibration_at_a_langevin_thermostat_is_handed_over_without_its_numbers():
    first = droplet_of(langevin())
    first.integrator.step(5)
    second = droplet_of(nose_hoover())
    rb.loadState(second, first.context.getState(**EVERYTHING))
    assert snapshot(second) == snapshot(first)
    second.integrator.step(2)
    assert second.context.getStepCount() == 7


def test_a_run_is_resumed_with_the_same_bits_and_only_with_the_same_chains(tmp_path):
    def advance(folder, until, **options):
        run = rb.Run(tmp_path / folder, resume=True)
        run.add_reporter(rb.EnergyReporter, "energies.csv", 7)
        run.advance(droplet_of(nose_hoover(**options)), until)

    advance("whole", 40)
    advance("parts", 22)
    changes = {"temperature": 31.0, "frequency": 21.0, "chainLength": 4, "numMTS": 2, "numYoshidaSuzuki": 5}
    for change in ({name: value} for name, value in (changes | {"together": True}).items()):
        with pytest.raises(ValueError, match="is of another run: integrator"):
            advance("parts", 40, **change)
    advance("parts", 40)
    files = [(tmp_path / folder / "energies.csv").read_text() for folder in ("whole", "parts")]
    assert files[0] == files[1]


# -- settings ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_copies_have_all_settings(copied):
    integrator = nose_hoover(0.004, 310.0, 15.0, chainLength=4, numMTS=2, numYoshidaSuzuki=5, together=True)
    twin = copied(integrator)
    assert type(twin) is type(integrator)
    assert twin.getThermostat() == integrator.getThermostat()
    assert twin.getSettings() == integrator.getSettings()
    assert twin.getSettings()["arguments"]["chainLength"] == 4
    assert rb.ExactRigidBodyNoseHooverIntegrator(**twin.getSettings()["arguments"]).getThermostat().together


def test_getters_and_setters_are_those_of_openmm():
    theirs, ours = openmm.NoseHooverIntegrator(310.0, 15.0, 0.002), nose_hoover(0.002, 300.0, 1.0)
    ours.setTemperature(310.0)
    ours.setCollisionFrequency(15.0)
    assert ours.getTemperature() == theirs.getTemperature()
    assert ours.getCollisionFrequency() == theirs.getCollisionFrequency()
    assert ours.getThermostat() == NoseHooverChain(310.0, 15.0)


def test_chains_stay_when_the_temperature_is_changed():
    run = droplet_of(nose_hoover())
    run.integrator.step(20)
    names = run.integrator.getThermostat().own_numbers
    before = [variables.get(run.integrator, name) for name in names]
    run.integrator.setTemperature(60.0)
    run.integrator.step(0)
    assert [variables.get(run.integrator, name) for name in names] == before


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"temperature": 0.0}, "a temperature and a collision frequency above zero"),
        ({"temperature": -1.0}, "a temperature must not be negative"),
        ({"collisionFrequency": 0.0}, "a temperature and a collision frequency above zero"),
        ({"collisionFrequency": -1.0}, "a temperature and a collision frequency above zero"),
        ({"collisionFrequency": math.inf}, "a collision frequency must be a finite number"),
        ({"collisionFrequency": 1.0 * openmm.unit.picosecond}, "is not a collision frequency"),
        ({"chainLength": 0}, "chainLength must be a whole number of at least 1"),
        ({"chainLength": 2.5}, "chainLength must be a whole number"),
        ({"numMTS": 0}, "numMTS must be a whole number of at least 1"),
        ({"numYoshidaSuzuki": 2}, "must be one of 1, 3, 5 and 7, not 2"),
        ({"numYoshidaSuzuki": [3]}, "numYoshidaSuzuki must be a whole number"),
        ({"together": 1}, "together must be True or False, not 1"),
        ({"scheme": "V2_C17"}, "V2_C17 runs in inner coordinates"),
    ],
)
def test_bad_settings_get_a_sentence(change, match):
    settings = {"temperature": 300.0, "collisionFrequency": 1.0, "stepSize": 0.002} | change
    with pytest.raises(ValueError, match=match):
        rb.ExactRigidBodyNoseHooverIntegrator(**settings)


def test_a_setting_that_is_refused_leaves_the_one_there_was():
    integrator = nose_hoover(temperature=300.0)
    for change in (integrator.setTemperature, integrator.setCollisionFrequency):
        with pytest.raises(ValueError, match="above zero"):
            change(0.0)
    assert integrator.getThermostat() == NoseHooverChain(300.0, FREQUENCY)


def test_the_device_refuses_it_and_auto_leaves_it_to_the_host():
    with pytest.raises(ValueError, match="the device supports the Langevin thermostat only, not NoseHooverChain"):
        nose_hoover(engine="device")
    integrator = nose_hoover(engine="auto")
    assert integrator.getEngine() == "host"
    assert "not NoseHooverChain" in integrator.engineNote()
    assert Langevin.on_device
    assert not NoseHooverChain.on_device


def test_a_chain_that_is_too_stiff_for_the_step_gets_a_sentence():
    run = droplet_of(nose_hoover(frequency=1e5))
    run.integrator.setVelocitiesToTemperature(60.0, 1)
    before = snapshot(run)
    with pytest.raises(rb.IntegrationError, match=r"a Nosé-Hoover chain diverged .* than 100000/ps"):
        run.integrator.step(5)
    assert snapshot(run) == before


def test_momenta_of_zero_stay():
    integrator = nose_hoover(temperature=300.0)
    simulation = simulation_of(integrator, *molecules(waters=1, ions=1))
    simulation.integrator.step(50)
    assert integrator.temperatures()[0]._value == integrator.temperatures()[1]._value == 0.0


# -- beside a barostat ------------------------------------------------------------------------------------------------


def test_a_barostat_of_the_same_temperature_acts_beside_it_and_another_one_is_refused():
    """On the ideal gas of its pressure: <V> = (N + 1) kT / P."""
    n, pressure = 20, 20.0
    integrator = nose_hoover(0.01, 300.0)
    context = ideal_gas(integrator, pressure, waters=10, ions=10)
    integrator.step(300)
    volumes, temperatures = [], []
    for _ in range(200):
        integrator.step(5)
        volumes.append(context.getState().getPeriodicBoxVolume()._value)
        temperatures.append([T._value for T in integrator.temperatures()])
    mean, error = mean_and_error(volumes)
    exact = (n + 1) * KT / (pressure * 0.06022140857)
    assert error < 0.1 * exact
    assert abs(mean - exact) < 4.0 * error
    for T in np.transpose(temperatures):
        mean, error = mean_and_error(T)
        assert abs(mean - 300.0) < max(4.0 * error, 3.0)
    integrator.setTemperature(310.0)
    with pytest.raises(ValueError, match="Barostat is at 300 K, the integrator at 310 K"):
        integrator.step(1)
