"""`ExactRigidBodyMove` in openmmtools' samplers: time, copies, storage, resuming, barostats, Monte Carlo moves."""

import copy
import pickle
import warnings

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from places import REFERENCE, device_platform

pytestmark = pytest.mark.filterwarnings("ignore")
reason = "pip install 'openmm-exactrb[validation]'"
cache = pytest.importorskip("openmmtools.cache", reason=reason)
mcmc = pytest.importorskip("openmmtools.mcmc", reason=reason)
multistate = pytest.importorskip("openmmtools.multistate", reason=reason)
states = pytest.importorskip("openmmtools.states", reason=reason)
from openmm_exactrb.openmmtools import ExactRigidBodyMove  # noqa: E402  # which needs openmmtools

SYSTEM, START = rb.rigid_water(8)[1:]
KELVIN, PS, FS = unit.kelvin, unit.picosecond, unit.femtosecond


@pytest.fixture(autouse=True)
def shared():
    """Return the cache of all samplers, empty before and after each test."""
    contexts = cache.global_context_cache
    contexts.empty()
    contexts.set_platform(REFERENCE)
    yield contexts
    contexts.empty()


def state_at(kelvin=300.0, system=SYSTEM, **more):
    return states.ThermodynamicState(system, kelvin * KELVIN, **more)


def same(move):
    return move


@pytest.mark.parametrize("copied", [same, copy.deepcopy, lambda move: pickle.loads(pickle.dumps(move))])
@pytest.mark.parametrize("scheme", ["BAOA", "W2_3m"])
def test_an_application_takes_the_number_of_steps_times_the_timestep(copied, scheme):
    contexts = cache.ContextCache(platform=REFERENCE)
    move = copied(ExactRigidBodyMove(3 * FS, 5 / PS, n_steps=7, scheme=scheme, engine="host"))
    sampled = states.SamplerState(START)
    for n in (1, 2):
        move.apply(state_at(), sampled, context_cache=contexts)
        context, integrator = contexts.get_context(state_at(), move._get_integrator(state_at()))  # noqa: SLF001
        assert type(integrator) is rb.ExactRigidBodyLangevinIntegrator
        assert (integrator.getEngine(), integrator.getScheme().name) == ("host", scheme)
        assert context.getTime()._value == pytest.approx(n * 7 * 0.003, rel=1e-12)


def test_contexts_are_shared_by_moves_of_equal_settings_alone():
    contexts = cache.ContextCache(platform=REFERENCE)
    for kelvin in (300.0, 320.0):
        for scheme in ("BAOA", "W2_3m"):
            for rate in (1.0, 5.0):
                move = ExactRigidBodyMove(2 * FS, rate / PS, n_steps=1, scheme=scheme)
                move.apply(state_at(kelvin), states.SamplerState(START), context_cache=contexts)
                _, integrator = contexts.get_context(state_at(kelvin), move._get_integrator(state_at(kelvin)))  # noqa: SLF001
                found = integrator.getScheme().name, integrator.getFriction()._value, integrator.getTemperature()._value
                assert found == (scheme, rate, kelvin)
    assert len(contexts) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scheme": "W2_1"}, "W2_1"),
        ({"timestep": -1 * FS}, "time step"),
        ({"timestep": 300 * KELVIN}, "step size"),
        ({"collision_rate": -1 / PS}, "friction"),
        ({"engine": "gpu"}, "engine"),
    ],
)
def test_invalid_arguments_are_named_when_the_move_is_made(arguments, message):
    with pytest.raises(ValueError, match=message):
        ExactRigidBodyMove(**arguments)


def exchange(storage, sampler=None, move=None):
    """Return a replica exchange of water at three temperatures, stored in a file."""
    sampler = sampler or multistate.ReplicaExchangeSampler(
        mcmc_moves=move or ExactRigidBodyMove(4 * FS, 5 / PS, n_steps=5, scheme="W2_3m"), number_of_iterations=4
    )
    reporter = multistate.MultiStateReporter(str(storage), checkpoint_interval=1)
    sampler.create([state_at(T) for T in (300.0, 320.0, 345.0)], [states.SamplerState(START)] * 3, reporter)
    return sampler


def test_a_replica_exchange_is_stored_and_resumed(tmp_path):
    sampler = exchange(tmp_path / "exchange.nc")
    sampler.run(2)
    before = [state.positions / unit.nanometer for state in sampler.sampler_states]
    del sampler
    reporter = multistate.MultiStateReporter(str(tmp_path / "exchange.nc"), open_mode="r+")
    resumed = multistate.ReplicaExchangeSampler.from_storage(reporter)
    for move in resumed.mcmc_moves:
        assert type(move) is ExactRigidBodyMove
        assert (move.timestep, move.collision_rate, move.scheme, move.n_steps) == (4 * FS, 5 / PS, "W2_3m", 5)
    after = [state.positions / unit.nanometer for state in resumed.sampler_states]
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-6)
    resumed.run(2)
    assert resumed.iteration == 4
    moved = [state.positions / unit.nanometer for state in resumed.sampler_states]
    assert np.abs(np.array(moved) - after).max() > 1e-3


def test_moves_in_a_sequence_with_monte_carlo_and_a_barostat():
    _, system, positions = rb.rigid_water(64, nonbondedMethod=app.PME, nonbondedCutoff=0.5)
    system.addForce(openmm.MonteCarloBarostat(1.0, 300.0, 2))
    state = state_at(300.0, system, pressure=1.0 * unit.atmosphere)
    rotation = mcmc.MCRotationMove(atom_subset=[0, 1, 2])
    moves = mcmc.SequenceMove([ExactRigidBodyMove(2 * FS, 5 / PS, n_steps=6), rotation])
    sampled = states.SamplerState(positions, box_vectors=system.getDefaultPeriodicBoxVectors())
    volume, contexts = sampled.volume, cache.ContextCache(platform=REFERENCE)
    for _ in range(3):
        moves.apply(state, sampled, context_cache=contexts)
    assert rotation.n_proposed == 3
    assert sampled.volume != volume
    x = sampled.positions / unit.nanometer
    for k in range(system.getNumConstraints()):
        i, j, length = system.getConstraintParameters(k)
        assert np.linalg.norm(x[i] - x[j]) == pytest.approx(length._value, rel=1e-6)


@pytest.mark.opencl
def test_a_sequence_with_monte_carlo_moves_is_resumed_on_a_device(tmp_path, shared):
    shared.set_platform(device_platform(), {"Precision": "mixed"})
    _, system, positions = rb.rigid_water(64, nonbondedMethod=app.PME, nonbondedCutoff=0.5)
    system.addForce(openmm.MonteCarloBarostat(1.0, 300.0, 2))
    ladder = [state_at(kelvin, system, pressure=1.0 * unit.atmosphere) for kelvin in (300.0, 320.0)]
    move = ExactRigidBodyMove(2 * FS, 5 / PS, n_steps=6, engine="native")
    moves = mcmc.SequenceMove([mcmc.MCRotationMove(atom_subset=[0, 1, 2]), move])
    sampler = multistate.ReplicaExchangeSampler(mcmc_moves=moves, number_of_iterations=4)
    reporter = multistate.MultiStateReporter(str(tmp_path / "exchange.nc"), checkpoint_interval=1)
    start = states.SamplerState(positions, box_vectors=system.getDefaultPeriodicBoxVectors())
    sampler.create(ladder, start, reporter)
    sampler.run(2)
    before = [(state.positions / unit.nanometer, state.velocities._value) for state in sampler.sampler_states]
    volumes = [state.volume / unit.nanometer**3 for state in sampler.sampler_states]
    del sampler
    reporter = multistate.MultiStateReporter(str(tmp_path / "exchange.nc"), open_mode="r+")
    resumed = multistate.ReplicaExchangeSampler.from_storage(reporter)
    for (x, v), volume, state in zip(before, volumes, resumed.sampler_states, strict=True):
        np.testing.assert_allclose(state.positions / unit.nanometer, x, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(state.velocities._value, v, rtol=0.0, atol=1e-5)
        assert state.volume / unit.nanometer**3 == pytest.approx(volume, rel=1e-6)
    resumed.run()
    assert resumed.iteration == 4
    assert [[type(one).__name__ for one in moves] for moves in resumed.mcmc_moves] == [
        ["MCRotationMove", "ExactRigidBodyMove"]
    ] * 2
    assert [moves.statistics[0]["n_proposed"] for moves in resumed.mcmc_moves] == [4, 4]
    _, integrator = shared.get_context(ladder[0], move._get_integrator(ladder[0]))  # noqa: SLF001
    assert integrator.getEngine() == "native"


@pytest.mark.parametrize("engine", ["native", "host"])
def test_each_application_has_noise_and_heat_of_its_own(engine):
    heats = []

    class Told(ExactRigidBodyMove):
        def _before_integration(self, context, _):
            assert context.getIntegrator().heat()._value == 0.0

        def _after_integration(self, context, _):
            heats.append(context.getIntegrator().heat()._value)

    contexts, move, found = cache.ContextCache(platform=REFERENCE), Told(2 * FS, 5 / PS, n_steps=5, engine=engine), []
    for _ in range(3):
        sampled = states.SamplerState(START, velocities=np.zeros((24, 3)) * unit.nanometer / PS)
        move.apply(state_at(), sampled, context_cache=contexts)
        found.append(np.array(sampled.positions / unit.nanometer))
    assert len(contexts) == 1
    assert len({*heats, 0.0}) == 4
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(found[i] - found[j]).max() > 1e-4


def test_replicas_are_at_rest_after_their_minimisation(tmp_path):
    sampler = exchange(tmp_path / "exchange.nc")
    sampler.minimize(max_iterations=2)
    assert all(np.abs(state.velocities._value).max() == 0.0 for state in sampler.sampler_states)


LONG = {"timestep": 40 * FS, "collision_rate": 1 / PS, "n_steps": 200}


@pytest.fixture
def crowded():
    """Return a thermodynamic state of water and its positions, for a step that is too long."""
    _, system, positions = rb.rigid_water(64, nonbondedMethod=app.PME, nonbondedCutoff=0.5)
    return state_at(300.0, system), states.SamplerState(positions, box_vectors=system.getDefaultPeriodicBoxVectors())


@pytest.mark.parametrize("platform", ["Reference", "CPU"])
@pytest.mark.parametrize("engine", ["native", "host"])
def test_steps_that_fail_are_tried_again_and_then_raise_what_openmmtools_expects(engine, platform, crowded, tmp_path):
    state, sampled = crowded
    start = np.array(sampled.positions / unit.nanometer)
    contexts = cache.ContextCache(platform=openmm.Platform.getPlatform(platform))
    move = ExactRigidBodyMove(**LONG, reassign_velocities=True, n_restart_attempts=2, engine=engine)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with pytest.raises(mcmc.IntegratorMoveError, match="NaN after 2 attempts of integration") as raised:
            move.apply(state, sampled, context_cache=contexts)
    messages = [str(warning.message) for warning in told if "step " in str(warning.message)]
    assert len(messages) == 3
    np.testing.assert_array_equal(sampled.positions / unit.nanometer, start)
    raised.value.serialize_error(str(tmp_path / "logs" / "failed"))
    stored = (tmp_path / "logs" / "failed-integrator.xml").read_text(encoding="utf-8")
    assert type(openmm.XmlSerializer.deserialize(stored)) is rb.ExactRigidBodyLangevinIntegrator
    # The Context that is shared serves moves that do not fail.
    ExactRigidBodyMove(1 * FS, 1 / PS, n_steps=5, engine=engine).apply(state, sampled, context_cache=contexts)
    assert len(contexts) == 1
    assert 0.0 < np.abs(np.array(sampled.positions / unit.nanometer) - start).max() < 0.1


def test_a_sampler_stops_with_its_own_error_and_writes_what_failed(crowded, tmp_path):
    state, sampled = crowded
    move = ExactRigidBodyMove(**LONG, reassign_velocities=True, n_restart_attempts=1)
    sampler = multistate.MultiStateSampler(mcmc_moves=move, number_of_iterations=1)
    sampler.create([state], sampled, multistate.MultiStateReporter(str(tmp_path / "run.nc")))
    sampler.sampler_context_cache = cache.ContextCache(platform=openmm.Platform.getPlatform("CPU"))
    with pytest.raises(multistate.SimulationNaNError, match="Propagating replica 0 at state 0"):
        sampler.run()
    assert len([*(tmp_path / "nan-error-logs").iterdir()]) == 4
