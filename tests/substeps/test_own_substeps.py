"""Rotors, schemes and substeps of a user's own, handed over without an entry anywhere."""

import copy
import pickle
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
import starts
import three_masses
from few_dipoles import KT, simulation_of, snapshot
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.rotors.flow import ascending
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.sequence import repeated, spelled
from openmm_exactrb.steps.substeps import DRIFT, KICK, Drift, GradientKick, Kick, Substep
from orders import slope
from places import REFERENCE

pytestmark = pytest.mark.usefixtures("host_is_advised")

V2 = rb.SCHEMES["V2"]


def end(scheme, n=6, h=0.02, rotor="exact", prepared=None, **options):
    """Return a Simulation that a scheme has moved by n steps."""
    simulation = simulation_of(4, h, scheme, rotor, **options)
    simulation.integrator.checkDivergence = False  # which asks for energies
    if prepared:
        prepared(simulation)
    simulation.integrator.step(n)
    return simulation


def state_of(simulation):
    return simulation.integrator.bodyState()[1]


def assert_same(one, other):
    for a, b in zip(one.integrator.fullState()[1], other.integrator.fullState()[1], strict=True):
        np.testing.assert_array_equal(a, b)


# -- rotors and schemes -----------------------------------------------------------------------------------------------


def test_a_rotor_needs_no_entry():
    mine = replace(rb.ROTORS["quaternion_a"], name="mine")
    assert "mine" not in rb.ROTORS
    simulation = end("SRKN4_6b", rotor=mine)
    assert simulation.integrator.getRotor() == "mine"
    assert_same(simulation, end("SRKN4_6b", rotor="quaternion_a"))


def turning_about_fixed_axes(inertia):
    """Return a flow that is right for spheres only; its name is its own."""
    assert (ascending(inertia)[2] != 0.0).all()

    def flow(q, m, t):
        half = 0.5 * t * np.sqrt((m * m).sum(axis=0)) / inertia[0]
        turn = np.concatenate([np.cos(half)[None], 0.5 * t / inertia[0] * np.sinc(half / np.pi) * m])
        return rb.mathematics.quaternions.multiply(q, turn), m.copy()

    return flow


def test_a_rotor_of_ones_own_moves_spheres_as_the_exact_one():
    mine = Rotor("sphere", None, turning_about_fixed_axes, "a test")
    sphere = {"inertia": (1.88, 1.88, 1.88)}
    ours, theirs = (state_of(end("SRKN4_6b", rotor=rotor, **sphere)) for rotor in (mine, "exact"))
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-13)
    q, _ = rb.free_rotor([2.0, 2.0, 2.0], [1, 0, 0, 0], [0.3, 0.2, 0.1], 5.0, method=mine)
    np.testing.assert_allclose(q, rb.free_rotor([2.0] * 3, [1, 0, 0, 0], [0.3, 0.2, 0.1], 5.0)[0], atol=1e-15)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_copies_keep_a_rotor_and_a_scheme_of_ones_own(duplicate):
    mine = Rotor("sphere", None, turning_about_fixed_axes, "a test")
    integrator = duplicate(rb.ExactRigidBodyIntegrator(0.01, replace(V2, name="mine"), mine))
    assert (integrator.getScheme().name, integrator.getRotor()) == ("mine", "sphere")


def test_a_scheme_needs_no_entry():
    mine = Scheme("mine", 2, ((KICK, 0.5), (DRIFT, 1.0), (KICK, 0.5)))
    assert_same(end(mine), end("V2"))


# -- force gradients --------------------------------------------------------------------------------------------------


def chin_4a(strength):
    """Return scheme 4A of S. A. Chin (1997), doi:10.1016/S0375-9601(97)00003-0, kick first."""
    middle = GradientKick(strength)
    return Scheme("Chin4A", 4, ((KICK, 1.0 / 6.0), (DRIFT, 0.5), (middle, 2.0 / 3.0), (DRIFT, 0.5), (KICK, 1.0 / 6.0)))


STRENGTH = (1.0 / 24.0) / (2.0 / 3.0) ** 2


@pytest.mark.parametrize(("strength", "order"), [(STRENGTH, 4.0), (0.0, 2.0), (0.5 * STRENGTH, 2.0)])
def test_force_gradients_of_a_kick_first_scheme_give_it_its_order(strength, order):
    """By forces at displaced places, which is all that OpenMM has."""

    def positions(n):
        return state_of(end(chin_4a(strength), n, 1.0 / n, spacing=1.4)).R

    assert abs(slope(positions, (40, 52, 68)) - order) < 0.35


def test_a_force_gradient_kick_costs_one_evaluation_more():
    integrator = end(chin_4a(STRENGTH), 5).integrator
    assert integrator.forceEvaluationsPerStep == 3
    assert integrator.timings.evaluations == 5 * 3 + 1


def test_a_processed_scheme_with_force_gradients_has_order_four():
    def positions(n):
        return state_of(end("V2_gradient_C17", n, 1.0 / n, spacing=1.4)).R

    assert abs(slope(positions, (60, 78, 102)) - 4.0) < 0.35


# -- groups and nested sequences --------------------------------------------------------------------------------------


def in_two_groups(simulation):
    for group, force in enumerate(simulation.system.getForces()):
        force.setForceGroup(min(group, 1))
    simulation.context.reinitialize(preserveState=True)


def test_kicks_of_two_groups_are_the_kick_of_both():
    """In any order, and with one of them in two halves: kicks at one place commute."""
    one, other = Kick(1), Kick(0)
    sequence = ((one, 0.5), (other, 0.5), (DRIFT, 1.0), (other, 0.25), (one, 0.5), (other, 0.25))
    split = end(Scheme("groups", 2, sequence), prepared=in_two_groups)
    for a, b in zip(state_of(split), state_of(end("V2")), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-13)
    assert split.integrator.timings.evaluations == 2 * (6 + 1)


def test_a_kick_of_one_group_is_one_of_a_system_with_its_forces_alone():
    def alone(simulation):
        simulation.integrator.setIntegrationForceGroups({1})
        in_two_groups(simulation)

    one = end(Scheme("one", 2, spelled("B1 A B1")), prepared=in_two_groups)
    assert_same(one, end("V2", prepared=alone))
    assert np.abs(state_of(one).P - state_of(end("V2")).P).max() > 1e-3


def test_nested_steps_in_openmm_have_order_two_and_few_evaluations_of_the_slow_forces():
    inner = tuple((substep, part / 4.0) for substep, part in repeated(spelled("B0 A B0"), 4))
    respa = Scheme("respa", 2, ((Kick(1), 0.5), *inner, (Kick(1), 0.5)))

    def positions(n):
        return state_of(end(respa, n, 1.0 / n, prepared=in_two_groups, spacing=1.4)).R

    assert abs(slope(positions, (40, 52, 68)) - 2.0) < 0.35
    integrator = end(respa, 5, prepared=in_two_groups).integrator
    assert integrator.timings.evaluations == (5 + 1) + (4 * 5 + 1)


# -- substeps ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Friction(Substep):
    """All momenta decay as exp(-rate t)."""

    rate: float

    symbol: ClassVar[str] = "F"
    moves: ClassVar[bool] = False
    additive: ClassVar[bool] = True

    def bind(self, environment):
        def flow(state, tau):
            fade = np.exp(-self.rate * tau)
            return state._replace(P=fade * state.P, m=fade * state.m)

        return flow


def with_friction(rate, text="B A B"):
    """Return a scheme of the substeps of a text between two halves of a friction."""
    half = ((Friction(rate), 0.5),)
    return Scheme("friction", 2, (*half, *spelled(text), *half))


def test_a_substep_of_ones_own_acts_as_it_says():
    """Free bodies under linear friction: momenta decay exactly, and the angular momentum does so in space."""
    rate, h, n = 0.7, 0.05, 20
    integrator = rb.ExactRigidBodyIntegrator(h, with_friction(rate, "A"))
    _simulation = starts.simulation_of(
        app.Topology(), three_masses.system(), integrator, three_masses.POSITIONS, kelvin=100.0
    )

    def momenta():
        _, state = integrator.bodyState()
        return state.P, np.einsum("ijn,jn->in", rb.mathematics.quaternions.matrix(state.q), state.m)

    start = momenta()
    integrator.step(n)
    for now, then in zip(momenta(), start, strict=True):
        np.testing.assert_allclose(now, np.exp(-rate * n * h) * then, rtol=0.0, atol=1e-14 * np.abs(then).max())


def test_a_substep_that_does_not_say_what_it_does_is_named():
    @dataclass(frozen=True)
    class Silent(Substep):
        pass

    simulation = simulation_of(2, scheme=Scheme("mine", 2, ((Silent(), 0.5), *spelled("B A B"), (Silent(), 0.5))))
    with pytest.raises(NotImplementedError, match=r"Silent must define bind\(\)"):
        simulation.step(1)
    assert simulation.context.getStepCount() == 0


@dataclass(frozen=True)
class FrozenDrift(Substep):
    """A drift of everything but the rotation, made of the one of the package."""

    symbol: ClassVar[str] = "A"

    def bind(self, environment):
        drift = Drift().bind(environment)
        return lambda state, tau: drift(state, tau)._replace(q=state.q, m=state.m)


def test_a_substep_may_be_made_of_one_of_the_package_and_take_its_place():
    frozen = Scheme("frozen", 2, ((KICK, 0.5), (FrozenDrift(), 1.0), (KICK, 0.5)))
    simulation = simulation_of(4, scheme=frozen)
    R, _, q, _ = simulation.integrator.bodyState()[1]
    simulation.integrator.step(5)
    np.testing.assert_array_equal(simulation.integrator.bodyState()[1].q, q)
    assert np.abs(simulation.integrator.bodyState()[1].R - R).max() > 1e-3


@dataclass(frozen=True)
class MyKick(Substep):
    """A kick by the forces of a group, made of what the environment has."""

    group: int

    moves: ClassVar[bool] = False
    kicks: ClassVar[bool] = True

    def bind(self, environment):
        forces = environment.forces(self.group)

        def flow(state, tau):
            force, torque = forces(state)
            P, m = state.P.copy(), state.m.copy()
            P[0], m[0] = P[0] + tau * force, m[0] + tau * torque
            return state._replace(P=P, m=m)

        return flow


def test_the_environment_has_the_forces_of_groups():
    """A kick of a group of one's own does what that of the package does, and costs as many evaluations."""
    mine = Scheme("mine", 2, ((MyKick(1), 0.5), (DRIFT, 1.0), (MyKick(1), 0.5)))
    ours, theirs = (end(s, prepared=in_two_groups) for s in (mine, Scheme("one", 2, spelled("B1 A B1"))))
    for a, b in zip(state_of(ours), state_of(theirs), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-13)
    assert [s.integrator.timings.evaluations for s in (ours, theirs)] == [7, 7]


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
def test_copies_keep_substeps_of_ones_own(duplicate):
    simulation = simulation_of(4, scheme=with_friction(0.3))
    twin = duplicate(simulation.integrator)
    assert twin.getScheme() == with_friction(0.3) != with_friction(0.4)
    other = app.Simulation(simulation.topology, simulation.system, twin, REFERENCE)
    x, _ = snapshot(simulation)
    other.context.setPositions(x)
    other.context.setVelocitiesToTemperature(KT, 2)
    for run in (simulation, other):
        run.integrator.step(3)
    np.testing.assert_allclose(snapshot(other)[0], snapshot(simulation)[0], rtol=0.0, atol=1e-13)


def test_what_openmm_does_between_steps_stands_beside_a_substep_of_ones_own():
    """CMMotionRemover, after friction: the centre of mass rests at the end of each step."""
    _, system, positions = rb.dipole_fluid(8, trap=0.5)
    system.addForce(openmm.CMMotionRemover(1))
    integrator = rb.ExactRigidBodyIntegrator(0.01, with_friction(0.3))
    _context = starts.context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(20.0, 1)
    integrator.step(3)
    np.testing.assert_allclose(integrator.bodyState()[1].P.sum(axis=1), 0.0, atol=1e-12)
