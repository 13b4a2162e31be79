"""What a user changes between calls, in Contexts of every place where steps are performed."""

import copy
from contextlib import nullcontext

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
import starts
from openmm_exactrb.schemes import WITH_THERMOSTAT
from places import REFERENCE, no_library, platform_for
from starts import positions_of, velocities_of

#: Where steps are performed: on the host, with integrators of the library or without one, or by the kernels.
PLACES = ["host", "no library", "kernels", pytest.param("OpenCL", marks=pytest.mark.opencl)]
WALL = 3  # number of oxygens that can be restrained


def mixture(flexible):
    """Return a System of eight waters and a frozen atom in a box, with molecules of two atoms if `flexible`."""
    _, system, positions = rb.rigid_water(
        8, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.3 * unit.nanometer, seed=2
    )
    x = np.array(positions._value)
    force = starts.force_of(system)
    force.setCutoffDistance(0.55)
    system.setDefaultPeriodicBoxVectors(*(1.3 * np.eye(3)))
    bonds = openmm.HarmonicBondForce()
    bonds.setName("bonds")
    places = [[0.95, 0.1, 0.1], *([[1.0, 0.5, 0.3], [1.12, 0.5, 0.3], [0.3, 1.0, 0.9], [0.42, 1.0, 0.9]] * flexible)]
    for k in range(len(places)):
        system.addParticle(0.0 if k == 0 else 14.0)
        force.addParticle(0.3 * (-1) ** k if k else 0.0, 0.3, 0.6)
    for k in range(len(x) + 1, len(x) + len(places), 2):
        bonds.addBond(k, k + 1, 0.12, 3e5)
        force.addException(k, k + 1, 0.0, 0.1, 0.0)
    if flexible:
        system.addForce(bonds)
    restraint = openmm.CustomExternalForce("k*((x-a)^2+(y-b)^2+(z-c)^2)")
    for name in "kabc":
        restraint.addPerParticleParameter(name)
    for i in range(0, 3 * WALL, 3):
        restraint.addParticle(i, [0.0, *(x[i] + 0.02)])
    restraint.setName("restraint")
    field = openmm.CustomExternalForce("field*sin(5*x+4*y)")
    field.addGlobalParameter("field", 5.0)
    for i in range(0, len(x), 3):
        field.addParticle(i)
    field.setForceGroup(1)
    field.setName("field")
    system.addForce(restraint)
    system.addForce(field)
    return system, np.concatenate([x, places])


class Run:
    """A Context of a place, and what `fresh` needs to know of it."""

    def __init__(self, place, scheme, flexible, thermostat=None):
        self.place, self.scheme, self.thermostat = place, scheme, thermostat
        self.h = 0.002 * max(1, (WITH_THERMOSTAT | rb.SCHEMES)[scheme].forces)
        self.system, x = mixture(flexible)
        self.integrator = self.made(place)
        self.context = starts.context_of(self.system, self.integrator, x, kelvin=300.0, **self.platform)

    @property
    def platform(self):
        platform, properties = platform_for("native" if self.place == "OpenCL" else "host")
        return {"platform": platform, "properties": properties}

    def made(self, place):
        thermostat = None if self.thermostat is None else rb.thermostats.Langevin(300.0, 1.0)
        engine = "native" if place in ("kernels", "OpenCL") else "host"
        with no_library() if place == "no library" else nullcontext():
            return rb.ExactRigidBodyIntegrator(self.h, self.scheme, engine=engine, thermostat=thermostat)

    def fresh(self):
        """Return a new Context on the host that starts from what is shown."""
        integrator = self.made("host")
        integrator.setStepSize(self.integrator.getStepSize())
        integrator.setIntegrationForceGroups(self.integrator.getIntegrationForceGroups())
        context = openmm.Context(copy.deepcopy(self.system), integrator, REFERENCE)
        take(context, self.context)
        return context

    def force(self, name):
        return next(force for force in self.system.getForces() if force.getName() == name)

    @property
    def energy(self):
        return energy_of(self.context)


def take(context, other):
    """Set a Context to the state of another one, whose System may have had further parameters."""
    state = other.getState(positions=True, velocities=True)
    context.setTime(state.getTime())
    openmm.Context.setStepCount(context, state.getStepCount())  # by our Contexts, a user begins new noise
    context.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    context.setPositions(state.getPositions())
    context.setVelocities(state.getVelocities())
    for name in set(context.getParameters()) & set(other.getParameters()):
        context.setParameter(name, other.getParameter(name))


def energy_of(context):
    state = context.getState(energy=True, groups=context.getIntegrator().getIntegrationForceGroups())
    return (state.getPotentialEnergy() + state.getKineticEnergy())._value


# -- changes ----------------------------------------------------------------------------------------------------------


def restraint(run, rng):
    force = run.force("restraint")
    for k in range(WALL):
        i, (_, *place) = force.getParticleParameters(k)
        force.setParticleParameters(k, i, [rng.uniform(500.0, 3000.0), *place])
    force.updateParametersInContext(run.context)


def charges(run, rng):
    force, factor = starts.force_of(run.system), rng.uniform(0.6, 0.95)
    for i in range(24):
        q, sigma, epsilon = force.getParticleParameters(i)
        force.setParticleParameters(i, factor * q, sigma, epsilon)
    force.updateParametersInContext(run.context)


def bonds(run, rng):
    force = run.force("bonds")
    for k in range(force.getNumBonds()):
        i, j, length, _ = force.getBondParameters(k)
        force.setBondParameters(k, i, j, length, rng.uniform(1e5, 5e5))
    force.updateParametersInContext(run.context)


def parameter(run, rng):
    run.context.setParameter("field", rng.uniform(10.0, 40.0))


def box(run, rng):
    run.context.setPeriodicBoxVectors(*(rng.uniform(1.2, 1.6) * np.eye(3)))


def step_size(run, rng):
    run.integrator.setStepSize(run.h * rng.uniform(0.5, 0.9))


def groups(run, rng):
    run.integrator.setIntegrationForceGroups({0} if run.integrator.getIntegrationForceGroups() & 2 else {0, 1})


def added_force(run, rng):
    force = openmm.CustomExternalForce(f"{rng.uniform(20.0, 60.0)}*cos(4*z)")
    for i in range(24):
        force.addParticle(i)
    run.system.addForce(force)
    run.context.reinitialize(preserveState=True)


def removed_force(run, rng):
    names = [force.getName() for force in run.system.getForces()]
    if "field" in names:
        run.system.removeForce(names.index("field"))
    run.context.reinitialize(preserveState=True)


def positions(run, rng):
    run.context.setPositions(positions_of(run.context) + np.array([rng.uniform(0.01, 0.1), 0.0, 0.02]))


def velocities(run, rng):
    run.context.setVelocities(rng.uniform(-1.1, 1.1) * velocities_of(run.context))


def frozen_particle(run, rng):
    x = positions_of(run.context)
    x[24] += [0.0, 0.0, rng.uniform(-0.05, 0.05)]
    run.context.setPositions(x)


def state_of_another_integrator(run, rng):
    """Of Verlet, whose velocities have components along the constraints."""
    other = openmm.VerletIntegrator(0.0005)
    other.setConstraintTolerance(1e-12)
    context = openmm.Context(copy.deepcopy(run.system), other, REFERENCE)
    take(context, run.context)
    other.step(rng.randint(1, 5))
    take(run.context, context)


def minimiser(run, rng):
    openmm.LocalEnergyMinimizer.minimize(run.context, 10.0, rng.randint(1, 3))
    run.context.setVelocitiesToTemperature(300.0, 2)


PULL = {"strength": 0.0}  # data that a function of Python reads


def pull_of_data(state):
    """Return the energy and the forces of a field."""
    x = state.getPositions(asNumpy=True)._value
    return PULL["strength"] * np.sin(3.0 * x).sum(), -3.0 * PULL["strength"] * np.cos(3.0 * x)


def with_silent_forces(run):
    """Add forces of which OpenMM does not report all changes, and make the Context again."""
    PULL["strength"] = 0.0
    springs = openmm.CustomBondForce("k*r^2")
    springs.addPerBondParameter("k")
    for i in range(0, 9, 3):
        springs.addBond(i, i + 12, [0.0])
    variable = openmm.CustomCVForce("energy")
    variable.addCollectiveVariable("energy", springs)
    run.system.addForce(openmm.PythonForce(pull_of_data))
    run.system.addForce(variable)
    run.context.reinitialize(preserveState=True)


def data_of_a_function(run, rng):
    PULL["strength"] = rng.uniform(5.0, 20.0)


def inner_context(run, rng):
    """Change springs in the Context of a collective variable, and in the System, of which `fresh` makes a copy."""
    force = starts.force_of(run.system, openmm.CustomCVForce)
    context, strength = force.getInnerContext(run.context), rng.uniform(200.0, 900.0)
    for springs in (force.getCollectiveVariable(0), context.getSystem().getForce(0)):
        for k in range(springs.getNumBonds()):
            i, j, _ = springs.getBondParameters(k)
            springs.setBondParameters(k, i, j, [strength])
    springs.updateParametersInContext(context)


UPDATES = [restraint, charges]
SILENT = [data_of_a_function, inner_context]
CHANGES = [
    *UPDATES,
    parameter,
    box,
    step_size,
    groups,
    added_force,
    removed_force,
    positions,
    velocities,
    frozen_particle,
    state_of_another_integrator,
    minimiser,
]


def shown(context):
    return np.concatenate([positions_of(context), velocities_of(context)])


def assert_goes_on_from_what_is_shown(run, exact=True):
    """Check step(0), which corrects shapes and velocities that are not `exact`, and one step as of a new Context."""
    before = shown(run.context)
    run.integrator.step(0)
    first = shown(run.context)
    if exact:
        np.testing.assert_allclose(first, before, rtol=0.0, atol=1e-12)
    else:
        np.testing.assert_allclose(first[: len(first) // 2], before[: len(first) // 2], rtol=0.0, atol=1e-6)
    run.integrator.step(0)
    np.testing.assert_array_equal(shown(run.context), first)
    other, energy = run.fresh(), run.energy
    for context in (run.context, other):
        context.getIntegrator().setRandomNumberSeed(5)
    assert energy_of(other) == pytest.approx(energy, abs=1e-4)
    run.integrator.step(1)
    other.getIntegrator().step(1)
    used, fresh = run.energy - energy, energy_of(other) - energy
    precision = 1e-8 if run.place == "OpenCL" else 1e-9  # the new Context has the forces of Reference
    np.testing.assert_allclose(positions_of(run.context), positions_of(other), rtol=0.0, atol=precision)
    if run.thermostat is None:
        assert abs(used - fresh) <= 0.1 * abs(fresh) + 1e-3
