"""The bits of runs at a thermostat: they depend on the settings, the seed and the number of the step alone."""

import hashlib
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import openmm_exactrb as rb
from chains import FREQUENCY, nose_hoover
from openmm_exactrb.context import variables
from openmm_exactrb.thermostats import HybridMonteCarlo, Langevin, NoseHooverChain, StochasticRescaling
from starts import droplet_of
from thermostatted import load, molecules, saved, simulation_of, snapshot

H = 0.01


def langevin(scheme="W2_3m", **options):
    return rb.ExactRigidBodyLangevinIntegrator(30.0, 2.0, H, scheme=scheme, **options)


MAKERS = {
    "W2_3m": langevin,
    "BAOAB": lambda: langevin("BAOAB"),
    "ABOBA": lambda: langevin("ABOBA", rotationalFriction=7.0),
    "rescaling": lambda: rb.ExactRigidBodyRescalingIntegrator(30.0, 0.1, H),
    "hybrid": lambda: rb.ExactRigidBodyHybridIntegrator(30.0, 2.0, 30 * H, stepsPerProposal=2),
}
#: Which have no noise.
CHAINS = {
    "chain": nose_hoover,
    "one chain": lambda: nose_hoover(together=True, chainLength=5),
    "chain in BAOAB": lambda: nose_hoover(scheme="BAOAB"),
}
ALL = MAKERS | CHAINS
#: What a run has besides positions and velocities.
OWN = {"hybrid": "tally", "rescaling": "heat"} | dict.fromkeys(CHAINS, "effectiveEnergy")


@pytest.fixture(params=MAKERS)
def maker(request):
    return MAKERS[request.param]


def seeded(make, seed=3):
    integrator = make()
    integrator.setRandomNumberSeed(seed)
    return integrator


@pytest.mark.parametrize("rotor", ["exact", "mclachlan_reich"])
@pytest.mark.parametrize("scheme", ["S2_2", "W2_4", "SRKN4_6b"])
def test_without_friction_it_is_the_trajectory_of_constant_energy(scheme, rotor):
    thermostatted = rb.ExactRigidBodyLangevinIntegrator(30.0, 0.0, H, scheme=scheme, rotor=rotor)
    alone = rb.ExactRigidBodyIntegrator(H, scheme=scheme, rotor=rotor)
    runs = [droplet_of(integrator) for integrator in (thermostatted, alone)]
    for run in runs:
        run.step(50)
    assert snapshot(runs[0]) == snapshot(runs[1])
    assert thermostatted.timings.evaluations == alone.timings.evaluations


def of_its_own(run, name):
    """Return what a run has besides positions and velocities."""
    return getattr(run.integrator, OWN[name])() if name in OWN else None


@pytest.mark.parametrize("name", ALL)
def test_ten_times_ten_steps_are_a_hundred(name):
    once, often = (droplet_of(seeded(ALL[name])) for _ in range(2))
    once.integrator.step(100)
    for _ in range(10):
        often.integrator.step(10)
    assert snapshot(once) == snapshot(often)
    assert of_its_own(once, name) == of_its_own(often, name)


THERMOSTATS = {
    "W2_3m": ("W2_3m", Langevin(30.0, 2.0)),
    "BAOAB": ("BAOAB", Langevin(30.0, 2.0)),
    "ABOBA": ("ABOBA", Langevin(30.0, 2.0, rotationalFriction=7.0)),
    "rescaling": ("BAOA", StochasticRescaling(30.0, 0.1)),
    "hybrid": ("S2_2", HybridMonteCarlo(30.0, 2.0, stepsPerProposal=2)),
    "chain": ("S2_2", NoseHooverChain(30.0, FREQUENCY)),
}


@pytest.mark.parametrize("name", THERMOSTATS)
def test_a_thermostat_that_is_handed_over_makes_the_bits_of_the_integrator_named_after_it(name):
    named, (scheme, thermostat) = seeded(ALL[name]), THERMOSTATS[name]
    handed = rb.ExactRigidBodyIntegrator(named.getStepSize(), scheme, thermostat=thermostat)
    handed.setRandomNumberSeed(3)
    runs = [droplet_of(integrator) for integrator in (named, handed)]
    for run in runs:
        run.integrator.step(20)
    assert snapshot(runs[0]) == snapshot(runs[1])
    assert handed.getThermostat() == named.getThermostat() == thermostat


def test_another_seed_is_another_trajectory(maker):
    runs = [droplet_of(seeded(maker, seed)) for seed in (3, 4)]
    for run in runs:
        run.integrator.step(2)
    assert snapshot(runs[0]) != snapshot(runs[1])


def test_each_heat_exchange_of_a_step_has_noise_of_its_own():
    """From rest a step gives T (1 - a⁴) if a half leaves a of momenta; with one noise for both T (1 - a²)(1 + a)²."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 2.0 * np.log(2.0) / H, H)  # a = 1/2
    integrator.setRandomNumberSeed(1)
    simulation = simulation_of(integrator, *molecules(ions=4000))
    simulation.step(1)
    translational, _ = integrator.temperatures()
    width = 300.0 * np.sqrt(2.0 / 12_000)
    assert abs(translational._value - 300.0 * (1.0 - 1.0 / 16.0)) < 4.0 * width


GO_ON = """
import hashlib, pickle, sys
sys.path[:0] = sys.argv[1:3]
import test_bits
from starts import droplet_of
from thermostatted import load, snapshot
for (name, kind), saved in pickle.load(open(sys.argv[3], "rb")).items():
    run = droplet_of(test_bits.ALL[name]())
    run.integrator.setVelocitiesToTemperature(500.0, 1)
    load(run.context, kind, saved)
    run.step(7)
    print(name, kind, hashlib.sha256(snapshot(run)).hexdigest(), test_bits.of_its_own(run, name), sep=", ")
"""


def test_a_new_process_continues_with_the_same_bits(tmp_path):
    """A drawn seed, the heat, the tally and the chains travel with checkpoints and States."""
    contents, expected = {}, []
    for name, make in ALL.items():
        run = droplet_of(make())
        run.integrator.step(6)
        contents |= {(name, kind): saved(run.context, kind) for kind in ("checkpoint", "State")}
        run.integrator.step(7)
        own, digest = of_its_own(run, name), hashlib.sha256(snapshot(run)).hexdigest()
        expected += [f"{name}, {kind}, {digest}, {own}" for kind in ("checkpoint", "State")]
    file = tmp_path / "saved"
    file.write_bytes(pickle.dumps(contents))
    here = Path(__file__).parent
    arguments = [sys.executable, "-c", GO_ON, str(here), str(here.parent / "common"), str(file)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == expected


def plain_langevin(temperature=30.0, friction=2.0):
    return rb.ExactRigidBodyLangevinIntegrator(temperature, friction, H)


OTHER_CHAINS = {"frequency": 21.0, "chainLength": 4, "numMTS": 2, "numYoshidaSuzuki": 5, "together": True}


@pytest.mark.parametrize(("make", "others"), [(plain_langevin, {"friction": 2.5}), (nose_hoover, OTHER_CHAINS)])
def test_a_run_is_resumed_with_the_same_bits_and_only_with_the_same_thermostat(tmp_path, make, others):
    def advance(folder, until, seed=3, **options):
        run = rb.Run(tmp_path / folder, resume=True)
        run.add_reporter(rb.EnergyReporter, "energies.csv", 7)
        run.advance(droplet_of(seeded(lambda: make(**options), seed)), until)

    advance("whole", 40)
    advance("parts", 22)
    for name, value in ({"temperature": 31.0, "seed": 4} | others).items():
        with pytest.raises(ValueError, match="belongs to another run, in which integrator"):
            advance("parts", 40, **{name: value})
    advance("parts", 40)
    files = [(tmp_path / folder / "energies.csv").read_text(encoding="utf-8") for folder in ("whole", "parts")]
    assert files[0] == files[1]


def test_a_seed_of_zero_is_drawn_once_and_kept():
    runs = [droplet_of(langevin()) for _ in range(2)]
    for run in runs:
        assert run.integrator.getSeedInUse() == 0
        run.integrator.step(1)
    seeds = [run.integrator.getSeedInUse() for run in runs]
    assert min(seeds) > 0
    assert seeds[0] != seeds[1]
    runs[0].integrator.step(3)
    assert runs[0].integrator.getSeedInUse() == seeds[0]
    assert runs[0].integrator.getRandomNumberSeed() == 0
    again = droplet_of(seeded(langevin, seeds[0]))
    again.integrator.step(4)
    assert snapshot(again) == snapshot(runs[0])


def test_a_reinitialised_context_has_the_seed_that_was_set():
    run = droplet_of(langevin())
    run.integrator.setRandomNumberSeed(9)
    run.context.reinitialize(preserveState=True)
    run.integrator.step(1)
    assert run.integrator.getSeedInUse() == 9


def test_a_step_takes_the_forces_of_its_sequence():
    for scheme, evaluations in (("BAOAB", 21), ("ABOBA", 20), ("BAOA", 20), ("W2_3", 61), ("W2_3m", 60)):
        integrator = langevin(scheme)
        integrator.checkDivergence = False  # which asks for energies
        simulation = droplet_of(integrator)
        integrator.step(20)
        assert integrator.timings.evaluations == evaluations
        assert simulation.context.getStepCount() == 20
        assert integrator.forceEvaluationsPerStep == evaluations // 20
        assert integrator.getScheme().name == scheme


@pytest.mark.parametrize("maker", MAKERS.values(), ids=MAKERS)
def test_a_state_that_is_set_again_continues_with_other_noise_and_a_checkpoint_with_the_same(maker):
    run = droplet_of(seeded(maker))
    run.integrator.step(6)
    state = run.context.getState(positions=True, velocities=True, parameters=True, integratorParameters=True)
    checkpoint = run.context.createCheckpoint()
    ends = []
    for take_back in (
        lambda: None,
        lambda: run.context.setState(state),
        lambda: run.context.setState(state),
        lambda: run.context.loadCheckpoint(checkpoint),
        lambda: run.context.loadCheckpoint(checkpoint),
    ):
        take_back()
        run.integrator.step(20)
        ends.append(snapshot(run))
    assert len(set(ends)) == 3
    assert ends[0] == ends[3] == ends[4]


def test_noise_of_a_step_count_that_was_set_back_is_new_and_repeats_itself_in_a_new_run():
    ends = []
    for _ in range(2):
        run = droplet_of(seeded(langevin))
        start = run.context.getState(positions=True, velocities=True)
        for _ in range(2):
            run.context.setPositions(start.getPositions())
            run.context.setVelocities(start.getVelocities())
            run.context.setStepCount(0)
            run.integrator.step(20)
            ends.append(snapshot(run))
    assert ends[0] != ends[1]
    assert ends[:2] == ends[2:]


@pytest.mark.parametrize("seed", [0, 5])
def test_a_context_that_begins_again_has_other_noise_unless_a_seed_is_set(seed):
    """As OpenMM's integrators."""
    run, ends = droplet_of(seeded(langevin, seed)), []
    start = run.context.getState(positions=True, velocities=True)
    for _ in range(2):
        run.context.setPositions(start.getPositions())
        run.context.setVelocities(start.getVelocities())
        run.integrator.step(20)
        ends.append(snapshot(run))
        run.context.reinitialize()
    assert (ends[0] == ends[1]) == (seed > 0)


def test_runs_with_seeds_of_their_own_differ_though_they_begin_with_one_state():
    first = droplet_of(langevin())
    first.integrator.step(5)
    state = first.context.getState(positions=True, velocities=True, parameters=True, integratorParameters=True)
    ends = []
    for seed in (11, 22):
        run = droplet_of(seeded(langevin, seed))
        run.context.setState(state)
        run.integrator.step(20)
        assert run.integrator.getSeedInUse() == seed
        ends.append(snapshot(run))
    assert ends[0] != ends[1]


@pytest.mark.parametrize("kind", ["checkpoint", "State"])
@pytest.mark.parametrize("before", MAKERS)
def test_integrators_of_other_kinds_continue_from_it(before, kind):
    """Constant temperature hands over to constant energy, and none takes numbers of another one for its own."""
    run = droplet_of(seeded(MAKERS[before]))
    run.integrator.step(7)
    content = saved(run.context, kind)
    alone = rb.ExactRigidBodyIntegrator(H, scheme="S2_2")
    for integrator in (alone, MAKERS["rescaling"](), MAKERS["hybrid"](), langevin()):
        other = droplet_of(integrator)
        load(other.context, kind, content)
        assert snapshot(other) == snapshot(run)
        if before != "hybrid" and isinstance(integrator, rb.ExactRigidBodyHybridIntegrator):
            assert integrator.tally().proposed == 0
        if before != "rescaling" and isinstance(integrator, rb.ExactRigidBodyRescalingIntegrator):
            assert integrator.heat()._value == 0.0
        other.integrator.step(2)
        assert other.context.getStepCount() == 9


def test_noise_is_another_one_after_each_of_many_states():
    run = droplet_of(seeded(langevin))
    run.integrator.step(1)
    streams = {variables.get(run.integrator, variables.STREAM)}
    for _ in range(5000):
        run.context.setStepCount(1)
        streams.add(variables.get(run.integrator, variables.STREAM))
    assert len(streams) == 5001


def test_a_checkpoint_before_the_first_step_has_the_noise_that_follows():
    """A run that a script sets back to step 0 after its equilibration, killed before its second checkpoint."""
    run = droplet_of(seeded(langevin))
    run.integrator.step(20)
    run.context.setStepCount(0)
    checkpoint = run.context.createCheckpoint()
    ends = []
    for _ in range(2):
        run.integrator.step(20)
        ends.append(snapshot(run))
        run.context.loadCheckpoint(checkpoint)
    assert ends[0] == ends[1]
    run.integrator.temperatures()
    run.context.reinitialize(preserveState=True)
    run.integrator.step(20)
    assert snapshot(run) == ends[0]


def test_a_run_that_starts_over_after_equilibration_is_resumed_with_the_same_bits(tmp_path):
    ends = []
    for folder, stops in (("whole", [30]), ("parts", [0, 10, 30])):
        for until in stops:
            run = rb.Run(tmp_path / folder, resume=True)
            run.add_reporter(rb.EnergyReporter, "energies.csv", 10)
            simulation = droplet_of(seeded(langevin))
            if not run.resuming:
                simulation.step(20)
                simulation.currentStep = 0
            run.advance(simulation, until)
        ends.append(snapshot(simulation))
    assert ends[0] == ends[1]


def test_setting_a_seed_restarts_its_noise():
    run = droplet_of(langevin())
    state = run.context.getState(positions=True, velocities=True)
    ends = []
    for seed in (7, 7, 8, 7):
        run.context.setState(state)
        run.integrator.setRandomNumberSeed(seed)
        run.integrator.step(4)
        ends.append(snapshot(run))
    assert ends[0] == ends[1] == ends[3] != ends[2]
