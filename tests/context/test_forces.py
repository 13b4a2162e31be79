"""Forces are those of the places, the box and the parameters of the moment, and are evaluated once for each."""

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np
import openmm
import pytest
from openmm import app, unit
from scipy.integrate import solve_ivp

import openmm_exactrb as rb
import starts
from few_dipoles import simulation_of
from force_laws import evaluated, resting
from openmm_exactrb.context.forces import ContextForces, Positions
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.substeps import DRIFT, KICK, Substep
from orders import exponent


def water_with_a_barostat(scheme, pressure=1e3, n=64):
    """Return a Simulation of water in a box that a barostat may change after every step."""
    topology, system, positions = rb.rigid_water(
        n, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.5 * unit.nanometer
    )
    barostat = openmm.MonteCarloBarostat(pressure * unit.bar, 300.0 * unit.kelvin, 1)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    integrator = rb.ExactRigidBodyIntegrator(0.0005, scheme=scheme)
    simulation = starts.simulation_of(topology, system, integrator, positions)
    simulation.minimizeEnergy(tolerance=100.0, maxIterations=50)
    integrator.setVelocitiesToTemperature(300.0, 1)
    return simulation


@dataclass
class Watch:
    """What a substep saw: the box before every step, and how far forces are from those of a new Context."""

    context: openmm.Context = None
    boxes: list = field(default_factory=list)
    worst: float = 0.0


@dataclass(frozen=True)
class Look(Substep):
    """A substep that notes what it sees, and changes nothing."""

    watch: Watch = field(hash=False, compare=False)

    moves: ClassVar[bool] = False

    def bind(self, environment):
        watch, forces = self.watch, environment.forces()

        def flow(state, tau):
            watch.boxes.append(arrays.box(watch.context.getState()))
            for got, expected in zip(forces(state), anew(watch.context, environment.bodies, state), strict=True):
                watch.worst = max(watch.worst, np.abs(got - expected).max() / np.abs(expected).max())
            return state

        return flow


def anew(context, bodies, state):
    """Return forces and torques in a Context that knows nothing of what was in another one."""
    x = bodies.positions(state.rounded, np.zeros((bodies.n_particles, 3)))
    fresh = resting(context.getSystem(), x)
    fresh.setPeriodicBoxVectors(*context.getState().getPeriodicBoxVectors())
    return bodies.forces(state.rounded, evaluated(fresh)[1])


@pytest.mark.parametrize(("name", "n"), [("V2", 30), ("SRKN4_6b", 20)])
def test_an_accepted_move_of_a_barostat_costs_one_evaluation_and_no_step_uses_forces_of_the_old_box(name, n):
    scheme = rb.SCHEMES[name]
    watch = Watch()
    simulation = water_with_a_barostat(replace(scheme, sequence=((Look(watch), 0.0), *scheme.sequence)))
    watch.context = simulation.context
    simulation.integrator.checkDivergence = False  # which asks for energies
    simulation.integrator.step(n)
    boxes = [*watch.boxes, arrays.box(simulation.context.getState())]
    accepted = [box != before for before, box in pairwise(boxes)]
    assert len(accepted) == n
    assert 0 < sum(accepted) < n
    # One after the last step is for the next call, which evaluates the forces of its first positions in any case.
    trials = 2 * n  # energies
    assert simulation.integrator.timings.evaluations == trials + scheme.stages * n + 1 + sum(accepted[:-1])
    assert watch.worst < 1e-12


def forces_of(simulation, groups=1):
    """Return forces of a Context, their positions, the state of the bodies and what counts the evaluations."""
    bodies, state = simulation.integrator.fullState()
    x = arrays.positions(simulation.context.getState(positions=True))
    positions, timings = Positions(simulation.context, bodies, x), Timings()
    return ContextForces(positions, groups, timings), positions, state, timings


def test_forces_are_evaluated_once_for_each_version_of_the_positions():
    simulation = simulation_of(4)
    forces, positions, state, timings = forces_of(simulation)
    value = forces(state)
    assert forces(state._replace(P=2.0 * state.P, m=2.0 * state.m)) is value
    assert forces(State(*(a.copy() for a in state))) is value
    assert timings.evaluations == 1
    simulation.context.setParameter("soft_repulsion", 9.0)
    positions.moved()
    assert np.abs(forces(state)[0] - value[0]).max() > 1e-3
    simulation.context.setParameter("soft_repulsion", 4.0)
    positions.moved()
    np.testing.assert_array_equal(forces(state)[0], value[0])
    moved = state._replace(R=state.R + 0.01)
    positions.version += 1
    assert np.abs(forces(moved)[0] - value[0]).max() > 1e-4
    assert timings.evaluations == 4


def test_forces_elsewhere_leave_those_here_known_and_groups_add_up():
    simulation = simulation_of(4)
    for group, force in enumerate(simulation.system.getForces()):
        force.setForceGroup(group)
    simulation.context.reinitialize(preserveState=True)
    forces, _, state, timings = forces_of(simulation, 0b11)
    here, there = forces(state), State(state.R + 0.1, *state[1:])
    assert np.abs(forces.at(there)[0] - here[0]).max() > 1e-3
    assert forces(state) is here
    assert timings.evaluations == 2
    parts = [forces.of(1 << group)(state)[0] for group in range(2)]  # the Context is brought back to here for them
    assert min(np.abs(part).max() for part in parts) > 1e-3
    np.testing.assert_allclose(sum(parts), here[0], rtol=0.0, atol=1e-12 * np.abs(here[0]).max())
    assert not forces.of(0b100)(state)[0].any()


@dataclass(frozen=True)
class Copies(Substep):
    """A substep that changes no number, and says nothing else of it or that it moves the bodies."""

    says: bool

    def bind(self, environment):
        return lambda state, tau: State(*(a.copy() for a in state))

    @property
    def moves(self):
        return self.says


@pytest.mark.parametrize("moves", [False, True])
def test_forces_are_evaluated_again_behind_a_substep_that_says_it_moves_and_behind_no_other(moves):
    """What counts is what a substep says: new arrays with the same numbers cost nothing."""
    n, h = 5, 0.02
    sequence = ((KICK, 0.5), (Copies(moves), 1.0), (DRIFT, 1.0), (Copies(moves), 1.0), (KICK, 0.5))
    with_copies = simulation_of(4, h, Scheme("copies", 2, sequence))
    plain = simulation_of(4, h, "V2", engine="host")
    between = Scheme("between", 2, ((KICK, 0.25), (Copies(moves), 1.0), (KICK, 0.25), (DRIFT, 1.0), (KICK, 0.5)))
    kicked_twice = simulation_of(4, h, between)
    for simulation in (with_copies, plain, kicked_twice):
        simulation.integrator.checkDivergence = False  # which asks for energies
        simulation.integrator.step(n)
    for a, b in zip(with_copies.integrator.fullState()[1], plain.integrator.fullState()[1], strict=True):
        np.testing.assert_array_equal(a, b)
    assert with_copies.integrator.timings.evaluations == plain.integrator.timings.evaluations == n + 1
    assert kicked_twice.integrator.timings.evaluations == n + 1 + (n if moves else 0)


@dataclass(frozen=True)
class Shift(Substep):
    """A substep that moves all bodies, as one of another package might."""

    by: float

    def bind(self, environment):
        def flow(state, tau):
            R = state.R.copy()
            R[0] += self.by
            return state._replace(R=R)

        return flow


def test_a_substep_that_moves_bodies_is_followed_by_kicks_of_the_forces_there():
    """To and fro between two kicks: the kicks are those of a droplet that began elsewhere, in a trap that stands."""
    to_and_fro = ((Shift(0.2), 1.0), (KICK, 1.0), (Shift(-0.2), 1.0))
    simulation = simulation_of(4, 0.02, Scheme("shifted", 1, ((KICK, 0.5), *to_and_fro, (KICK, 0.5))))
    forces, positions, state, _ = forces_of(simulation)
    elsewhere = State(state.R + np.array([0.2, 0.0])[:, None, None], *state[1:])
    expected = state.P[0] + 0.02 * (forces(state)[0] + forces.at(elsewhere)[0])
    positions.write(state)
    simulation.integrator.checkDivergence = False  # which asks for energies
    simulation.integrator.step(1)
    np.testing.assert_allclose(simulation.integrator.bodyState()[1].P, expected, rtol=0.0, atol=1e-13)
    assert np.abs(forces.at(elsewhere)[0] - forces(state)[0]).max() > 1e-3
    assert simulation.integrator.timings.evaluations == 3


def strength_at(t):
    return 300.0 * (1.0 + 0.5 * np.cos(40.0 * t))


def end_under_a_force_of_time(scheme, n, **inner):
    """Return where a particle is after n steps in 0.2 ps, whose force is a function of place and time.

    Beside it, in a group of its own, is a constant force of a trap.
    """

    def force(state):
        x, strength = state.getPositions(asNumpy=True)._value, strength_at(state.getTime()._value)
        return 0.5 * strength * float((x**2).sum()), -strength * x

    system = openmm.System()
    system.addParticle(1.0)
    of_time, trap = openmm.PythonForce(force), openmm.CustomExternalForce("100*(x^2+y^2+z^2)")
    of_time.setForceGroup(1)
    trap.addParticle(0)
    system.addForce(of_time)
    system.addForce(trap)
    integrator = rb.ExactRigidBodyIntegrator(0.2 / n, scheme=scheme, **inner)
    context = starts.context_of(system, integrator, [[0.1, 0.2, -0.1]])
    integrator.step(n)
    state = context.getState(positions=True)
    assert context.getStepCount() == n
    assert state.getTime()._value == pytest.approx(0.2, rel=1e-12)
    return state.getPositions(asNumpy=True)._value[0]


NESTED = {"fast": (1,), "inner": "S6_10", "innerSteps": 4}


@pytest.mark.parametrize(
    ("scheme", "order", "inner"),
    [
        ("V2", 2, {}),
        ("V2_drift", 2, {}),
        ("S6_10", 6, {}),
        pytest.param("V2_drift", 2, NESTED, marks=pytest.mark.validate),
        ("SRKN4_6b", 4, NESTED),
    ],
)
def test_forces_that_depend_on_time_keep_the_order(scheme, order, inner):
    """Within a call of `step` too time goes on, with the drifts."""
    start = [0.1, 0.2, -0.1, 0.0, 0.0, 0.0]
    equations = lambda t, y: [*y[3:], *(-(strength_at(t) + 200.0) * y[:3])]  # noqa: E731
    exact = solve_ivp(equations, (0.0, 0.2), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:3, -1]
    steps = {2: (64, 90, 128), 4: (24, 34, 48), 6: (12, 15, 18)}[order]
    errors = [np.abs(end_under_a_force_of_time(scheme, n, **inner) - exact).max() for n in steps]
    assert exponent(steps, errors) == pytest.approx(-order, abs=0.3), errors


def test_the_reference_platform_loses_no_pair_of_a_particle_at_minus_zero():
    """Its neighbour list does, of particles at -1e-17 nm, where rounding puts those of a lattice."""
    system, force = openmm.System(), openmm.NonbondedForce()
    for _ in range(2):
        system.addParticle(20.0)
        force.addParticle(0.0, 0.3, 0.5)
    force.setNonbondedMethod(force.CutoffPeriodic)
    force.setCutoffDistance(0.9)
    system.addForce(force)
    system.setDefaultPeriodicBoxVectors(*(2.0 * np.eye(3)))
    integrator, energies = rb.ExactRigidBodyIntegrator(0.001), []
    context = starts.context_of(system, integrator, [[0.3, 0.3, 0.0], [0.3, 0.3, 0.4]])
    _, state = integrator.bodyState()
    for z in (0.1, -1e-17):
        state.R[2] = z, z + 0.4
        integrator.setBodyState(state)
        energies.append(context.getState(energy=True).getPotentialEnergy()._value)
    assert energies[1] == pytest.approx(energies[0], rel=1e-12)
