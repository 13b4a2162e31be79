"""Barostats and thermostats of a System that never act are no obstacle, and are noticed once they act."""

import copy

import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
from four_barostats import barostats
from openmm_exactrb.context.updates import acting_updates, names_of_updates
from openmm_exactrb.thermostats import HybridMonteCarlo, Langevin
from places import HOST_AND_NATIVE, platform_for
from products import spread_over

BAR, KELVIN = unit.bar, unit.kelvin
#: At 280 K, where the integrators have 300 K.
BAROSTATS = barostats(280, axes=(True, False, True))
#: A barostat that scales no axis, whatever its frequency.
WITHOUT_AXES = {
    "without axes": lambda n: openmm.MonteCarloAnisotropicBarostat(
        openmm.Vec3(1, 1, 1) * BAR, 280 * KELVIN, False, False, False, n or 2
    )
}
BOTH = pytest.mark.parametrize("engine", HOST_AND_NATIVE)
COLLISIONS = openmm.AndersenThermostat.CollisionFrequency()


def lattice(n=3, bonded=True):
    """Return a System of n³ rigid water molecules in a wide periodic box, and positions; molecules need constraints."""
    _, system, positions = rb.rigid_water(n**3)
    (force,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    force.setNonbondedMethod(force.CutoffPeriodic)
    force.setCutoffDistance(0.5)
    system.setDefaultPeriodicBoxVectors(*(0.5 * n * np.eye(3)))
    while not bonded and system.getNumConstraints():
        system.removeConstraint(0)
    return system, np.asarray(positions._value if unit.is_quantity(positions) else positions)


def water_with(integrator, force=None, engine="host", bonded=True, removes=False, changed=lambda force: None):
    """Return a Context of water with a force, which is changed after the Context is created."""
    system, positions = lattice(bonded=bonded)
    if removes:
        system.addForce(openmm.CMMotionRemover(1))
    if force is not None:
        system.addForce(copy.deepcopy(force))
    context = openmm.Context(system, integrator, *platform_for(engine))
    context.setPositions(positions)
    context.setVelocitiesToTemperature(300.0, 1)
    changed(context)
    return context


def coupling(context):
    """Return the force that couples a Context, as an object of its System."""
    return context.getSystem().getForces()[-1]


def edges(context):
    return np.array(context.getState().getPeriodicBoxVectors(asNumpy=True)._value)


def places(context):
    return context.getState(positions=True).getPositions(asNumpy=True)._value.copy()


# -- off: whatever else is said of them -------------------------------------------------------------------------------


def switched_off_by(way):
    """Return a function that makes the force of an active or inactive coupling, and one that switches it off later."""

    def made(make):
        force = make(0 if way == "constructor" else 2)
        if way == "setter before":
            force.setFrequency(0)
        return force

    def later(context):
        if way == "setter in the System":
            coupling(context).setFrequency(0)
        elif way == "reinitialize":
            coupling(context).setFrequency(0)
            context.reinitialize(preserveState=True)

    return made, later


WAYS = "constructor", "setter before", "setter in the System", "reinitialize"


@spread_over({"name": BAROSTATS | WITHOUT_AXES, "way": WAYS, "engine": HOST_AND_NATIVE})
def test_a_barostat_that_never_acts_may_have_any_temperature(name, way, engine):
    made, later = switched_off_by(way)
    found = []
    for force in (made((BAROSTATS | WITHOUT_AXES)[name]), None):
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.002, engine=engine)
        integrator.setRandomNumberSeed(1)
        context = water_with(integrator, force, engine, changed=later if force else lambda context: None)
        box = edges(context)
        integrator.step(4)
        np.testing.assert_array_equal(edges(context), box)
        assert acting_updates(context) == []
        found.append(places(context))
    np.testing.assert_allclose(found[0], found[1], rtol=0.0, atol=0.0 if engine == "host" else 1e-12)


@spread_over(
    {
        "make": ["Langevin", "rescaling", "chain", "argument"],
        "way": ["constructor", "default", "parameter"],
        "engine": HOST_AND_NATIVE,
    },
)
def test_a_thermostat_without_collisions_is_no_second_thermostat(make, way, engine):
    force = openmm.AndersenThermostat(280.0, 0.0 if way == "constructor" else 5.0)
    force.setRandomNumberSeed(1)  # on OpenCL, the same as that of the integrator
    if way == "default":
        force.setDefaultCollisionFrequency(0.0)
    makers = {
        "Langevin": lambda: rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.002, engine=engine),
        "rescaling": lambda: rb.ExactRigidBodyRescalingIntegrator(300.0, 0.1, 0.002, engine=engine),
        "chain": lambda: rb.ExactRigidBodyNoseHooverIntegrator(300.0, 5.0, 0.002, engine=engine),
        "argument": lambda: rb.ExactRigidBodyIntegrator(0.002, engine=engine, thermostat=Langevin(300.0, 5.0)),
    }
    found = []
    for coupled in (True, False):
        integrator = makers[make]()
        integrator.setRandomNumberSeed(1)
        context = water_with(integrator, force if coupled else None, engine)
        if coupled and way == "parameter":
            context.setParameter(COLLISIONS, 0.0)
        integrator.step(4)
        found.append(places(context))
    np.testing.assert_allclose(found[0], found[1], rtol=0.0, atol=0.0 if engine == "host" else 1e-12)


@spread_over({"name": BAROSTATS, "engine": HOST_AND_NATIVE})
def test_a_barostat_that_never_acts_tears_no_body(name, engine):
    """Bodies that OpenMM does not take for molecules."""
    named = [[3 * k, 3 * k + 1, 3 * k + 2] for k in range(27)]
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=named, engine=engine)
    context = water_with(integrator, BAROSTATS[name](0), engine, bonded=False)
    integrator.step(2)
    coupling(context).setFrequency(1)
    before = places(context), edges(context)
    with pytest.raises(ValueError, match="a barostat would tear apart body 0"):
        integrator.step(1)
    np.testing.assert_array_equal(places(context), before[0])
    np.testing.assert_array_equal(edges(context), before[1])
    coupling(context).setFrequency(0)
    integrator.step(2)


@BOTH
@pytest.mark.parametrize("name", ["isotropic", "flexible"])
def test_a_barostat_that_never_acts_may_scale_particles(name, engine):
    force = BAROSTATS[name](0)
    force.setScaleMoleculesAsRigid(False)
    integrator = rb.ExactRigidBodyIntegrator(0.001, engine=engine)
    context = water_with(integrator, force, engine)
    integrator.step(2)
    coupling(context).setFrequency(3)
    with pytest.raises(
        ValueError, match=r"would change distances within bodies: call setScaleMoleculesAsRigid\(True\)"
    ):
        integrator.step(1)


def test_dipoles_of_one_box_bear_a_barostat_that_never_acts():
    boundary = rb.ReactionField(cutoff=1.2)
    _, system, positions = rb.dipole_fluid(16, density=0.4, boundary=boundary, kernel="bonds")
    system.addForce(openmm.MonteCarloBarostat(1 * BAR, 100 * KELVIN, 0))
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    integrator.step(1)


@pytest.mark.parametrize(
    ("thermostat", "acts"),
    [
        (Langevin(300.0, 0.0), False),
        (Langevin(300.0, 0.0, 0.0, flexibleFriction=0.0), False),
        (Langevin(300.0, 1.0), True),
        (Langevin(300.0, 0.0, 1.0), True),
        (Langevin(300.0, 0.0, flexibleFriction=1.0), True),
        (HybridMonteCarlo(300.0, 0.0), True),
        (type("Own", (Langevin,), {"bind": Langevin.bind})(300.0, 0.0), True),
    ],
    ids=repr,
)
def test_friction_of_zero_is_no_coupling_either(thermostat, acts):
    assert thermostat.acts == acts
    force = BAROSTATS["isotropic"](1)
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", thermostat=thermostat)
    water_with(integrator, force) if acts else None
    context = water_with(rb.ExactRigidBodyIntegrator(0.001, "S2_2", thermostat=thermostat), force)
    integrator = context.getIntegrator()
    if not acts:
        integrator.step(2)
        return
    with pytest.raises(ValueError, match="the temperature of the MonteCarloBarostat is 280 K"):
        integrator.step(2)


# -- on: from the next call of step -----------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize("name", BAROSTATS)
def test_a_barostat_is_noticed_when_it_is_switched_on_and_off(name, engine):
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.001, engine=engine)
    context = water_with(integrator, BAROSTATS[name](0), engine)
    integrator.step(7)
    box, force = edges(context), coupling(context)
    force.setFrequency(2)
    before = places(context)
    with pytest.raises(ValueError, match=r"Barostat is 280 K, but that of the integrator is 300 K: .*setParameter"):
        integrator.step(1)
    np.testing.assert_array_equal(places(context), before)
    context.setParameter(force.Temperature(), 300.0)
    seen = []
    for _ in range(10):
        integrator.step(4)
        seen.append(edges(context))
    assert max(np.abs(one - box).max() for one in seen) > 1e-4
    force.setFrequency(0)
    context.setParameter(force.Temperature(), 280.0)
    integrator.step(10)
    np.testing.assert_array_equal(edges(context), seen[-1])


@BOTH
@pytest.mark.parametrize("switch", ["parameter", "reinitialize"])
def test_a_thermostat_is_noticed_when_collisions_begin(switch, engine):
    def on(context, frequency):
        if switch == "parameter":
            context.setParameter(COLLISIONS, frequency)
        else:
            coupling(context).setDefaultCollisionFrequency(frequency)
            context.reinitialize(preserveState=False)
            context.setPositions(start)
            context.setVelocitiesToTemperature(300.0, 1)

    start = lattice()[1]
    heated = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.001, engine=engine)
    context = water_with(heated, openmm.AndersenThermostat(300.0, 0.0), engine)
    heated.step(3)
    on(context, 10.0)
    with pytest.raises(ValueError, match="AndersenThermostat, but this integrator also has a thermostat"):
        heated.step(1)
    on(context, 0.0)
    heated.step(1)
    plain = rb.ExactRigidBodyIntegrator(0.001, engine=engine)
    context = water_with(plain, openmm.AndersenThermostat(300.0, 0.0), engine)
    plain.step(3)
    begin = plain.totalEnergy()._value
    plain.step(3)
    assert abs(plain.totalEnergy()._value - begin) < 1.0
    on(context, 1e6)
    plain.step(2)
    seen = []
    for _ in range(6):  # of which any two may be close by chance, because all velocities are drawn again in each step
        seen.append(plain.kineticEnergies()[0]._value)
        plain.step(1)
    assert np.ptp(seen) > 5.0
    on(context, 0.0)
    plain.step(1)
    begin = plain.totalEnergy()._value
    plain.step(3)
    assert abs(plain.totalEnergy()._value - begin) < 1.0


def fractions(context):
    """Return the mean positions of molecules, which a barostat scales, in units of the edges of the box."""
    return places(context).reshape(-1, 3, 3).mean(axis=1) / np.diag(edges(context))


# Frequencies of a barostat, each with the number of steps until the next one: on and off, more and less often.
SEQUENCE = (0, 7), (5, 23), (2, 7), (9, 40), (0, 3), (40, 33), (3, 20), (0, 11), (4, 6), (0, 1), (2, 5)


@spread_over(
    {
        "scheme, others": [("S2_2", "thermostat"), ("W2_1", "remover"), ("BAOA", "nothing"), ("W2_3m", "remover")],
        "engine": HOST_AND_NATIVE,
    }
)
def test_molecules_follow_the_box_whenever_the_frequency_changes(others, scheme, engine):
    """In so short steps that only the barostat moves molecules, by the edges of the box."""
    options = {"engine": engine} | ({"thermostat": Langevin(280.0, 1.0)} if scheme in ("BAOA", "W2_3m") else {})
    integrator = rb.ExactRigidBodyIntegrator(1e-9, scheme, **options)
    system, positions = lattice()
    if others == "remover":
        system.addForce(openmm.CMMotionRemover(1))
    elif others == "thermostat":
        system.addForce(openmm.AndersenThermostat(280.0, 0.0))
    barostat = BAROSTATS["isotropic"](0)
    barostat.setDefaultPressure(300 * BAR)  # near that of the molecules, so that most trials are accepted
    system.addForce(barostat)
    context = openmm.Context(system, integrator, *platform_for(engine))
    context.setPositions(positions)
    context.setVelocitiesToTemperature(280.0, 1)
    integrator.step(1)
    begin, force, boxes = fractions(context), coupling(context), 0
    for frequency, steps in SEQUENCE:
        force.setFrequency(frequency)
        for chunk in (1, 2, steps - 3) if steps > 3 else (steps,):
            before = edges(context)
            integrator.step(chunk)
            boxes += not np.array_equal(edges(context), before)
            assert frequency or np.array_equal(edges(context), before)
            np.testing.assert_allclose(fractions(context), begin, rtol=0.0, atol=1e-6)
        if others == "thermostat" and "thermostat" not in options:  # the next change meets another count of steps
            context.setParameter(COLLISIONS, 0.0 if context.getParameter(COLLISIONS) else 1e-3)
    assert boxes > 0
    fresh = openmm.Context(copy.deepcopy(system), openmm.VerletIntegrator(1e-8), *platform_for(engine))
    fresh.setPeriodicBoxVectors(*edges(context))
    fresh.setPositions(places(context))
    energies = [one.getState(energy=True).getPotentialEnergy()._value for one in (context, fresh)]
    assert energies[0] == pytest.approx(energies[1], abs=1e-6)


@BOTH
def test_a_barostat_acts_as_often_as_its_frequency_says(engine):
    """Counted by the changes of the box of an ideal gas at its pressure, of which most are accepted."""
    system, positions = lattice()
    (force,) = (force for force in system.getForces() if isinstance(force, openmm.NonbondedForce))
    for i in range(force.getNumParticles()):
        force.setParticleParameters(i, 0.0, 1.0, 0.0)
    barostat = BAROSTATS["isotropic"](0)
    barostat.setDefaultPressure(unit.BOLTZMANN_CONSTANT_kB * 280 * KELVIN / (0.5 * unit.nanometer) ** 3)
    for one in (openmm.CMMotionRemover(1), barostat):
        system.addForce(one)
    integrator = rb.ExactRigidBodyIntegrator(1e-8, "S2_2", engine=engine)
    context = openmm.Context(system, integrator, *platform_for(engine))
    context.setPositions(positions)
    for frequency in (0, 4, 10, 0, 5):
        coupling(context).setFrequency(frequency)
        number, before = 0, edges(context)
        for _ in range(60):
            integrator.step(1)
            number += not np.array_equal(edges(context), before)
            before = edges(context)
        trials = 60 // frequency if frequency else 0
        assert 0.3 * trials <= number <= trials + bool(trials)  # the first trial may be due at once


def averaged(integrator, *forces):
    """Return a Simulation of water with these forces."""
    system, positions = lattice()
    for force in forces:
        system.addForce(force)
    simulation = openmm.app.Simulation(rb.rigid_water(27)[0], system, integrator, *platform_for("host")[:1])
    simulation.context.setPositions(positions)
    simulation.context.setVelocitiesToTemperature(280.0, 1)
    return simulation


def test_averages_notice_a_barostat_that_is_switched_on(tmp_path):
    integrator = rb.ExactRigidBodyLangevinIntegrator(280.0, 1.0, 0.002)
    simulation = averaged(integrator, BAROSTATS["isotropic"](0))
    reporter = rb.AverageReporter(tmp_path / "averages.csv", 2)
    simulation.reporters.append(reporter)
    simulation.step(4)
    coupling(simulation.context).setFrequency(1)
    with pytest.raises(ValueError, match="the thermostat, the barostat, the force groups"):
        simulation.step(2)
    reporter.close()


@pytest.mark.parametrize("temperature", [280.0, 300.0])
def test_averages_of_openmm_s_integrator_bear_couplings_that_never_act(tmp_path, temperature):
    integrator = openmm.LangevinMiddleIntegrator(temperature, 1.0, 0.002)
    simulation = averaged(integrator, BAROSTATS["membrane"](0), openmm.AndersenThermostat(310.0, 0.0))
    reporter = rb.AverageReporter(tmp_path / "averages.csv", 2)
    simulation.reporters.append(reporter)
    simulation.step(4)
    reporter.close()
    assert len((tmp_path / "averages.csv").read_text(encoding="utf-8").splitlines()) > 2


def test_names_are_of_what_acts():
    system = openmm.System()
    for make in BAROSTATS.values():
        system.addForce(make(0))
    system.addForce(openmm.AndersenThermostat(300.0, 0.0))
    assert names_of_updates(system) == []
    system.addForce(openmm.CMMotionRemover(10))
    system.getForce(1).setFrequency(3)
    system.getForce(4).setDefaultCollisionFrequency(1.0)
    assert names_of_updates(system) == ["MonteCarloAnisotropicBarostat", "AndersenThermostat", "CMMotionRemover"]
