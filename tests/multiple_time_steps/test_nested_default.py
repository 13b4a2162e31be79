"""Multiple time steps by default: where a step nests bonded forces, how often, and what they follow."""

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.substeps import DRIFT, Kick, Substep
from peptides import bonded_apart, end_of, moving, peptide, positions_of
from places import platform_for
from starts import context_of, force_of, system_of


@dataclass(frozen=True)
class Rest(Substep):
    """A substep of one's own, which does nothing and has a symbol that looks like that of a kick."""

    symbol: ClassVar[str] = "Bx"

    def bind(self, environment):
        return lambda state, tau: state


# -- the default ------------------------------------------------------------------------------------------------


def nests(system, x, h, scheme="S2_2", **options):
    """Tell whether steps have steps of their own within their drifts."""
    integrator, _context = moving(system, x, h, scheme, **options)
    integrator.step(2)
    return integrator.timings.fast_evaluations > 0


@pytest.mark.parametrize(("constraints", "often"), [("HBonds", 0.0012), ("None", 0.0006)])
def test_bonded_forces_are_nested_where_a_force_comes_more_rarely_than_they_swing(constraints, often):
    """From some 1.2 fs a force with bonds to hydrogen held, from 0.6 fs without: so at 2 fs in any case."""
    _, system, x = peptide(constraints)
    for scheme in ("V2", "S2_2", "W2_1"):
        stages = rb.SCHEMES[scheme].stages
        assert nests(system, x, 1.1 * often * stages, scheme)
        assert nests(system, x, 0.002 * stages, scheme)
        assert not nests(system, x, 0.9 * often * stages, scheme)
    assert not nests(system, x, 0.004, fast=None)
    assert nests(system, x, 0.0005, innerSteps=2)  # what is asked for is there


def test_the_same_integrator_follows_its_step():
    _, system, x = peptide()
    integrator, _context = moving(system, x, 0.004)
    integrator.step(2)
    seen = integrator.timings.fast_evaluations
    integrator.setStepSize(0.001)
    integrator.step(2)
    assert integrator.timings.fast_evaluations == seen > 0


def test_nothing_is_nested_where_it_would_bring_nothing_or_not_be_all():
    """Rigid bodies, forces that are all bonded or of unknown speed, kicks by group, and substeps of your own."""
    _, water, positions = rb.rigid_water(2, nonbondedMethod=app.NoCutoff)
    bond = openmm.HarmonicBondForce()
    bond.addBond(0, 1, 0.09, 4e5)  # within a rigid molecule
    water.addForce(bond)
    assert not nests(water, positions, 0.008)

    _, system, x = peptide()
    alone = openmm.XmlSerializer.clone(system)
    for i in reversed(range(alone.getNumForces())):
        if isinstance(alone.getForce(i), openmm.NonbondedForce):
            alone.removeForce(i)
    assert not nests(alone, x, 0.004)

    unknown = openmm.XmlSerializer.clone(system)
    for i in reversed(range(unknown.getNumForces())):
        if isinstance(unknown.getForce(i), (openmm.HarmonicBondForce, openmm.HarmonicAngleForce)):
            unknown.removeForce(i)
    assert not nests(unknown, x, 0.004)

    grouped = Scheme("grouped", 2, ((Kick(0), 0.5), (DRIFT, 1.0), (Kick(0), 0.5)))
    assert not nests(system, x, 0.002, grouped)
    with pytest.raises(ValueError, match=r"has kicks with single force groups .*\(0\)"):
        nests(system, x, 0.002, grouped, fast="bonded")

    assert not nests(system, x, 0.004, Scheme("own", 2, ((Rest(), 0.5), (DRIFT, 1.0), (Rest(), 0.5))))
    beside = Scheme("beside", 2, ((Rest(), 1.0), *rb.SCHEMES["S2_2"].sequence))
    assert not nests(system, x, 0.004, beside)
    assert nests(system, x, 0.004, "S2_2")


def test_forces_that_do_not_act_are_not_nested():
    """The forces between atoms act alone: the motion is theirs, whether others would be nested or not."""
    _, system, x = peptide()
    group = bonded_apart(system)
    ends = []
    for fast in (None, "bonded"):
        integrator, context = moving(system, x, 0.001, "SRKN4_6b", fast=fast)
        integrator.setIntegrationForceGroups({0})
        integrator.step(20)
        ends.append(positions_of(context))
    assert group == 1
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-12)


def test_nested_forces_follow_parameters_and_the_box():
    """As the same forces in a group of their own do, which the Context of the System evaluates.

    The bond has its length from the Context, and reaches across a box that is less than twice as long.
    """
    _, system, x = peptide()
    force = openmm.CustomBondForce("3e3*(r - length)^2")
    force.addGlobalParameter("length", 0.4)
    force.addBond(1, 18)
    force.setUsesPeriodicBoundaryConditions(True)
    system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*(0.6 * np.eye(3)))
    group = bonded_apart(system)
    ends = {}
    for change, fast in itertools.product(("nothing", "length", "box"), ("bonded", (group,))):
        integrator, context = moving(system, x, 0.002, fast=fast, inner="S2_2", innerSteps=4)
        integrator.step(10)
        if change == "length":
            context.setParameter("length", 0.45)
        if change == "box":
            context.setPeriodicBoxVectors(*(0.59 * np.eye(3)))
        integrator.step(10)
        ends[change, fast] = positions_of(context)
    for change in ("nothing", "length", "box"):
        np.testing.assert_allclose(ends[change, "bonded"], ends[change, (group,)], rtol=0.0, atol=1e-10)
    for change in ("length", "box"):
        assert np.abs(ends[change, "bonded"] - ends["nothing", "bonded"]).max() > 1e-4


def test_what_changes_unseen_is_kicked_by_the_outer_steps():
    """A bond that `updateParametersInContext` changes: the sum of all forces acts, whatever part of it is nested."""
    _, system, x = peptide()
    bonds = force_of(system, openmm.HarmonicBondForce)
    ends = []
    for fast in (None, "bonded"):
        own = openmm.XmlSerializer.clone(system)
        integrator, context = moving(own, x, 0.0002, "SRKN4_6b", fast=fast)
        integrator.step(5)
        force = force_of(own, openmm.HarmonicBondForce)
        i, j, length, k = force.getBondParameters(0)
        force.setBondParameters(0, i, j, 1.05 * length, k)
        force.updateParametersInContext(context)
        integrator.step(100)
        ends.append(positions_of(context))
    assert bonds.getNumBonds() > 0
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-8)


def test_bonds_of_virtual_sites_stay_outside():
    """A site on two flexible atoms, with a bond of its own: the nested run conserves the energy of all forces."""
    _, system, x = peptide("None")
    site = system.addParticle(0.0)
    system.setVirtualSite(site, openmm.TwoParticleAverageSite(4, 5, 0.5, 0.5))
    nonbonded = force_of(system)
    nonbonded.addParticle(0.0, 1.0, 0.0)
    force = openmm.HarmonicBondForce()
    force.addBond(site, 10, 0.4, 500.0)
    system.addForce(force)
    x = np.vstack([x, 0.5 * (x[4] + x[5])])
    ends = [end_of(system, x, "SRKN4_6b", 0.004, fast=fast)(16) for fast in (None, "bonded")]
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=2e-9)


def test_bonds_between_rigid_and_frozen_particles_are_nested_with_their_bodies():
    """A rigid molecule of water on a spring to a particle without mass, beside another one."""
    _, system, positions = rb.rigid_water(2, nonbondedMethod=app.NoCutoff)
    x = np.array(positions.value_in_unit(unit.nanometer))
    anchor = system.addParticle(0.0)
    nonbonded = force_of(system)
    nonbonded.addParticle(0.0, 1.0, 0.0)
    force = openmm.HarmonicBondForce()
    force.addBond(1, anchor, 0.1, 5e4)
    system.addForce(force)
    x = np.vstack([x, x[1] + [0.0, 0.11, 0.0]])
    ends = []
    for fast in (None, "bonded"):
        integrator, context = moving(system, x, 0.0005, "SRKN4_6b", fast=fast)
        integrator.step(40)
        ends.append(positions_of(context))
    assert integrator.timings.fast_evaluations > 40
    assert np.abs(ends[0] - x).max() > 1e-3
    np.testing.assert_allclose(ends[1], ends[0], rtol=0.0, atol=1e-9)


@pytest.mark.opencl
def test_the_native_engine_has_inner_steps_exactly_where_the_host_has_them():
    platform, properties = platform_for("native")
    _, system, x = peptide("None")
    for h, fast, nested in ((0.004, "auto", True), (0.0005, "auto", False), (0.004, None, False)):
        integrator = rb.ExactRigidBodyIntegrator(h, "S2_2", fast=fast, engine="native")
        _context = context_of(system, integrator, x, platform=platform, properties=properties)
        integrator.step(1)
        assert (integrator.timings.fast_evaluations > 0) == nested


@pytest.mark.parametrize("scheme", ["V2", "S2_2", "W2_3"])
def test_thermostats_nest_at_the_steps_at_which_constant_energy_does(scheme):
    """From 1.2 fs a force: the substeps of a thermostat are no kicks."""
    _, system, x = peptide()
    stages = rb.SCHEMES[scheme].stages
    for often, nested in ((0.0013, True), (0.0011, False)):
        h = often * stages
        integrators = [
            rb.ExactRigidBodyIntegrator(h, scheme),
            rb.ExactRigidBodyLangevinIntegrator(300.0, 0.0, h, scheme),
            rb.ExactRigidBodyRescalingIntegrator(300.0, 1e300, h, scheme),
            rb.ExactRigidBodyHybridIntegrator(300.0, 0.0, h, scheme),
            rb.ExactRigidBodyHybridIntegrator(300.0, 0.0, 3 * h, scheme, stepsPerProposal=3),
        ]
        for integrator in integrators:
            _context = context_of(system, integrator, x)
            integrator.setVelocitiesToTemperature(300.0, 3)
            integrator.step(1)
            assert (integrator.timings.fast_evaluations > 0) == nested, integrator


def bond_of(period, scheme, often):
    """Return q² of a bond over that of the exact distribution, and kicks of it in a period, with forces every `often`.

    The momentum and the length of a free bond stay on an ellipse; from canonical momenta it follows what q² is.
    """
    system = system_of(3 * [12.0])
    stiffness = 6.0 * (2.0 * np.pi / period) ** 2
    bond, outer = openmm.HarmonicBondForce(), openmm.CustomExternalForce("0*x")
    bond.addBond(0, 1, 0.15, stiffness)
    outer.addParticle(2)
    for force in (bond, outer):
        system.addForce(force)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 0.0, scheme=scheme, forceInterval=often)
    context = context_of(system, integrator, [[0.0, 0.0, 0.0], [0.16, 0.0, 0.0], [1.0, 1.0, 1.0]])
    trajectory, steps = [], 200
    for _ in range(steps):
        integrator.step(1)
        state = context.getState(positions=True, velocities=True)
        x, v = (a._value for a in (state.getPositions(asNumpy=True), state.getVelocities(asNumpy=True)))
        trajectory.append((x[1, 0] - x[0, 0] - 0.15, v[1, 0] - v[0, 0]))
    q, v = np.array(trajectory).T
    (ratio, _), residual, *_ = np.linalg.lstsq(np.array([-(q**2), np.ones(steps)]).T, v**2)
    assert residual < 1e-12
    return stiffness / 6.0 / ratio, integrator.timings.fast_evaluations / state.getTime()._value * period


@pytest.mark.parametrize(
    ("scheme", "kicks", "error", "periods"),
    [
        ("BAOAB", 8.4, 0.018, (0.0169, 0.0218)),
        ("BAOA", 8.4, 0.018, (0.0169, 0.0218)),
        # 7.5 kicks in the longer drifts. The period of 16 fs is in resonance with a step of 24 fs.
        ("W2_3m", 11.3, 0.002, (0.0170, 0.0213)),
        ("S2_3", 16.0, 0.002, (0.0155, 0.0251)),
    ],
)
def test_schemes_with_a_heat_exchange_take_fewer_inner_steps_and_keep_the_length_of_bonds(
    scheme, kicks, error, periods
):
    found = [bond_of(period, scheme, 0.008) for period in np.linspace(*periods, 5)]
    assert kicks <= min(often for _, often in found) < 1.3 * kicks
    assert all(q2 == pytest.approx(1.0, abs=error) for q2, _ in found)


@pytest.mark.filterwarnings("ignore::openmm_exactrb.StepSizeWarning")  # before it ends
@pytest.mark.parametrize(("h", "scheme"), [(4.0, "S2_2"), (1.0, "W2_1")])
def test_femtoseconds_without_their_unit_end_at_once(h, scheme):
    """Thousands of inner steps would be made before an outer kick looks at what they did."""
    _, system, x = peptide()
    integrator, context = moving(system, x, h, scheme)
    with pytest.raises(rb.IntegrationError, match=r"numbers without a unit are in ps"):
        integrator.step(10)
    assert integrator.timings.fast_evaluations < 3000
    assert np.abs(positions_of(context) - x).max() < 1e-6


@pytest.mark.filterwarnings("ignore::openmm_exactrb.StepSizeWarning")  # before it ends
def test_a_proposal_that_is_far_too_long_is_refused_at_once():
    _, system, x = peptide()
    integrator = rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, 4.8, "S2_2")
    _context = context_of(system, integrator, x)
    integrator.setVelocitiesToTemperature(300.0, 1)
    integrator.step(2)
    assert integrator.acceptanceRate() == 0.0
    assert integrator.timings.fast_evaluations < 3000


def test_a_scheme_without_kicks_runs():
    """Free motion alone, of which nothing can be nested."""
    _, system, x = peptide()
    assert not nests(system, x, 0.01, Scheme("free", 2, ((DRIFT, 1.0),)))
