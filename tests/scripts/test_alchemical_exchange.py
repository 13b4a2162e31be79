"""OpenMM's `ReplicaExchangeSampler` over alchemical states: parameters, heat, noise, volumes, resuming."""

import functools

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
import starts

pytestmark = [
    pytest.mark.skipif(not hasattr(app, "ReplicaExchangeSampler"), reason="this OpenMM has no ReplicaExchangeSampler"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # of OpenMM's reporter, which leaves files open
]
LADDER = [{"sterics": 1.0, "charges": 1.0}, {"sterics": 1.0, "charges": 0.0}, {"sterics": 0.3, "charges": 0.0}]
ENGINES = pytest.mark.parametrize("engine", ["native", "host"])
PLACES = pytest.mark.parametrize(("engine", "platform"), [("native", "Reference"), ("host", "CPU")])
STEP = 0.004


@functools.cache
def fading_water():
    """Return water in a box, one molecule of which fades: its charges, and a soft repulsion from the others."""
    topology, system, positions = rb.rigid_water(27, nonbondedMethod=app.PME, nonbondedCutoff=0.4)
    (coulomb,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    coulomb.addGlobalParameter("charges", 1.0)
    soft = openmm.CustomNonbondedForce("sterics*5*(1-r/0.4)^2")
    soft.addGlobalParameter("sterics", 1.0)
    soft.setNonbondedMethod(soft.CutoffPeriodic)
    soft.setCutoffDistance(0.4)
    soft.addInteractionGroup([0], range(3, 81))
    for _ in range(81):
        soft.addParticle([])
    for k in range(coulomb.getNumExceptions()):
        soft.addExclusion(*coulomb.getExceptionParameters(k)[:2])
    for i in range(3):
        charge, sigma, epsilon = coulomb.getParticleParameters(i)
        coulomb.setParticleParameters(i, 0.0, sigma, epsilon)
        coulomb.addParticleParameterOffset("charges", i, charge, 0.0, 0.0)
    system.addForce(soft)
    return topology, system, positions


def simulation_of(engine, platform="Reference", friction=0.0, barostat=False, seed=None):
    """Return a warm Simulation; without friction it has no noise."""
    topology, system, positions = fading_water()
    system = openmm.XmlSerializer.clone(system)
    if barostat:
        system.addForce(openmm.MonteCarloBarostat(1.0, 300.0, 2))
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, friction, STEP, scheme="BAOA", engine=engine)
    if seed is not None:
        integrator.setRandomNumberSeed(seed)
    simulation = starts.simulation_of(
        topology, system, integrator, positions, platform=openmm.Platform.getPlatform(platform)
    )
    simulation.minimizeEnergy(maxIterations=20)
    simulation.context.setVelocitiesToTemperature(300.0, 1)
    return simulation


def positions_of(states):
    return np.array([state.getPositions(asNumpy=True)._value for state in states])


@PLACES
def test_replicas_move_as_separate_runs_in_their_states(engine, platform):
    """With exchanges between, after which a replica has other parameters."""
    simulation = simulation_of(engine, platform)
    start = simulation.context.getState(positions=True, velocities=True)
    sampler, visited = app.ReplicaExchangeSampler(LADDER, simulation, 10), []
    sampler.reporters.append(lambda sampler: visited.append([*sampler.replicaStateIndex]))
    sampler.exchangeReplicas = lambda: sampler.replicaStateIndex.insert(0, sampler.replicaStateIndex.pop())
    sampler.simulate(3)
    assert visited == [[0, 1, 2], [2, 0, 1], [1, 2, 0]]
    expected, energies = [], []
    for states in zip(*visited, strict=True):
        alone = simulation_of(engine, platform)
        alone.context.setState(start)
        for state in states:
            for name, value in LADDER[state].items():
                alone.context.setParameter(name, value)
            alone.integrator.step(10)
        expected.append(alone.context.getState(positions=True))
        energies.append(alone.context.getState(energy=True).getPotentialEnergy()._value)
    found, close = positions_of(sampler.replicaConformation), 1e-9 if platform == "Reference" else 2e-4
    np.testing.assert_allclose(found, positions_of(expected), rtol=0.0, atol=close)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(found[i] - found[j]).max() > 50.0 * close
    own = [sampler.replicaStateEnergy[k][visited[-1][k]]._value for k in range(3)]
    np.testing.assert_allclose(own, energies, rtol=0.0, atol=1e-6 if platform == "Reference" else 0.5)


@ENGINES
@pytest.mark.parametrize("seed", [None, 5])
def test_replicas_have_noise_of_their_own_in_equal_states(engine, seed):
    simulation = simulation_of(engine, friction=5.0, seed=seed)
    sampler = app.ReplicaExchangeSampler([LADDER[0]] * 3, simulation, 5)
    sampler.simulate(2)
    x = positions_of(sampler.replicaConformation)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.abs(x[i] - x[j]).max() > 1e-3


def heats(sampler):
    """Return the heat that the thermostat has supplied to each replica, in kJ/mol."""
    found = []
    for state in sampler.replicaConformation:
        sampler.simulation.context.setState(state)
        found.append(sampler.simulation.integrator.heat()._value)
    return np.array(found)


@PLACES
def test_each_replica_has_its_heat_volume_and_step_also_when_resumed(engine, platform, tmp_path):
    settings = {"energy": True, "volume": True, "checkpoints": True}
    sampler = app.ReplicaExchangeSampler(LADDER, simulation_of(engine, platform, 5.0, barostat=True), 10)
    assert type(sampler.simulation.context.getIntegrator()) is rb.ExactRigidBodyLangevinIntegrator
    sampler.reporters.append(app.ReplicaExchangeReporter(str(tmp_path), 1, sampler, **settings))
    sampler.simulate(3)
    before = heats(sampler)
    assert len({round(heat, 6) for heat in before}) == 3
    volumes = {state.getPeriodicBoxVolume()._value for state in sampler.replicaConformation}
    assert len(volumes) == 3
    again = app.ReplicaExchangeSampler(LADDER, simulation_of(engine, platform, 5.0, barostat=True), 10)
    again.reporters.append(app.ReplicaExchangeReporter(str(tmp_path), 1, again, resume=True, **settings))
    np.testing.assert_allclose(heats(again), before, rtol=1e-12)
    again.simulate(2)
    assert again.currentIteration == 5
    assert {state.getStepCount() for state in again.replicaConformation} == {50}
    assert {round(state.getTime()._value, 9) for state in again.replicaConformation} == {round(50 * STEP, 9)}
    energies = np.loadtxt(tmp_path / "energy.csv", delimiter=",").reshape(-1, 3, 3)
    assert energies.shape == (5, 3, 3)
    assert np.isfinite(energies).all()
    assert np.abs(np.diff(energies, axis=2)).min() > 0.0


@ENGINES
def test_states_of_temperature_and_parameters_set_both(engine):
    ladder = [state | {"temperature": T * unit.kelvin} for state, T in zip(LADDER, (300, 320, 345), strict=True)]
    simulation, found = simulation_of(engine, friction=5.0), []
    sampler = app.ReplicaExchangeSampler(ladder, simulation, 5)

    step = simulation.integrator.step

    def counted(n):
        parameters = dict(simulation.context.getParameters())
        found.append((simulation.integrator.getTemperature()._value, parameters["sterics"], parameters["charges"]))
        step(n)

    simulation.integrator.step = counted
    sampler.simulate(1)
    assert found == [(T, state["sterics"], state["charges"]) for state, T in zip(LADDER, (300, 320, 345), strict=True)]
