"""Thermostats of flexible molecules: along the constraints alone, and with forces within the drifts."""

import copy
import pickle

import numpy as np
import openmm
import pytest
from scipy import stats

import openmm_exactrb as rb
from peptides import R, moving, peptide, positions_of, violations
from places import HOST_AND_NATIVE, platform_for
from starts import context_of, velocities_of


def test_strong_friction_makes_every_kinetic_energy_canonical():
    """The noise acts along the constraints only: a chi-square number of all degrees of freedom after each step."""
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1e5, 1e-4)
    integrator.setRandomNumberSeed(4)
    context = context_of(system, integrator, x)
    freedom, energies = sum(integrator.degreesOfFreedom()), []
    for _ in range(300):
        integrator.step(1)
        energies.append(2.0 * sum(e._value for e in integrator.kineticEnergies()) / (300.0 * R))
    assert stats.kstest(energies, stats.chi2(freedom).cdf).pvalue > 0.01
    length, slip = violations(system, positions_of(context), velocities_of(context))
    assert length < 1e-15
    assert slip < 1e-13


def test_rescaling_accounts_for_the_energy_along_the_constraints_alone():
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.02, 0.0005, "W4_5")
    integrator.setRandomNumberSeed(4)
    _context = context_of(system, integrator, x)
    integrator.setVelocitiesToTemperature(300.0, 1)
    before = integrator.effectiveEnergy()._value
    integrator.step(100)
    assert abs(integrator.heat()._value) > 1.0
    assert integrator.effectiveEnergy()._value == pytest.approx(before, abs=1e-3)


THERMOSTATTED = {
    "Langevin": lambda h, **options: rb.ExactRigidBodyLangevinIntegrator(300.0, 0.0, h, **options),
    "rescaling": lambda h, **options: rb.ExactRigidBodyRescalingIntegrator(300.0, 1e300, h, **options),
    "hybrid": lambda h, **options: rb.ExactRigidBodyHybridIntegrator(300.0, 0.0, h, **options),
}


def started(integrator, system, x, seed=4):
    integrator.setRandomNumberSeed(seed)
    context = context_of(system, integrator, x)
    integrator.setVelocitiesToTemperature(300.0, 3)
    return context


@pytest.mark.parametrize("scheme", ["S2_2", "W4_5"])
@pytest.mark.parametrize("kind", ["Langevin", "hybrid"])
def test_a_thermostat_that_does_nothing_leaves_the_trajectory_with_inner_steps_bit_for_bit(kind, scheme):
    _, system, x = peptide()
    alone, _context = moving(system, x, 0.001, scheme, fast="bonded", engine="host")
    integrator = THERMOSTATTED[kind](0.001, scheme=scheme, fast="bonded", engine="host")
    _other = started(integrator, system, x)
    for moved in (alone, integrator):
        moved.timings.reset()
        moved.step(20)
    if kind == "hybrid":
        assert integrator.acceptanceRate() == 1.0  # else momenta would have turned
    for ours, plain in zip(integrator.fullState()[1], alone.fullState()[1], strict=True):
        np.testing.assert_array_equal(ours, plain)
    assert integrator.timings.evaluations == alone.timings.evaluations
    assert integrator.timings.fast_evaluations == alone.timings.fast_evaluations


def test_a_thermostat_within_a_step_leaves_the_bonded_forces_about_it():
    """BAOAB without friction is velocity Verlet: each half of its drift has half of the inner steps."""
    _, system, x = peptide()
    plain, _one = moving(system, x, 0.001, "V2", fast="bonded", inner="S2_2", innerSteps=2)
    within = rb.ExactRigidBodyLangevinIntegrator(300.0, 0.0, 0.001, "BAOAB", fast="bonded", inner="S2_2", innerSteps=2)
    _other = started(within, system, x)
    for moved in (plain, within):
        moved.step(20)
    for ours, theirs in zip(within.bodyState()[1], plain.bodyState()[1], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-10)
    assert within.timings.fast_evaluations == plain.timings.fast_evaluations


@pytest.mark.parametrize("maker", THERMOSTATTED.values(), ids=THERMOSTATTED)
def test_copies_have_the_inner_steps_of_the_original(maker):
    integrator = maker(0.002, fast=(1, 2), inner="V2", innerSteps=3)
    for twin in (copy.copy(integrator), pickle.loads(pickle.dumps(integrator))):
        assert type(twin) is type(integrator)
        assert twin.getMultipleTimeSteps() == integrator.getMultipleTimeSteps()


def test_rescaling_with_inner_steps_keeps_the_effective_energy():
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.02, 0.002, "W4_5", fast="bonded")
    _context = started(integrator, system, x)
    before = integrator.effectiveEnergy()._value
    integrator.step(50)
    assert abs(integrator.heat()._value) > 1.0
    assert integrator.effectiveEnergy()._value == pytest.approx(before, abs=1e-2)


def quadratic_clusters(n):
    """Return a System of n times XH3 whose members are drawn to places, by forces of two groups, and these (nm).

    Both are harmonic: what holds a cluster, and the bond from its middle to an atom that stands still.
    """
    system, field = openmm.System(), openmm.CustomExternalForce("500*(x^2 + y^2 + 2*z^2)")
    bond = openmm.HarmonicBondForce()
    bond.setForceGroup(1)
    places = np.array([[0.0, 0, 0], [0.1, 0, 0.03], [-0.05, 0.087, 0.03], [-0.05, -0.087, 0.03], [0, 0, -0.15]])
    for _ in range(n):
        middle, *members, still = (system.addParticle(mass) for mass in (12.0, 1.0, 1.0, 1.0, 0.0))
        for i, place in zip(members, places[1:4], strict=True):
            system.addConstraint(middle, i, float(np.linalg.norm(place)))
            field.addParticle(i)
        bond.addBond(middle, still, 0.15, 3e5)
    for force in (field, bond):
        system.addForce(force)
    return system, np.tile(places, (n, 1))


@pytest.mark.parametrize(
    ("kind", "n", "samples"), [("Langevin", 40, 80), pytest.param("hybrid", 4, 200, marks=pytest.mark.validate)]
)
def test_equipartition_of_a_constrained_cluster_with_inner_steps(kind, n, samples):
    """Twice the kinetic energy is kT for each degree of freedom, with steps that only inner steps bear.

    The hybrid has few clusters, lest no proposal is taken. A false alarm in 1400.
    """
    system, x = quadratic_clusters(n)
    h = 0.012  # the bond alone turns by 2 within a step
    integrators = {"Langevin": rb.ExactRigidBodyLangevinIntegrator, "hybrid": rb.ExactRigidBodyHybridIntegrator}
    integrator = integrators[kind](300.0, 5.0, h, "S2_2", fast="bonded")
    _context = started(integrator, system, x)
    freedom, ratios = sum(integrator.degreesOfFreedom()), []
    assert freedom == 9 * n
    integrator.step(100)
    for _ in range(samples):
        integrator.step(4)
        ratios.append(2.0 * sum(e._value for e in integrator.kineticEnergies()) / (300.0 * R * freedom))
    blocks = np.reshape(ratios, (10, -1)).mean(axis=1)
    error = blocks.std(ddof=1) / np.sqrt(10)
    assert np.mean(ratios) == pytest.approx(1.0, abs=5.0 * error)  # of Student's distribution with 9 degrees
    assert error < 0.04  # a thermostat that heats what constraints hold would be off by a third
    if kind == "hybrid":
        assert 0.5 < integrator.acceptanceRate() < 1.0


def test_more_proposals_are_taken_where_bonds_have_inner_steps():
    _, system, x = peptide("None")
    rates = []
    for fast in (None, "bonded"):
        integrator = rb.ExactRigidBodyHybridIntegrator(300.0, 5.0, 0.008, "S2_2", stepsPerProposal=2, fast=fast)
        _context = started(integrator, system, x)
        integrator.step(60)
        rates.append(integrator.acceptanceRate())
    assert rates[1] > 0.8
    assert rates[1] > rates[0] + 0.2


def bent(platform, integrator, kelvin):
    """Return a Context of four bent molecules with two constraints each, in a box, with momenta of a temperature."""
    system, places, pairs = openmm.System(), [], openmm.NonbondedForce()
    pairs.setNonbondedMethod(openmm.NonbondedForce.CutoffPeriodic)
    pairs.setCutoffDistance(0.9)
    for k in range(4):
        a, b, c = (system.addParticle(mass) for mass in (12.0, 1.0, 1.0))
        for i, j in ((a, b), (a, c), (b, c)):
            pairs.addParticle(0.0, 0.3, 0.5)
            pairs.addException(i, j, 0.0, 1.0, 0.0)
        system.addConstraint(a, b, 0.1)
        system.addConstraint(a, c, 0.1)
        places += [(0.5 * k, 0.0, 0.0), (0.5 * k, 0.1, 0.0), (0.5 * k, 0.0, 0.1)]
    system.addForce(pairs)
    system.setDefaultPeriodicBoxVectors(*(2.0 * np.eye(3)))
    integrator.setRandomNumberSeed(1)
    context = context_of(system, integrator, places, platform=openmm.Platform.getPlatform(platform))
    integrator.setVelocitiesToTemperature(kelvin, 1)
    return context


@pytest.mark.parametrize("platform", ["CPU", "Reference"])
def test_a_cluster_that_finds_no_way_along_its_constraints_is_a_refusal_on_any_platform(platform):
    """OpenMM is not asked for forces at places that are no numbers: its CPU platform answers with its own error."""
    far_too_long = 1e6
    hybrid = rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, far_too_long, "V2_drift", fast=None)
    context = bent(platform, hybrid, 1e4)
    hybrid.step(2)
    assert hybrid.tally() == (0, 2)
    plain = rb.ExactRigidBodyIntegrator(far_too_long, "V2_drift", fast=None)
    context = bent(platform, plain, 1e4)
    with pytest.raises(rb.NonFiniteError, match="the cluster of particles 0, 1, 2"):
        plain.step(3)
    assert np.isfinite(positions_of(context)).all()


def stretched(scheme, h, engine, beside=None):
    """Return the mean momentum along a bond that slow forces of 500 kJ/mol/nm stretch, and the place of a rigid body.

    Nothing but friction: after 1 ps the bond is at rest but for what a step does to it. Both in OpenMM's units.
    """
    system, bond, pull = openmm.System(), openmm.HarmonicBondForce(), openmm.CustomExternalForce("-pull*x + rise*z")
    for mass in (12.0, 16.0, 16.0, 1.0, 1.0):
        system.addParticle(mass)
    for i, j, length in ((2, 3, 0.1), (2, 4, 0.1), (3, 4, 0.16)):
        system.addConstraint(i, j, length)
    bond.addBond(0, 1, 0.12, 4e5)
    for name in ("pull", "rise"):
        pull.addPerParticleParameter(name)
    for i, strengths in enumerate(((-500.0, 0.0), (500.0, 0.0), (0.0, 100.0))):
        pull.addParticle(i, strengths)
    system.addForce(bond)
    system.addForce(pull)
    options = {"scheme": scheme, "fast": "bonded", "engine": engine, "checkDivergence": False}
    integrator = rb.ExactRigidBodyLangevinIntegrator(1e-25, 100.0, h, **options)
    platform, properties = platform_for(beside or engine)
    context = openmm.Context(system, integrator, platform, properties)
    apex = (2.0, 2.0, 2.0)
    context.setPositions([(0.0, 0.0, 0.0), (0.12, 0.0, 0.0), apex, (2.08, 2.06, 2.0), (1.92, 2.06, 2.0)])
    integrator.step(round(1.0 / h))
    momentum = [12.0, 16.0] * velocities_of(context)[:2, 0]
    return 0.5 * (momentum[1] - momentum[0]), positions_of(context)


@pytest.mark.parametrize("engine", HOST_AND_NATIVE)
@pytest.mark.parametrize(("scheme", "h"), [("W2_3m", 0.024), ("BAOA", 0.006)])
def test_a_balance_of_fast_and_slow_forces_adds_no_momentum(scheme, h, engine):
    """The bond pulls throughout a step, what stretches it in kicks alone: where a step ends both must have done alike.

    A drift by the time t behind the heat exchange would end with 500 t, 1.3 and 1.5 here.
    """
    momentum, _ = stretched(scheme, h, engine)
    assert abs(momentum) < 1e-3


@pytest.mark.opencl
def test_the_native_engine_ends_a_step_where_the_host_does():
    host, device = (stretched("W2_3m", 0.024, engine, "native")[1] for engine in ("host", "native"))
    assert abs(host[2, 2] - 2.0) > 0.01  # the body has fallen
    np.testing.assert_allclose(device, host, rtol=0.0, atol=1e-10)
