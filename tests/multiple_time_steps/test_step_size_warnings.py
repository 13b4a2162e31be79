"""StepSizeWarning: resonances of nested forces, and heat that friction does not take away."""

import functools
import warnings

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.mechanics.divergence import Overheating, freedom_by_kind, kinetic_by_kind
from openmm_exactrb.multiple_time_steps.resonance import Resonances, growth
from openmm_exactrb.schemes import splitting
from openmm_exactrb.steps.substeps import DRIFT
from peptides import in_water, peptide
from starts import context_of, system_of


def floquet(scheme, angle, strength):
    """Return log |eigenvalue| of a step of an oscillator that turns by an angle, with a weak force in the kicks."""
    step = np.eye(2)
    for substep, part in scheme.sequence:
        turned = part * angle
        if substep == DRIFT:
            step = np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]]) @ step
        elif substep.kicks:
            step = np.array([[1.0, 0.0], [-strength * turned, 1.0]]) @ step
    return np.log(np.abs(np.linalg.eigvals(step)).max())


@pytest.mark.parametrize("name", ["W2_3m", "BAOA", "S2_2", "S2_3"])
@pytest.mark.parametrize("k", [1, 2, 3])
def test_an_oscillator_grows_at_the_rate_of_the_resonance(name, k):
    """At the worst angle near k pi, with a spring a thousandth of the oscillator's; rates are in units of w."""
    scheme, strength = splitting(name), 1e-3
    angles = k * np.pi * (1.0 + strength * np.linspace(-1.5, 0.5, 801))
    found = max(floquet(scheme, angle, strength) / angle for angle in angles)
    assert found / strength == pytest.approx(growth(scheme, k), abs=0.01)


def driven(scheme, interval, strength=2.8e5, mass=1.0):
    """Return by how much the energy grows in 4 ps: a bond to hydrogen in the drifts, and a slow spring in the kicks."""
    system = system_of([12.0, mass])
    bond, spring = openmm.HarmonicBondForce(), openmm.CustomExternalForce("0.5*12544*((x-0.1)^2+y^2+z^2)")
    bond.addBond(0, 1, 0.1, strength)
    spring.addParticle(1, [])
    system.addForce(bond)
    system.addForce(spring)
    options = {"fast": "bonded", "innerSteps": 24, "checkDivergence": False, "forceInterval": interval}
    integrator = rb.ExactRigidBodyIntegrator(scheme=scheme, **options)
    _context = context_of(system, integrator, [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    begin, largest = integrator.totalEnergy()._value, 0.0
    for _ in range(40):
        integrator.step(max(1, round(0.1 / integrator.getStepSize()._value)))
        largest = max(largest, integrator.totalEnergy()._value)
    return largest / begin


@pytest.mark.parametrize(("scheme", "edge"), [("W2_1", 0.0054), ("S2_2", 0.0027)])
def test_the_step_that_is_advised_lies_below_the_resonance(scheme, edge):
    """The least step that is warned of is where the energy begins to grow, and the advice is the tenth below it."""
    assert driven(scheme, edge) < 2.0  # no warning, which would be an error
    with pytest.warns(rb.StepSizeWarning, match=f"Use at most {1e3 * edge:.1f} fs per force evaluation"):
        assert driven(scheme, 1.035 * edge) > 1e3


@pytest.mark.parametrize("strength", [1.0, 400.0])
def test_a_bond_that_is_softer_than_the_slow_forces_is_no_resonance(strength):
    """As restraints are, and the pairs three bonds apart of CHARMM, where heavy hydrogens may have 8 fs a force."""
    assert driven("S2_3", 0.008, strength, 3.0) < 2.0  # no warning, which would be an error


def first(scheme, mass=None):
    topology, system, _ = peptide()
    if mass is not None:
        rb.heavy_hydrogens(system, topology, mass)
    scheme = splitting(scheme)
    return Resonances(system).first(scheme).step / scheme.forces


def test_the_first_resonance_of_a_peptide_is_that_of_angles_with_hydrogen():
    """In ps per force evaluation. Heavier hydrogens move it beyond 8 fs, up to the half period of bonds."""
    assert 0.006 < first("W2_3m") < 0.008
    assert 0.009 < first("W2_3m", 3.0) < 0.010
    assert 0.009 < first("BAOA") < 0.0107  # the last is w h = pi, without the slow forces
    assert Resonances(rb.rigid_water(2)[1]).first(splitting("W2_3m")) is None


def nested(interval, mass=None, constraints="HBonds"):
    """Return our integrator with W2_3m in a Context of the peptide in water, ready to move."""
    topology, system, x = in_water(constraints)
    if mass is not None:
        rb.heavy_hydrogens(system, topology, mass)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, forceInterval=interval, scheme="W2_3m")
    integrator.setRandomNumberSeed(1)
    context = context_of(system, integrator, x)
    integrator.setVelocitiesToTemperature(300.0, 3)
    return integrator, context


@pytest.mark.parametrize(
    ("interval", "mass", "constraints", "advice"),
    [
        (0.008, None, "HBonds", "evaluation, make hydrogens heavier"),
        (0.010, 3.0, "HBonds", "evaluation, or monitor the temperature"),  # of a bond between nitrogen and carbon
        (0.008, 3.0, "None", "evaluation, constrain bonds to hydrogen"),
    ],
)
def test_the_advice_is_one_that_helps(interval, mass, constraints, advice):
    integrator, _context = nested(interval, mass, constraints)
    with pytest.warns(rb.StepSizeWarning, match=advice):
        integrator.step(1)


def test_a_step_beyond_the_first_resonance_warns_once():
    integrator, _context = nested(0.008)
    with pytest.warns(
        rb.StepSizeWarning, match=r"with steps of 24 fs, .* W2_3m is near a resonance with the angle of .* Use at mo"
    ):
        integrator.step(1)
    integrator.setStepSize(0.02401)
    integrator.step(1)


def test_proposals_that_are_rejected_by_their_energy_need_no_warning():
    _, system, x = in_water()
    integrator = rb.ExactRigidBodyHybridIntegrator(300.0, 5.0, 0.016)
    _context = context_of(system, integrator, x)
    integrator.setVelocitiesToTemperature(300.0, 3)
    assert Resonances(system).first(splitting("S2_2")).step < 0.016
    integrator.step(1)


@pytest.mark.parametrize(("interval", "mass"), [(0.006, None), (0.008, 3.0)])
def test_steps_below_it_do_not(interval, mass):
    integrator, _context = nested(interval, mass)
    integrator.step(1)


def test_the_particles_of_the_warning_are_those_of_the_system():
    integrator, context = nested(0.008)
    with pytest.warns(rb.StepSizeWarning) as told:
        integrator.step(1)
    named = str(told[0].message).split("particles ")[1].split(", whose")[0]
    mass = [context.getSystem().getParticleMass(int(i))._value for i in named.split(", ")]
    assert sorted(mass)[:2] == pytest.approx([1.008, 1.008])  # H-C-H
    assert told[0].filename == __file__


# -- heat ---------------------------------------------------------------------------------------------------------


def water(scheme, interval, temperature=300.0, friction=5.0):
    """Return our integrator in a Context of 27 molecules in a box, whose velocities have a temperature."""
    options = {"nonbondedMethod": app.CutoffPeriodic, "nonbondedCutoff": 0.45, "switchDistance": 0.35}
    _, system, x = rb.rigid_water(27, **options)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, friction, forceInterval=interval, scheme=scheme)
    integrator.setRandomNumberSeed(1)
    context = context_of(system, integrator, x)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0, 50)
    integrator.setVelocitiesToTemperature(temperature, 3)
    return integrator, context


def advance(integrator, picoseconds):
    """In calls of 50 fs, 1/friction in these tests."""
    h = integrator.getStepSize()._value
    steps = max(1, round(0.05 / h))
    for _ in range(round(picoseconds / (steps * h))):
        integrator.step(steps)


def test_water_that_a_long_step_heats_warns_once():
    integrator, _context = water("S2_2", 0.009, friction=20.0)
    with pytest.warns(rb.StepSizeWarning, match=r"temperature of the .* of rigid bodies is \d+ % above"):
        advance(integrator, 7.0)
    advance(integrator, 7.0)


def test_a_hot_start_does_not():
    integrator, _context = water("W2_3m", 0.004, temperature=3000.0, friction=20.0)
    advance(integrator, 7.0)


def looked_at(temperature, samples=400):
    """Let states of a temperature be seen, drawn from the canonical momenta of ten molecules."""
    _, system, x = rb.rigid_water(10)
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    _context = context_of(system, integrator, x)
    bodies, _ = integrator.bodyState()
    watch = Overheating(freedom_by_kind(bodies), 300.0 * 0.00831446, 0.2)
    for k in range(samples):
        integrator.setVelocitiesToTemperature(temperature, 1 + k)
        _, state = integrator.bodyState()
        watch.see(0.2 * k, functools.partial(kinetic_by_kind, bodies, rb.mechanics.state.State.of(state)))


def test_canonical_momenta_of_few_molecules_do_not():
    for _ in range(3):
        looked_at(300.0)


def test_momenta_that_are_a_fifth_too_hot_do():
    with pytest.warns(rb.StepSizeWarning, match=r"is (1[5-9]|2[0-5]) % above"):
        looked_at(360.0)


def test_a_mean_begins_again_where_the_state_is_set():
    """Nothing is said of a time that is shorter than a mean."""
    integrator, context = water("S2_2", 0.009, friction=20.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(3):
            advance(integrator, 3.0)
            context.setPositions(context.getState(positions=True).getPositions(asNumpy=True)._value + 1e-3)
