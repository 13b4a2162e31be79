"""openmmtools' moves and samplers, whose integrators are replaced where they are OpenMM's."""

import pytest
from openmm import unit

import openmm_exactrb as rb
from places import REFERENCE

pytestmark = pytest.mark.filterwarnings("ignore")
reason = "pip install 'openmm-exactrb[validation]'"
cache = pytest.importorskip("openmmtools.cache", reason=reason)
mcmc = pytest.importorskip("openmmtools.mcmc", reason=reason)
multistate = pytest.importorskip("openmmtools.multistate", reason=reason)
states = pytest.importorskip("openmmtools.states", reason=reason)

SYSTEM, START = rb.rigid_water(8)[1:]
FS, KELVIN = unit.femtosecond, unit.kelvin


@pytest.mark.parametrize(
    ("options", "time", "gain"),
    [({}, 20.0, 1.0), ({"interval": 4 * FS}, 40.0, 2.0), ({"interval": 4 * FS, "same_time": True}, 20.0, 2.0)],
)
def test_langevin_moves_are_ours(options, time, gain):
    with rb.replace_integrators(**options, report=None) as replaced:
        contexts, at = cache.ContextCache(platform=REFERENCE), states.ThermodynamicState(SYSTEM, 300 * KELVIN)
        move, sampled = mcmc.LangevinDynamicsMove(timestep=2 * FS, n_steps=10), states.SamplerState(START)
        for n in (1, 2, 3):
            move.apply(at, sampled, context_cache=contexts)
            context, integrator = contexts.get_context(at, move._get_integrator(at))  # noqa: SLF001
            assert isinstance(integrator, rb.ExactRigidBodyLangevinIntegrator)
            assert context.getTime().value_in_unit(FS) == pytest.approx(n * time)
        assert len(contexts) == 1
    assert replaced.gain == pytest.approx(gain)
    assert not replaced.others


@pytest.mark.parametrize("steps", [{}, {"interval": 4 * FS}])
def test_replica_exchange_is_stored_and_resumed(steps, tmp_path):
    file = str(tmp_path / "exchange.nc")
    at = [states.ThermodynamicState(SYSTEM, kelvin * KELVIN) for kelvin in (300, 320)]
    with rb.replace_integrators(**steps, report=None) as replaced:
        move = mcmc.LangevinDynamicsMove(timestep=2 * FS, n_steps=5)
        sampler = multistate.ReplicaExchangeSampler(mcmc_moves=move, number_of_iterations=2)
        sampler.create(at, states.SamplerState(START), multistate.MultiStateReporter(file, checkpoint_interval=1))
        sampler.run()
        del sampler
        resumed = multistate.ReplicaExchangeSampler.from_storage(multistate.MultiStateReporter(file, open_mode="r+"))
        resumed.extend(2)
    assert replaced.steps == 4 * 2 * 5


@pytest.mark.parametrize("kind", [mcmc.LangevinSplittingDynamicsMove, mcmc.GHMCMove, mcmc.HMCMove])
def test_integrators_of_openmmtools_are_named(kind):
    with rb.replace_integrators(report=None) as replaced:
        contexts, at = cache.ContextCache(platform=REFERENCE), states.ThermodynamicState(SYSTEM, 300 * KELVIN)
        kind(n_steps=2).apply(at, states.SamplerState(START), context_cache=contexts)
    (name,) = replaced.others
    assert name.endswith(" of openmmtools.integrators")
    assert not replaced.integrators
