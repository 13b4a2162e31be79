"""The heat of a thermostat, the balance of energy and the kinetic energies around heat exchanges, on every platform."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from both_engines import begun, pair
from graphs import GRAPHS, system_of
from openmm_exactrb.openmm_access.platforms import DEVICES
from peptides import in_water
from places import PLATFORMS, REFERENCE, device_platform
from products import in_pairs, spread_over
from thermostatted import load, molecules, saved
from zoo import every_kind, water

pytestmark = pytest.mark.library


def peptide(constraints):
    _, system, x = in_water(constraints, 6)
    return system, x


def clusters():
    system, x = system_of([GRAPHS[name] for name in ("chain of 4", "ring of 5", "star of 6", "star from the end")])
    for mass in (3.0, 20.0):
        system.addParticle(mass)
        x = np.append(x, [[0.3 * mass, 2.0, 0.0]], axis=0)
        system.getForce(0).addParticle(system.getNumParticles() - 1, [50.0])
    return system, x


def droplet():
    return water(8, method=openmm.app.NoCutoff)


def langevin(engine, scheme="BAOA", h=0.002, friction=5.0, **options):
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, friction, h, scheme, engine=engine, **options)
    integrator.setRandomNumberSeed(11)
    return integrator


def rescaling(engine, scheme="BAOA", **options):
    integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.1, 0.002, scheme, engine=engine, **options)
    integrator.setRandomNumberSeed(11)
    return integrator


def chains(engine, scheme="BAOAB", **options):
    return rb.ExactRigidBodyNoseHooverIntegrator(300.0, 20.0, 0.002, scheme, engine=engine, **options)


@dataclass
class Case:
    """A start, and an integrator with its options."""

    start: Callable[[], tuple]
    make: Callable = langevin
    options: dict = field(default_factory=dict)

    def started(self, removes, platform):
        """Return Contexts of host and kernels."""
        system, positions, *bodies = self.start()
        named = {"bodies": bodies[0]} if bodies else {}
        if removes:
            system.addForce(openmm.CMMotionRemover(removes))
        made = [self.make(engine, **named, **self.options) for engine in ("host", "native")]
        return [begun(system, positions, integrator, platform=platform) for integrator in made]


CASES = {
    "water": Case(droplet),
    "three kicks": Case(droplet, options={"scheme": "W2_3m"}),
    "exchange in the middle": Case(water, options={"scheme": "BAOAB"}),
    "two exchanges": Case(water, options={"scheme": "S2_2"}),
    "every kind": Case(every_kind, options={"rotationalFriction": 20.0}),
    "every kind without friction of rotation": Case(every_kind, options={"rotationalFriction": 0.0}),
    "clusters": Case(clusters),
    "clusters of two exchanges": Case(clusters, options={"scheme": "S2_2", "h": 0.001}),
    "clusters without friction": Case(clusters, options={"scheme": "S2_2", "friction": 0.0}),
    "inner steps": Case(lambda: peptide("HBonds"), options={"fast": "bonded"}),
    "inner steps of three kicks": Case(lambda: peptide("HAngles"), options={"scheme": "W2_3m", "fast": "bonded"}),
    "inner steps of two exchanges": Case(lambda: peptide("AllBonds"), options={"scheme": "S2_2", "fast": "bonded"}),
    "friction of molecules": Case(lambda: peptide("None"), options={"fast": "bonded", "flexibleFriction": 50.0}),
    "friction of molecules alone": Case(
        lambda: peptide("HBonds"),
        options={"scheme": "BAOAB", "fast": "bonded", "friction": 0.0, "flexibleFriction": 9.0},
    ),
    "rescaling": Case(water, rescaling),
    "rescaling of clusters": Case(clusters, rescaling, {"scheme": "S2_2"}),
    "rescaling of parts": Case(lambda: peptide("HBonds"), rescaling, {"fast": "bonded", "together": False}),
    "rescaling of three kicks": Case(lambda: peptide("HBonds"), rescaling, {"scheme": "W2_3m", "fast": "bonded"}),
    "rescaling and inner steps": Case(lambda: peptide("HBonds"), rescaling, {"scheme": "BAOAB", "fast": "bonded"}),
    "chains": Case(every_kind, chains),
    "chains and inner steps": Case(lambda: peptide("AllBonds"), chains, {"fast": "bonded"}),
}


def told(integrator):
    """Return what an integrator tells of its heat exchanges, in kJ/mol and K."""
    values = [T._value for T in integrator.temperaturesAroundThermostat()]
    if not hasattr(integrator, "heat"):
        return np.array([integrator.effectiveEnergy()._value, *values])
    return np.array([integrator.heat()._value, integrator.effectiveEnergy()._value, *values])


@pytest.mark.filterwarnings("ignore:the CMMotionRemover removes the momentum that frozen particles")
@spread_over({"case": CASES, "platform": PLATFORMS, "removes": [0, 2]}, indirect=["platform"])
def test_kernels_tell_what_the_host_tells(case, removes, platform):
    contexts = CASES[case].started(removes, platform)
    host, kernels = (context.getIntegrator() for context in contexts)
    for steps in (1, 2, 8):
        for integrator in (host, kernels):
            integrator.step(steps)
        # OpenMM's CMMotionRemover computes in single precision on a device: it leaves 1e-7 of the motion.
        close = 1e-6 if removes and platform.getName() in DEVICES else 1e-8
        np.testing.assert_allclose(told(kernels), told(host), rtol=close, atol=close)
    assert kernels.getEngine() == "native"


@pytest.mark.parametrize("make", [langevin, rescaling])
def test_heat_may_be_asked_for_at_any_time(make, platform):
    context = begun(*droplet(), make("native"), platform=platform)
    integrator = context.getIntegrator()
    before = integrator.effectiveEnergy()._value
    assert integrator.heat()._value == 0.0
    with pytest.raises(ValueError, match=r"no heat exchange has taken place .*: call step\(\) first"):
        integrator.temperaturesAroundThermostat()
    integrator.step(20)
    assert abs(integrator.heat()._value) > 1.0
    assert integrator.effectiveEnergy()._value == pytest.approx(before, abs=0.5)
    told(integrator)
    context.setVelocities(context.getState(velocities=True).getVelocities() * 1.1)
    with pytest.raises(ValueError, match=r"no heat exchange has taken place .*: call step\(\) first"):
        integrator.temperaturesAroundThermostat()


@in_pairs({"platform": PLATFORMS, "friction": [2.0, 200.0], "removes": [0, 1]}, indirect=["platform"])
def test_without_forces_the_heat_is_what_openmm_finds_in_the_velocities(removes, friction, platform):
    """Drifts conserve kinetic energies, those of clusters along their constraints too."""
    system, x = clusters()
    system.removeForce(0)
    rigid, places = molecules(waters=2, rods=2)
    first = system.getNumParticles()
    for k in range(rigid.getNumParticles()):
        system.addParticle(rigid.getParticleMass(k))
    for k in range(rigid.getNumConstraints()):
        i, j, d = rigid.getConstraintParameters(k)
        system.addConstraint(first + i, first + j, d)
    if removes:
        system.addForce(openmm.CMMotionRemover())
    context = begun(system, np.append(x, places, axis=0), langevin("native", friction=friction), platform=platform)
    integrator, kinetic = context.getIntegrator(), []
    start = context.getState(energy=True).getKineticEnergy()._value
    for n in (1, 1, 30):
        integrator.step(n)
        kinetic.append(context.getState(energy=True).getKineticEnergy()._value)
        assert integrator.heat()._value == pytest.approx(kinetic[-1] - start, rel=1e-11, abs=1e-11)
        assert integrator.effectiveEnergy()._value == pytest.approx(start, rel=1e-11)
        if n == 1 and len(kinetic) > 1 and not removes:
            temperatures, freedom = integrator.temperaturesAroundThermostat(), integrator.degreesOfFreedom()
            mean = 0.5 * sum(f * T._value for f, T in zip(freedom, temperatures, strict=True)) * 8.31446261815324e-3
            assert mean == pytest.approx(0.5 * sum(kinetic[-2:]), rel=1e-11)


@spread_over(
    {
        "case": ["water", "clusters of two exchanges", "inner steps"],
        "kind": ["checkpoint", "State"],
        "platform": PLATFORMS,
    },
    times=2,
    indirect=["platform"],
)
def test_saved_runs_go_on_with_their_heat(case, kind, platform):
    _, context = CASES[case].started(2, platform)
    integrator = context.getIntegrator()
    integrator.step(7)
    content, found = saved(context, kind), integrator.heat()
    positions = context.getState(positions=True).getPositions()
    integrator.step(5)
    later = told(integrator)

    make, options = CASES[case].make, CASES[case].options
    other = begun(context.getSystem(), positions, make("native", **options), kelvin=None, platform=platform)
    for again in (other, context):
        load(again, kind, content)
        assert again.getIntegrator().heat() == found
        if again is other or kind == "checkpoint":  # a run that branches off at a State has other noise
            again.getIntegrator().step(5)
            np.testing.assert_allclose(told(again.getIntegrator()), later, rtol=1e-11)


def test_the_host_goes_on_with_the_heat_of_the_kernels():
    """Their checkpoints have the heat in the same variable."""
    contexts = CASES["every kind"].started(0, REFERENCE)
    heats = []
    for context in contexts:
        integrator = context.getIntegrator()
        integrator.step(4)
        context.createCheckpoint()
        heats.append(integrator.getGlobalVariableByName("exactrb_heat_of_friction"))
        assert heats[-1] == integrator.heat()._value
    assert heats[1] == pytest.approx(heats[0], rel=1e-9)


@spread_over({"case": ["water", "inner steps", "clusters"], "platform": PLATFORMS}, indirect=["platform"])
def test_settings_may_change_within_a_run(case, platform):
    contexts = CASES[case].started(1, platform)
    found = []
    for context in contexts:
        integrator, values = context.getIntegrator(), []
        integrator.step(3)
        integrator.setTemperature(450.0)
        values.append(integrator.heat()._value)
        integrator.step(3)
        integrator.setFriction(40.0)
        integrator.step(2)
        integrator.setStepSize(0.001)
        integrator.step(2)
        found.append(np.array([*values, *told(integrator)]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-8, atol=1e-8)


def test_heat_of_steps_that_diverge_is_not_counted(platform):
    """An error leaves the state and the heat before the step, wherever it is among those of a call."""
    system, positions = molecules(waters=3, rods=2)
    wall = openmm.CustomExternalForce("step(x-3)*1e9*(x-3)^2")
    for k in range(system.getNumParticles()):
        wall.addParticle(k)
    system.addForce(wall)
    found = []
    for diverges in (True, False):
        context = begun(system, positions, langevin("native"), platform=platform)
        integrator = context.getIntegrator()
        context.setVelocities(np.where(np.arange(len(positions))[:, None] < 3, [40.0, 0.0, 0.0], 0.0))
        if diverges:
            with pytest.raises(rb.IntegrationError):
                integrator.step(200)
            done = context.getStepCount()
            assert 20 < done < 200
        else:
            integrator.step(done)
        found.append((integrator.heat()._value, integrator.totalEnergy()._value))
    assert found[0] == pytest.approx(found[1], rel=1e-12)
    assert found[0][0] != 0.0


@spread_over({"platform": PLATFORMS, "case": ["water", "inner steps"]}, indirect=["platform"])
def test_the_balance_is_conserved_over_a_run(case, platform):
    """It fluctuates by a fraction of what the thermostat exchanges."""
    _, context = CASES[case].started(1, platform)
    integrator = context.getIntegrator()
    integrator.setStepSize(0.0005)
    balances, heats = [], []
    for _ in range(40):
        integrator.step(25)
        balances.append(integrator.effectiveEnergy()._value)
        heats.append(integrator.heat()._value)
    assert np.ptp(balances) < 0.02 * np.ptp(heats)


def test_motion_that_a_thermostat_of_the_system_changes_is_no_heat(platform):
    """Without friction, the System may have one: energies are then not balanced, on any engine."""
    system, positions = droplet()
    thermostat = openmm.AndersenThermostat(300.0, 100.0)
    thermostat.setRandomNumberSeed(11)
    for force in (thermostat, openmm.CMMotionRemover()):
        system.addForce(force)
    for context in pair(system, positions, lambda engine: langevin(engine, friction=0.0), platform=platform):
        context.getIntegrator().step(5)
        assert context.getIntegrator().heat()._value == 0.0


@pytest.mark.opencl
def test_the_temperature_of_the_system_and_its_energy_are_those_of_the_host():
    """Which OpenMM's reporters ask for."""
    found = []
    for context in CASES["every kind"].started(0, device_platform()):
        integrator = context.getIntegrator()
        integrator.step(5)
        found.append((integrator.computeSystemTemperature()._value, integrator.totalEnergy()._value))
    assert found[1] == pytest.approx(found[0], rel=1e-8)
