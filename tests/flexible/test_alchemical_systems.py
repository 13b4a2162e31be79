"""Alchemical Systems: their fast forces, steps of both engines, parameters that change, and what OpenMM saves."""

import copy
import warnings

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from alchemical import CHANGED, alchemical
from both_engines import apart, maker, pair, twice_from
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.multiple_time_steps.bonded import interacting_exceptions
from openmm_exactrb.multiple_time_steps.excerpt import bonded_excerpt
from openmm_exactrb.multiple_time_steps.stiffness import fastest, frequencies
from openmm_exactrb.openmm_access.platforms import DEVICES
from peptides import in_water, peptide
from places import PLATFORMS
from products import spread_over
from starts import context_of, held

pytestmark = pytest.mark.library

ROUNDOFF = 1e-13
SCHEMES = [("S2_2", None), ("W2_1", None), ("BAOA", 0.0), ("W2_3m", 0.0)]


def changed(context, parameters):
    for name, value in parameters.items():
        context.setParameter(name, value)


# -- fast forces ------------------------------------------------------------------------------------------------------


def test_kernels_have_all_fast_forces():
    _, system, x = in_water("HBonds", 6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.006, "BAOA")
        _context = context_of(alchemical(system), integrator, x)
        integrator.step(2)
    assert integrator.getEngine() == "native"
    assert integrator.timings.fast_evaluations > 2


def exceptions_alone(force):
    """Return a System with the exceptions of a force, which then has no other pairs."""
    n = force.getNumParticles()
    there = {frozenset(force.getExceptionParameters(k)[:2]) for k in range(force.getNumExceptions())}
    for i in range(n):
        for j in range(i):
            if {i, j} not in there:
                force.addException(i, j, 0.0, 0.1, 0.0)
    system = openmm.System()
    for _ in range(n):
        system.addParticle(1.0)
    system.addForce(force)
    return system


NAMES = "lambda", "lambda2", "scale", "r2", "charge", "theta", "x", "p0", "e"
UNUSABLE = "r", "charges0", "sigma", "epsilon1", "lambda-1", "2nd", "λ"


def with_offsets(names, seed):
    """Return a force whose exceptions have up to three offsets each, by given parameters."""
    rng, force = np.random.default_rng(seed), openmm.NonbondedForce()
    for name in names:
        force.addGlobalParameter(name, float(rng.uniform(-1.0, 1.0)))
    for _ in range(12):
        force.addParticle(0.0, 0.1, 0.0)
    for i in range(9):
        number = force.addException(i, i + 3, *(rng.uniform((-0.5, 0.2, 0.0), (0.5, 0.4, 2.0)) * (i % 3 > 0)))
        for name in rng.permutation(names)[: rng.integers(4)]:
            force.addExceptionParameterOffset(str(name), number, *rng.uniform(-0.1, 0.1, 3))
    return force


@pytest.mark.parametrize("seed", range(4))
def test_exceptions_with_offsets_become_bonded_forces_of_the_same_energy(seed):
    rng, force = np.random.default_rng(seed), with_offsets(NAMES, seed)
    x = rng.uniform(0.0, 1.0, (12, 3))
    theirs = context_of(exceptions_alone(copy.deepcopy(force)), openmm.VerletIntegrator(0.001), x)
    system = exceptions_alone(openmm.NonbondedForce())
    for _ in range(12):
        system.addParticle(1.0)
    for part in interacting_exceptions(force):
        system.addForce(part.made())
    system.removeForce(0)
    ours = context_of(system, openmm.VerletIntegrator(0.001), x)
    for _ in range(2):
        one, other = (context.getState(energy=True, forces=True) for context in (ours, theirs))
        assert one.getPotentialEnergy()._value == pytest.approx(other.getPotentialEnergy()._value, rel=1e-9)
        a, b = (state.getForces(asNumpy=True)._value for state in (one, other))
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-9 * np.abs(b).max())
        for name in ours.getParameters():
            value = float(rng.uniform(-1.0, 1.0))
            ours.setParameter(name, value)
            theirs.setParameter(name, value)


@pytest.mark.parametrize("name", UNUSABLE)
def test_offsets_by_a_parameter_that_no_formula_can_contain_stay_slow(name):
    force = openmm.NonbondedForce()
    force.addGlobalParameter(name, 0.5)
    for _ in range(4):
        force.addParticle(0.0, 0.1, 0.0)
    for k, numbers in enumerate(((0.2, 0.3, 0.0), (0.0, 0.3, 0.0))):
        force.addExceptionParameterOffset(name, force.addException(k, k + 2, *numbers), 0.1, 0.0, 0.0)
    (fast,) = interacting_exceptions(force)
    assert fast.whole.tolist() == [[0, 2]]


def test_alchemical_bonds_and_angles_are_as_fast_as_the_others():
    for constraints in ("HBonds", "None"):
        _, system, _ = peptide(constraints)
        found = [
            sorted(float(w) for some, _ in frequencies(each) for w in some if w > 50.0)  # without soft-core pairs
            for each in (system, alchemical(system))
        ]
        np.testing.assert_allclose(found[1], found[0], rtol=0.02)


@pytest.mark.parametrize("theta0", [0.9, 1.6, 2.4, 3.1, np.pi])
def test_angles_of_a_formula_are_as_fast_as_they_are(theta0):
    found = []
    for force in (openmm.HarmonicAngleForce(), openmm.CustomAngleForce("k/2*(theta-theta0)^2")):
        bonds, system = openmm.HarmonicBondForce(), openmm.System()
        for mass in (12.0, 14.0, 1.0):
            system.addParticle(mass)
        for i in range(2):
            bonds.addBond(i, i + 1, 0.12, 1.0)
        if isinstance(force, openmm.CustomAngleForce):
            force.addPerAngleParameter("theta0")
            force.addPerAngleParameter("k")
            force.addAngle(0, 1, 2, [theta0, 500.0])
        else:
            force.addAngle(0, 1, 2, theta0, 500.0)
        for each in (bonds, force):
            system.addForce(each)
        found.append(fastest(system))
    assert found[1] == pytest.approx(found[0], rel=0.01)


# -- steps ------------------------------------------------------------------------------------------------------------


@spread_over({"scheme, friction": SCHEMES, "platform": PLATFORMS}, indirect=["platform"])
def test_engines_agree_while_parameters_change(scheme, friction, platform):
    _, system, x = in_water("HBonds", 6)
    contexts = pair(alchemical(system), x, maker(scheme, friction=friction, fast="bonded"), platform=platform)
    assert [context.getIntegrator().getEngine() for context in contexts] == ["host", "native"]
    for parameters in ({}, *({name: value} for name, value in CHANGED.items()), dict.fromkeys(CHANGED, 0.0)):
        for context in contexts:
            changed(context, parameters)
            context.getIntegrator().step(4)
    assert apart(*contexts) < ROUNDOFF


@spread_over({"scheme, friction": SCHEMES, "platform": PLATFORMS}, indirect=["platform"])
def test_changed_parameters_are_those_of_a_new_context(scheme, friction, platform):
    _, system, x = in_water("HBonds", 6)
    make = maker(scheme, friction=friction, fast="bonded")
    started, _ = (old, new) = pair(alchemical(system), x, lambda engine: make("native"), platform=platform)
    old.getIntegrator().step(5)
    changed(old, CHANGED)
    changed(new, CHANGED)
    start = started.getState(positions=True, velocities=True)
    for context in (old, new):
        context.setPositions(start.getPositions())
        context.setVelocities(start.getVelocities())
        context.getIntegrator().step(5)
    assert apart(old, new) < ROUNDOFF


@spread_over({"platform": PLATFORMS, "fast": [(1,), "bonded"]}, indirect=["platform"])
def test_a_fast_group_of_custom_forces_has_kernels(fast, platform):
    _, system, x = in_water("HBonds", 6)
    system = alchemical(system)
    assert rb.separate_bonded(system) == 1
    contexts = pair(system, x, maker("S2_2", fast=fast), platform=platform)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for context in contexts:
            context.getIntegrator().step(10)
    # On devices, OpenMM's own custom forces have parameters in single precision.
    assert apart(*contexts) < (1e-9 if platform.getName() in DEVICES and fast == (1,) else ROUNDOFF)


def test_new_numbers_of_terms_and_offsets_are_seen(platform):
    _, system, x = in_water("HBonds", 6)
    system = alchemical(system)
    old, new = pair(system, x, lambda engine: maker("S2_2", fast="bonded")("native"), platform=platform)
    old.getIntegrator().step(3)
    for context in (old, new):
        for force in context.getSystem().getForces():
            if isinstance(force, openmm.NonbondedForce):
                for k in range(force.getNumExceptionParameterOffsets()):
                    name, exception, charges, sigma, epsilon = force.getExceptionParameterOffset(k)
                    force.setExceptionParameterOffset(k, name, exception, 0.5 * charges, sigma, epsilon)
            elif isinstance(force, openmm.CustomAngleForce):
                for k in range(force.getNumAngles()):
                    i, j, l, (theta0, strength) = force.getAngleParameters(k)
                    force.setAngleParameters(k, i, j, l, (theta0, 0.8 * strength))
            else:
                continue
            force.updateParametersInContext(context)
    start = old.getState(positions=True, velocities=True)
    for context in (old, new):
        context.setPositions(start.getPositions())
        context.setVelocities(start.getVelocities())
        context.getIntegrator().step(3)
    assert apart(old, new) < ROUNDOFF
    excerpts = [bonded_excerpt(context.getSystem(), find_bodies(context.getSystem(), x)) for context in (old, new)]
    for one, other in zip(*(excerpt.forces for excerpt in excerpts), strict=True):
        np.testing.assert_array_equal(one.numbers, other.numbers)


def test_derivatives_by_parameters_are_openmms(platform):
    _, system, x = in_water("HBonds", 6)
    system = alchemical(system, derivatives=["lambda_sterics", "lambda_bonded"])
    integrator = rb.ExactRigidBodyIntegrator(0.004, "W2_1", fast="bonded", engine="native")
    context = context_of(system, integrator, x, kelvin=300.0, platform=platform)
    changed(context, CHANGED)
    integrator.step(5)
    found = context.getState(parameterDerivatives=True, positions=True)
    plain = context_of(system, openmm.VerletIntegrator(0.001), found.getPositions())
    changed(plain, CHANGED)
    theirs = plain.getState(parameterDerivatives=True).getEnergyParameterDerivatives()
    for name in ("lambda_sterics", "lambda_bonded"):
        value = found.getEnergyParameterDerivatives()[name]
        assert value == pytest.approx(theirs[name], rel=1e-4)  # of single precision on some platforms
        assert abs(value) > 1.0
        values = []
        for shift in (-1e-4, 1e-4):
            plain.setParameter(name, CHANGED[name] + shift)
            values.append(plain.getState(energy=True).getPotentialEnergy()._value)
        plain.setParameter(name, CHANGED[name])
        assert theirs[name] == pytest.approx((values[1] - values[0]) / 2e-4, rel=1e-5)


@spread_over({"platform": PLATFORMS, "scheme, friction": [("W2_1", None), ("W2_3m", 2.0)]}, indirect=["platform"])
def test_a_checkpoint_has_the_parameters(scheme, friction, platform):
    _, system, x = in_water("HBonds", 6)
    _, context = pair(alchemical(system), x, maker(scheme, friction=friction, fast="bonded"), platform=platform)
    changed(context, CHANGED)
    context.getIntegrator().step(3)
    checkpoint = context.createCheckpoint()
    context.getIntegrator().step(3)
    end = held(context)
    changed(context, dict.fromkeys(CHANGED, 1.0))
    again = twice_from(checkpoint, context, 3)
    np.testing.assert_array_equal(*again)
    np.testing.assert_allclose(again[0], end, rtol=0.0, atol=5e-12)
