"""The temperatures that OpenMM's own reporters print, and the velocities that its Context draws, for any molecules."""

import io
import itertools

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from thermostatted import simulation_of

KB = 0.00831446261815324
BATH = 260.0
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5
STRAIGHT = np.outer([-1.0, 0.0, 2.0], [0.0, 0.06, 0.08])
FLAT = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.1, 0.0]])
HEXAGON = np.array([[np.cos(t), np.sin(t), 0.0] for t in np.pi / 3 * np.arange(6)])
WATER = np.array([[0.0, 0.0, 0.0], [0.0757, 0.0, 0.0587], [-0.0757, 0.0, 0.0587]])

#: Masses, places (nm), constrained pairs or None for all, and degrees of freedom, counted by hand.
MOLECULES = {
    "CO2": ([12.011, 15.999, 15.999], 0.116 * np.array([[0, 0, 0], [0, 0, 1], [0, 0, -1]]), None, 5),
    "N2": ([14.007, 14.007], 0.11 * np.array([[0, 0, 0], [1, 0, 0]]), None, 5),
    "methane": ([12.011, *4 * [1.008]], np.vstack([np.zeros(3), 0.109 * TETRAHEDRON]), None, 6),
    "benzene": ([*6 * [12.011], *6 * [1.008]], np.vstack([0.1391 * HEXAGON, 0.2471 * HEXAGON]), None, 6),
    "water": ([15.999, 1.008, 1.008], WATER, None, 6),
    "hinge": ([15.999, 1.008, 1.008], WATER, [(0, 1), (0, 2)], 7),
    "ion": ([22.99], np.zeros((1, 3)), None, 3),
    "chain": (4 * [14.0], 0.15 * np.tri(4, 3, -1), [(0, 1), (1, 2), (2, 3)], 9),
}
MIXED = [name for name in MOLECULES if name != "N2"]
INTEGRATORS = {
    "constant energy": lambda **options: rb.ExactRigidBodyIntegrator(0.002, **options),
    "Langevin": lambda **options: rb.ExactRigidBodyLangevinIntegrator(BATH, 5.0, 0.002, **options),
    "rescaling": lambda **options: rb.ExactRigidBodyRescalingIntegrator(BATH, 0.1, 0.002, **options),
    "Nosé-Hoover": lambda **options: rb.ExactRigidBodyNoseHooverIntegrator(BATH, 5.0, 0.002, **options),
    "hybrid": lambda **options: rb.ExactRigidBodyHybridIntegrator(BATH, 5.0, 0.002, **options),
}


def gas(names, named=False, remover=False):
    """Return a System of molecules that do not see each other, places, bodies to be named, and degrees of freedom."""
    system, places, bodies, freedom = openmm.System(), [], [], -3 * bool(remover)
    for number, name in enumerate(names):
        masses, x, pairs, own = MOLECULES[name]
        first = system.getNumParticles()
        for mass in masses:
            system.addParticle(mass)
        particles = range(first, first + len(masses))
        if named and pairs is None and len(masses) > 1:
            bodies.append(list(particles))
        else:
            for i, j in itertools.combinations(range(len(masses)), 2) if pairs is None else pairs:
                system.addConstraint(first + i, first + j, np.linalg.norm(x[i] - x[j]))
        places.append(x + 2.0 * number * np.eye(3)[0])
        freedom += own
    if remover:
        system.addForce(openmm.CMMotionRemover(int(remover)))
    return system, np.concatenate(places), bodies or None, freedom


def printed(simulation, steps, every=1):
    """Return the temperatures that OpenMM's reporter prints in some steps."""
    text = io.StringIO()
    simulation.reporters.append(app.StateDataReporter(text, every, temperature=True))
    simulation.step(steps)
    simulation.reporters.pop()
    return np.array([float(line) for line in text.getvalue().splitlines()[1:]])


def of_particles(context, freedom):
    """Return 2 K / (f k) by the velocities of the particles."""
    system, v = context.getSystem(), context.getState(velocities=True).getVelocities(asNumpy=True)._value
    masses = [system.getParticleMass(i)._value for i in range(system.getNumParticles())]
    return masses @ (v**2).sum(axis=1) / (freedom * KB)


@pytest.mark.parametrize("remover", [False, True], ids=["", "remover"])
@pytest.mark.parametrize(
    ("kind", "names", "named"),
    [
        ("constant energy", 4 * ["CO2"], False),
        ("constant energy", 4 * ["CO2"], True),
        ("constant energy", 4 * ["benzene"], False),
        ("constant energy", MIXED, False),
        *((kind, 2 * MIXED, True) for kind in INTEGRATORS),
    ],
    ids=["linear and redundant", "linear and named", "planar and redundant", "mixed", *INTEGRATORS],
)
def test_openmms_reporter_prints_the_temperature_of_the_bodies(kind, names, named, remover):
    system, places, bodies, freedom = gas(names, named, remover)
    integrator = INTEGRATORS[kind](bodies=bodies)
    simulation = simulation_of(integrator, system, places)
    integrator.setVelocitiesToTemperature(BATH, 1)
    found = printed(simulation, 3)[-1]
    assert found == pytest.approx(of_particles(simulation.context, freedom), rel=1e-12)
    parts = zip(integrator.degreesOfFreedom(), integrator.temperatures(), strict=True)
    assert found == pytest.approx(sum(n * temperature._value for n, temperature in parts) / freedom, rel=1e-12)


@pytest.mark.parametrize("remover", [False, True, 1000], ids=["", "remover", "between removals"])
@pytest.mark.parametrize(("names", "named"), [(["CO2"], False), (["CO2"], True), (MIXED, False)])
def test_the_mean_that_it_prints_is_that_of_the_bath(names, named, remover):
    """Without forces every exchange draws momenta anew where the friction is high.

    Few molecules show whether those of the centre of mass count, which the friction sets in motion between removals.
    """
    system, places, bodies, freedom = gas(3 * names, named, remover)
    integrator = rb.ExactRigidBodyLangevinIntegrator(BATH, 5e3, 0.002, bodies=bodies)
    integrator.setRandomNumberSeed(3)
    simulation = simulation_of(integrator, system, places)
    found = printed(simulation, 500)
    assert abs(found[20:].mean() - BATH) < 4.0 * BATH * np.sqrt(2.0 / (freedom * 480))
    of_groups = integrator.temperatures(groups={"all": range(system.getNumParticles())})["all"]
    assert [T._value for T in of_groups] == pytest.approx([T._value for T in integrator.temperatures()], rel=1e-12)


def test_without_degrees_of_freedom_there_is_no_temperature():
    system, places, _, _ = gas(["ion"], remover=True)
    integrator = rb.ExactRigidBodyIntegrator(0.002)
    simulation = simulation_of(integrator, system, places)
    assert np.isnan(integrator.computeSystemTemperature().value_in_unit(unit.kelvin))
    assert np.isnan(printed(simulation, 1)).all()


# -- velocities that the Context draws --------------------------------------------------------------------------------


@pytest.mark.parametrize("remover", [False, True], ids=["", "remover"])
@pytest.mark.parametrize(
    ("names", "named"),
    [(4 * ["CO2"], False), (4 * ["CO2"], True), (4 * ["methane"], False), (2 * ["benzene"], False), (MIXED, False)],
)
def test_a_context_draws_canonical_velocities_before_the_first_step(names, named, remover):
    """OpenMM's solver of constraints diverges for most of these molecules."""
    system, places, bodies, freedom = gas(names, named, remover)
    simulation = simulation_of(rb.ExactRigidBodyIntegrator(0.002, bodies=bodies), system, places)
    found = []
    for seed in range(1, 61):
        simulation.context.setVelocitiesToTemperature(BATH * unit.kelvin, seed)
        found.append(of_particles(simulation.context, freedom))
    assert abs(np.mean(found) - BATH) < 4.0 * BATH * np.sqrt(2.0 / (freedom * 60))
    simulation.step(2)
    assert of_particles(simulation.context, freedom) == pytest.approx(found[-1], rel=1e-9)


@pytest.mark.parametrize("places", [STRAIGHT, FLAT], ids=["straight", "flat"])
def test_what_a_context_draws_does_not_bend_a_body(places):
    """OpenMM's solver may converge here, and leaves motions across all constraints: a sixth of the energy, and more."""
    system = openmm.System()
    for _ in places:
        system.addParticle(12.0)
    for i, j in itertools.combinations(range(len(places)), 2):
        system.addConstraint(i, j, np.linalg.norm(places[i] - places[j]))
    simulation = simulation_of(integrator := rb.ExactRigidBodyIntegrator(0.002), system, places)
    for seed in range(1, 6):
        simulation.context.setVelocitiesToTemperature(BATH, seed)
        seen = of_particles(simulation.context, sum(integrator.degreesOfFreedom()))
        assert seen == pytest.approx(integrator.computeSystemTemperature()._value, rel=1e-9)


def test_a_context_draws_for_molecules_that_the_box_splits():
    """Constraints along wrong directions take a third of the rotational energy."""
    system, places, _, freedom = gas(20 * ["water"])
    split = np.mod(places - np.repeat(places[::3], 3, axis=0), 3.0)
    system.setDefaultPeriodicBoxVectors(*(3.0 * np.eye(3)))
    force = openmm.CustomNonbondedForce("0")
    force.setNonbondedMethod(force.CutoffPeriodic)
    for _ in places:
        force.addParticle([])
    system.addForce(force)
    simulation, found = simulation_of(rb.ExactRigidBodyIntegrator(0.002), system, split), []
    for seed in range(1, 41):
        simulation.context.setPositions(split)
        simulation.context.setVelocitiesToTemperature(BATH, seed)
        found.append(simulation.integrator.computeSystemTemperature()._value)
    assert abs(np.mean(found) - BATH) < 4.0 * BATH * np.sqrt(2.0 / (freedom * 40))


def test_the_context_and_the_integrator_draw_the_same():
    drawn = []
    for draws in (lambda s: s.context, lambda s: s.integrator):
        system, places, _, _ = gas(MIXED)
        simulation = simulation_of(rb.ExactRigidBodyIntegrator(0.002), system, places)
        draws(simulation).setVelocitiesToTemperature(BATH, 5)
        drawn.append(simulation.context.getState(velocities=True).getVelocities(asNumpy=True)._value)
    np.testing.assert_array_equal(*drawn)
    assert drawn[0].any()
