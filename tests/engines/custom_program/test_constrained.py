"""Flexible molecules with constraints, and inner steps, by the program of the device; on the Reference platform."""

import copy

import numpy as np
import openmm
import pytest
from devices import REFERENCE, seeded, shown, stepped
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.schemes import WITH_THERMOSTAT
from peptides import in_water, peptide, violations

# Differences (nm) from the host, which follows the geodesics of constraints: of RATTLE over drifts of half a
# femtosecond, and over 20 steps.
RATTLE = 2e-7


def separated(system):
    """Return a System whose bonded forces are in group 1."""
    assert rb.separate_bonded(system) == 1
    return system


def moving(system, x, engine="device", v=None, friction=None, seed=7, **options):
    """Return a Context of a copy of a System, at 300 K or with some velocities."""
    arguments = {"scheme": "S2_2", "stepSize": 0.002, "engine": engine} | options
    if friction is None:
        integrator = rb.ExactRigidBodyIntegrator(**arguments)
    else:
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, friction, **arguments)
        integrator.setRandomNumberSeed(seed)
    context = openmm.Context(copy.deepcopy(system), integrator, REFERENCE)
    context.setPositions(x)
    if v is None:
        v = velocities(system, x)
    context.setVelocities(v)
    return context


def velocities(system, x):
    """Return velocities at 300 K that the constraints allow."""
    context = openmm.Context(copy.deepcopy(system), openmm.VerletIntegrator(0.001), REFERENCE)
    context.setPositions(x)
    context.applyConstraints(1e-12)
    context.setVelocitiesToTemperature(300.0, 3)
    context.applyVelocityConstraints(1e-12)
    return shown(context)[1]


def difference(system, x, n=20, **options):
    """Return by how much (nm) positions differ from those of the host behind n steps, and the device's Context."""
    host, device = (moving(system, x, engine, **options) for engine in ("host", "device"))
    ends = [stepped(context, n)[0] for context in (host, device)]
    assert device.getIntegrator().getEngine() == "device"
    assert np.abs(ends[0] - x).max() > 1e-3
    return np.abs(ends[1] - ends[0]).max(), device


@pytest.mark.parametrize(
    ("scheme", "steps", "friction"),
    [("S2_2", 8, None), ("S2_3", 9, None), ("W4_5", 10, None), ("BAOA", 8, 0.0), ("W2_3m", 9, 0.0)],
)
def test_a_peptide_with_inner_steps_moves_as_on_the_host(scheme, steps, friction):
    _, system, x = peptide()
    options = {"fast": (1,), "inner": "S2_2", "innerSteps": steps, "friction": friction}
    apart, device = difference(separated(system), x, scheme=scheme, **options)
    assert apart <= RATTLE
    length, slip = violations(system, *shown(device))
    assert length <= 5e-8 * 0.1
    assert slip <= 1e-8


@pytest.mark.parametrize("scheme", ["S2_2", "BAOA"])
def test_a_peptide_without_inner_steps_moves_as_on_the_host(scheme):
    _, system, x = peptide()
    apart, _ = difference(system, x, fast=None, scheme=scheme, stepSize=0.0005, friction=0.0)
    assert apart <= RATTLE


@pytest.mark.parametrize("scheme", ["S2_3", "W2_1"])
def test_flexible_molecules_and_water_move_as_on_the_host(scheme):
    """Without constraints but those of water, to roundoff."""
    _, system, x = in_water("None")
    apart, device = difference(separated(system), x, fast=(1,), scheme=scheme)
    assert apart <= 1e-13
    assert device.getIntegrator().timings.fast_evaluations > 0


def test_water_beside_a_peptide_stays_rigid():
    _, system, x = in_water()
    _, device = difference(separated(system), x, fast=(1,), scheme="S2_3", stepSize=0.004)
    x = shown(device)[0][22:].reshape(-1, 3, 3)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        distances = np.linalg.norm(x[:, i] - x[:, j], axis=1)
        assert np.ptp(distances) <= 1e-13
    assert np.linalg.norm(x[:, 0] - x[:, 1], axis=1) == pytest.approx(0.09572, abs=1e-13)


def test_bonded_forces_get_a_group_and_their_own_back():
    _, system, x = in_water()
    for force, group in zip(system.getForces(), (3, 4, 5, 0), strict=False):
        force.setForceGroup(group)
    context = moving(system, x, fast="bonded")
    live, integrator = context.getSystem(), context.getIntegrator()
    integrator.step(1)
    assert integrator.timings.fast_evaluations > 0
    groups = {type(force).__name__: force.getForceGroup() for force in live.getForces()}
    bonded = {groups[name] for name in ("HarmonicBondForce", "HarmonicAngleForce", "PeriodicTorsionForce")}
    assert len(bonded) == 1
    assert list(groups.values()).count(*bonded) == 3
    plain = moving(system, shown(context)[0], "host")
    energies = [c.getState(energy=True).getPotentialEnergy()._value for c in (context, plain)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-13)
    text = openmm.XmlSerializer.serialize
    assert text(rb.engines.custom_program.gather.without(live)) == text(system)


@pytest.mark.parametrize("own", [(0, 0, 0), (3, 3, 3), (3, 4, 5)])
def test_energies_by_group_are_those_of_the_users_groups(own):
    _, system, x = in_water()
    kinds = openmm.HarmonicBondForce, openmm.HarmonicAngleForce, openmm.PeriodicTorsionForce
    for force in system.getForces():
        force.setForceGroup(dict(zip(kinds, own, strict=True)).get(type(force), 0))
    context = moving(system, x, fast="bonded")
    context.getIntegrator().step(1)
    plain = moving(system, shown(context)[0], "host")
    for groups in ({*own}, {0, *own}, sum(1 << group for group in {0, *own}), {0} if 0 not in own else {7}):
        states = [c.getState(energy=True, groups=groups) for c in (context, plain)]
        states.append(context.getState(False, False, False, True, False, False, False, False, groups))
        device, host, by_place = (state.getPotentialEnergy()._value for state in states)
        assert device == by_place == pytest.approx(host, rel=1e-13)
    if len({*own}) > 1:
        with pytest.raises(ValueError, match="the fast forces of groups 3, 4, 5 share one group"):
            context.getState(energy=True, groups={3})


def plain(system, x):
    """Return a Context of a System itself, with an integrator of OpenMM."""
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    context.setPositions(x)
    return context


def itself(system, x, engine="device", **options):
    """Return a Context of a System itself, behind a step."""
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine=engine, **options)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(x)
    integrator.step(1)
    return context


def energies_by_group(context):
    return [context.getState(energy=True, groups=groups).getPotentialEnergy()._value for groups in ({0}, 1, {0, 5}, -1)]


@pytest.mark.parametrize("engine", ["host", "device"])
def test_contexts_of_one_system_have_the_users_groups(engine):
    """The first one has bonded forces in a group of their own, the second one in that of the user."""
    _, system, x = in_water()
    contexts = [itself(system, x, fast="bonded"), itself(system, x, engine, fast=None)]
    for context in contexts:
        expected = energies_by_group(plain(in_water()[1], shown(context)[0]))
        np.testing.assert_allclose(energies_by_group(context), expected, rtol=1e-13)


def test_forces_have_their_own_groups_when_the_context_is_gone():
    (_, system, x), (_, untouched, _) = in_water(), in_water()
    context = itself(system, x, fast="bonded")
    assert {force.getForceGroup() for force in system.getForces()} > {0, 31}
    del context
    theirs = {force.getName() for force in system.getForces() if force.getForceGroup() != 31}
    assert theirs == {force.getName() for force in untouched.getForces()}
    np.testing.assert_allclose(*(energies_by_group(plain(some, x)) for some in (system, untouched)), rtol=1e-13)


def test_a_step_size_with_other_inner_steps_has_another_program():
    _, system, x = peptide()
    both = [moving(separated(copy.deepcopy(system)), x, engine, fast=(1,)) for engine in ("host", "device")]
    for h in (0.001, 0.002, 0.0021, 0.0005):
        for context in both:
            context.getIntegrator().setStepSize(h)
        one, other = (stepped(context, 3) for context in both)
        np.testing.assert_allclose(other[0], one[0], rtol=0.0, atol=2e-6)
    counts = [context.getIntegrator().timings.evaluations for context in both]
    assert abs(counts[1] - counts[0]) <= 4


def test_what_is_set_between_calls_is_taken_up():
    _, system, x = in_water()
    options = {"fast": (1,), "scheme": "W2_3", "innerSteps": 6}
    both = [moving(separated(copy.deepcopy(system)), x, engine, **options) for engine in ("host", "device")]
    v = shown(both[0])[1]

    def steps():
        one, other = (stepped(context, 3) for context in both)
        np.testing.assert_allclose(other[0], one[0], rtol=0.0, atol=1e-5)

    steps()
    for change in (
        lambda context: (context.setPositions(x + 0.01), context.setVelocities(-v)),
        lambda context: context.setVelocities(v),
        lambda context: context.setVelocities(0.0 * v),
        lambda context: context.getIntegrator().setIntegrationForceGroups({0}),
        lambda context: context.getIntegrator().setIntegrationForceGroups({1}),
        lambda context: context.getIntegrator().setIntegrationForceGroups({0, 1}),
        lambda context: context.reinitialize(preserveState=True),
    ):
        for context in both:
            change(context)
        steps()


@pytest.mark.parametrize("own", [True, False])
def test_minimising_works(own):
    _, system, x = in_water()
    context = moving(separated(system), x, fast=(1,))
    integrator = context.getIntegrator()
    integrator.step(2)
    before = context.getState(energy=True).getPotentialEnergy()
    if own:
        integrator.minimizeEnergy(maxIterations=20)
    else:
        openmm.LocalEnergyMinimizer.minimize(context, 10.0, 20)
    assert context.getState(energy=True).getPotentialEnergy() < before
    integrator.step(2)
    length, _ = violations(system, *shown(context))
    assert length <= 5e-8 * 0.1


def test_the_minimiser_has_fast_forces_of_the_users_groups():
    _, system, x = in_water()
    minima = []
    for fast in ("bonded", None):
        context = moving(system, x, fast=fast, stepSize=0.0005)
        context.getIntegrator().setIntegrationForceGroups({0})
        context.getIntegrator().step(1)
        context.setPositions(x)
        openmm.LocalEnergyMinimizer.minimize(context, 10.0, 10)
        minima.append(context.getState(energy=True).getPotentialEnergy()._value)
    assert minima[0] == pytest.approx(minima[1], abs=1e-6)


@pytest.mark.parametrize(("scheme", "friction"), [("W2_1", None), ("S2_3", None), ("W2_3m", 5.0)])
def test_calls_and_checkpoints_change_no_bit(scheme, friction):
    _, system, x = in_water()
    options = {"fast": (1,), "scheme": scheme, "friction": friction}
    whole, parts = (moving(separated(copy.deepcopy(system)), x, **options) for _ in range(2))
    stepped(whole, 6)
    for n in (1, 2, 3):
        stepped(parts, n)
    np.testing.assert_allclose(shown(parts), shown(whole), rtol=0.0, atol=1e-12)
    checkpoint = parts.createCheckpoint()
    ends = [stepped(parts, 4)]
    parts.loadCheckpoint(checkpoint)
    ends.append(stepped(parts, 4))
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize(("scheme", "friction"), [("W2_1", None), ("W2_3m", 5.0)])
def test_a_new_simulation_continues_with_the_same_bits(scheme, friction):
    _, system, x = in_water()
    options = {"fast": "bonded", "scheme": scheme, "friction": friction}
    whole = moving(system, x, **options)
    stepped(whole, 3)
    checkpoint = whole.createCheckpoint()
    state = whole.getState(positions=True, velocities=True, parameters=True, integratorParameters=True)
    end = stepped(whole, 3)
    for load, saved in (("loadCheckpoint", checkpoint), ("setState", state)):
        fresh = moving(system, x, **options)
        fresh.getIntegrator().step(0)
        getattr(fresh, load)(saved)
        np.testing.assert_array_equal(stepped(fresh, 3), end)


def test_energy_and_temperature_are_those_of_the_host():
    _, system, x = in_water()
    contexts = [moving(separated(copy.deepcopy(system)), x, engine, fast=(1,)) for engine in ("host", "device")]
    integrators = [context.getIntegrator() for context in contexts]
    for integrator in integrators:
        integrator.step(2)
    one, other = (integrator.totalEnergy()._value for integrator in integrators)
    assert other == pytest.approx(one, abs=1e-3)
    state = contexts[1].getState(energy=True)
    assert state.getKineticEnergy()._value + state.getPotentialEnergy()._value == pytest.approx(other, abs=1e-6)
    assert sum(integrators[0].degreesOfFreedom()) == sum(integrators[1].degreesOfFreedom())


@pytest.mark.parametrize(("scheme", "rate"), [("S2_2", 500.0), pytest.param("W2_1", 250.0, marks=pytest.mark.validate)])
def test_the_energy_error_over_half_a_picosecond_is_that_of_the_host(scheme, rate):
    _, system, x = in_water()
    h = rb.SCHEMES[scheme].forces / rate
    spread = []
    for engine in ("host", "device"):
        context = moving(separated(copy.deepcopy(system)), x, engine, fast=(1,), scheme=scheme, stepSize=h)
        energies = []
        for _ in range(round(0.5 / h) // 3):
            context.getIntegrator().step(3)
            energies.append(context.getIntegrator().totalEnergy()._value)
        spread.append(np.std(energies))
    assert spread[1] <= 1.25 * spread[0], spread


def test_the_remover_of_the_motion_of_the_centre_of_mass():
    _, system, x = in_water()
    system.addForce(openmm.CMMotionRemover())
    context = moving(separated(system), x, fast=(1,), v=velocities(system, x) + np.array([1.0, 2.0, 3.0]))
    masses = np.array([system.getParticleMass(i)._value for i in range(len(x))])
    _, v = stepped(context, 3)
    assert np.abs(masses @ v).max() <= 1e-8 * masses.sum()
    length, slip = violations(system, *shown(context))
    assert length <= 5e-8 * 0.1
    assert slip <= 1e-8


def test_velocities_behind_a_thermostat_of_the_system_are_constrained():
    _, system, x = in_water()
    system.addForce(seeded(openmm.AndersenThermostat(300.0, 1000.0)))
    context = moving(system, x, fast="bonded")
    for _ in range(3):
        length, slip = violations(system, *stepped(context, 1))
        assert length <= 5e-8 * 0.1
        assert slip <= 1e-8


def test_a_barostat_acts_within_the_program():
    _, system, x = in_water(waters=30)
    (nonbonded,) = [force for force in system.getForces() if isinstance(force, openmm.NonbondedForce)]
    nonbonded.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
    nonbonded.setCutoffDistance(0.7)
    system.setDefaultPeriodicBoxVectors(*(1.6 * np.eye(3)))
    system.addForce(seeded(openmm.MonteCarloBarostat(5000.0, 300.0, 2)))
    context = moving(separated(system), x, fast=(1,), scheme="S2_2")
    edges = set()
    for _ in range(10):
        stepped(context, 2)
        edges.add(context.getState().getPeriodicBoxVectors()[0][0]._value)
    assert len(edges) > 2
    length, _ = violations(system, *shown(context))
    assert length <= 5e-8 * 0.1


@pytest.mark.parametrize("scheme", [*WITH_THERMOSTAT, "S2_2"])
def test_noise_depends_on_seed_and_step_alone(scheme):
    _, system, x = in_water()
    contexts = [moving(separated(copy.deepcopy(system)), x, fast=(1,), friction=1e3, scheme=scheme) for _ in range(3)]
    contexts[2].getIntegrator().setRandomNumberSeed(8)
    whole = stepped(contexts[0], 4)
    stepped(contexts[1], 3)
    np.testing.assert_allclose(stepped(contexts[1], 1), whole, rtol=0.0, atol=1e-10)
    assert np.abs(stepped(contexts[2], 4) - whole).max() > 1e-4


def test_strong_friction_gives_stars_and_water_the_energies_of_the_temperature():
    """Momenta that each step draws: chi-squared with the degrees of freedom of 30 steps."""
    _, system, x = in_water()
    context = moving(separated(system), x, fast=(1,), friction=1e7, stepSize=0.001)
    integrator = context.getIntegrator()
    masses = np.array([system.getParticleMass(i)._value for i in range(len(x))])
    kinetic = []
    for _ in range(30):
        _, v = stepped(context, 1)
        kinetic.append(0.5 * masses[:, None] * v**2)
    kT = 0.00831446261815324 * 300.0
    for particles, freedom in ((slice(0, 22), 66 - 12), (slice(22, None), 6 * 6)):
        mean = np.array(kinetic)[:, particles].sum(axis=(1, 2)).mean() / (0.5 * kT * freedom)
        assert mean == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (freedom * 30)))
    assert integrator.getEngine() == "device"


@pytest.mark.parametrize(
    ("constraints", "options", "sentence"),
    [
        ("AllBonds", {}, "the cluster of particles .* has constraints that OpenMM's SHAKE does not support"),
        ("HAngles", {}, "has constraints that OpenMM's SHAKE does not support"),
        ("HBonds", {"scheme": "SRKN4_6b", "fast": None}, "SRKN4_6b would be of order 2"),
        ("HBonds", {"scheme": "Chin4A"}, "together with inner steps or flexible molecules with constraints"),
    ],
)
def test_what_is_not_supported_is_refused(constraints, options, sentence):
    _, system, x = peptide(constraints)
    context = moving(system, x, v=0.0 * x, **{"stepSize": 0.004} | options)
    with pytest.raises(ValueError, match=f"{sentence}.*; use engine='host'"):
        context.getIntegrator().step(1)


def test_fast_forces_on_rigid_bodies_are_refused_by_name():
    _, system, x = in_water()
    bond = openmm.HarmonicBondForce()
    bond.addBond(0, 25, 0.3, 1000.0)
    system.addForce(bond)
    with pytest.raises(ValueError, match=r"fast forces act on body \d+ \(particles 25, 26, 27\)"):
        stepped(moving(system, x, fast="bonded"), 1)
    external = openmm.CustomExternalForce("x^2")
    external.addParticle(0)
    external.setForceGroup(7)
    system.addForce(external)
    with pytest.raises(ValueError, match="include a CustomExternalForce, which may act on rigid bodies"):
        stepped(moving(system, x, fast=(7,), innerSteps=4), 1)


def test_unequal_hydrogens_are_refused():
    _, system, x = peptide()
    system.setParticleMass(1, 3.0)
    with pytest.raises(ValueError, match="SHAKE does not support"):
        stepped(moving(system, x, v=0.0 * x), 1)


def test_a_run_that_had_steps_before_continues_with_its_bits(tmp_path):
    topology, system, x = in_water()

    def simulation():
        integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", engine="device", fast="bonded")
        begun = app.Simulation(topology, copy.deepcopy(system), integrator, REFERENCE)
        begun.context.setPositions(x)
        begun.context.setVelocities(velocities(system, x))
        return begun

    whole, part, resumed = (simulation() for _ in range(3))
    for begun in (whole, part):
        begun.step(1)
    rb.Run(tmp_path / "whole").advance(whole, 6)
    rb.Run(tmp_path / "part").advance(part, 3)
    rb.Run(tmp_path / "part", resume=True).advance(resumed, 6)
    np.testing.assert_array_equal(shown(resumed.context), shown(whole.context))
