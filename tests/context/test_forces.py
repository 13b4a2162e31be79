"""Forces are those of the places, the box and the parameters of the moment, and are evaluated once for each."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import openmm
import pytest
from openmm import app, unit
from scipy.integrate import solve_ivp

import openmm_exactrb as rb
from few_dipoles import REFERENCE, simulation_of
from force_laws import context_of, evaluated
from openmm_exactrb.context import arrays
from openmm_exactrb.context.forces import Forces, Places
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.motion.state import State


def water_with_a_barostat(scheme, pressure=1e3, n=64):
    """Return a Simulation of water in a box that a barostat may change after every step."""
    topology, system, positions = rb.rigid_water(
        n, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.5 * unit.nanometer
    )
    barostat = openmm.MonteCarloBarostat(pressure * unit.bar, 300.0 * unit.kelvin, 1)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    integrator = rb.ExactRigidBodyIntegrator(0.0005, scheme=scheme)
    simulation = app.Simulation(topology, system, integrator, REFERENCE)
    simulation.context.setPositions(positions)
    simulation.minimizeEnergy(tolerance=100.0, maxIterations=50)
    integrator.setVelocitiesToTemperature(300.0, 1)
    return simulation


class Watch:
    """A letter that notes the box before every step, and how far forces are from those of a new Context."""

    def __init__(self, context):
        self.context, self.boxes, self.worst = context, [], 0.0

    def __call__(self, parts, letters):
        return dict.fromkeys(letters, lambda state, tau: self.look(parts, state))

    def look(self, parts, state):
        self.boxes.append(arrays.box(self.context.getState()))
        for got, expected in zip(parts.forces(state), anew(self.context, parts.bodies, state), strict=True):
            self.worst = max(self.worst, np.abs(got - expected).max() / np.abs(expected).max())
        return state


def anew(context, bodies, state):
    """Return forces and torques in a Context that knows nothing of what was in another one."""
    x = bodies.positions(state.rounded, np.zeros((bodies.n_particles, 3)))
    fresh = context_of(context.getSystem(), x)
    fresh.setPeriodicBoxVectors(*context.getState().getPeriodicBoxVectors())
    return bodies.forces(state.rounded, evaluated(fresh)[1])


@pytest.mark.parametrize(("name", "n"), [("V2", 30), ("SRKN4_6b", 20)])
def test_an_accepted_move_of_a_barostat_costs_one_evaluation_and_no_step_uses_forces_of_the_old_box(name, n):
    scheme = rb.SCHEMES[name]
    simulation = water_with_a_barostat(replace(scheme, word=(("W", 0.0), *scheme.word)))
    watch = Watch(simulation.context)
    simulation.integrator.addLetter("W", watch)
    simulation.integrator.step(n)
    boxes = [*watch.boxes, arrays.box(simulation.context.getState())]
    accepted = [box != before for before, box in pairwise(boxes)]
    assert len(accepted) == n
    assert 0 < sum(accepted) < n
    # One after the last step is for the next call, which evaluates the forces of its first positions in any case.
    assert simulation.integrator.timings.evaluations == scheme.stages * n + 1 + sum(accepted[:-1])
    assert watch.worst < 1e-12


def test_forces_are_kept_while_places_box_and_parameters_are_the_same():
    simulation = simulation_of(4)
    integrator, context = simulation.integrator, simulation.context
    bodies, state = integrator.fullState()
    timings = Timings()
    forces = Forces(Places(context, bodies, arrays.positions(context.getState(positions=True))), 1, timings)
    value = forces(state)
    assert forces(state._replace(P=2.0 * state.P, m=2.0 * state.m)) is value
    assert timings.evaluations == 1
    context.setParameter("soft_repulsion", 9.0)
    assert np.abs(forces(state)[0] - value[0]).max() > 1e-3
    context.setParameter("soft_repulsion", 4.0)
    np.testing.assert_array_equal(forces(state)[0], value[0])
    moved = state._replace(R=state.R + 0.01)
    assert np.abs(forces(moved)[0] - value[0]).max() > 1e-4
    assert timings.evaluations == 4


def test_twins_of_forces_forget_nothing_of_each_other_and_groups_add_up():
    simulation = simulation_of(4)
    for group, force in enumerate(simulation.system.getForces()):
        force.setForceGroup(group)
    simulation.context.reinitialize(preserveState=True)
    bodies, state = simulation.integrator.fullState()
    timings = Timings()
    x = arrays.positions(simulation.context.getState(positions=True))
    forces = Forces(Places(simulation.context, bodies, x), 0b11, timings)
    twin, there = forces.twin(), State(state.R + 0.1, *state[1:])
    here = forces(state)
    twin(there)
    assert forces(state) is here
    assert timings.evaluations == 2
    parts = [forces.of(1 << group)(state)[0] for group in range(2)]
    assert min(np.abs(part).max() for part in parts) > 1e-3
    np.testing.assert_allclose(sum(parts), here[0], rtol=0.0, atol=1e-12 * np.abs(here[0]).max())
    assert not forces.of(0b100)(state)[0].any()


def strength_at(t):
    return 300.0 * (1.0 + 0.5 * np.cos(40.0 * t))


def end_under_a_force_of_time(scheme, n, **nested):
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
    integrator = rb.ExactRigidBodyIntegrator(0.2 / n, scheme=scheme, **nested)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions([[0.1, 0.2, -0.1]])
    integrator.step(n)
    state = context.getState(positions=True)
    assert context.getStepCount() == n
    assert state.getTime()._value == pytest.approx(0.2, rel=1e-12)
    return state.getPositions(asNumpy=True)._value[0]


@pytest.mark.parametrize("nested", [{}, {"fast": (1,), "inner": "S6_10", "innerSteps": 4}], ids=["plain", "nested"])
@pytest.mark.parametrize(("scheme", "order"), [("V2", 2), ("V2_drift", 2), ("SRKN4_6b", 4), ("S6_10", 6)])
def test_forces_that_depend_on_time_keep_the_order(scheme, order, nested):
    """Within a call of `step` too time goes on, with the drifts."""
    start = [0.1, 0.2, -0.1, 0.0, 0.0, 0.0]
    equations = lambda t, y: [*y[3:], *(-(strength_at(t) + 200.0) * y[:3])]  # noqa: E731
    exact = solve_ivp(equations, (0.0, 0.2), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:3, -1]
    steps = {2: (64, 128), 4: (24, 48), 6: (12, 18)}[order]
    errors = [np.abs(end_under_a_force_of_time(scheme, n, **nested) - exact).max() for n in steps]
    measured = np.log(errors[0] / errors[1]) / np.log(steps[1] / steps[0])
    assert measured == pytest.approx(order, abs=0.3), errors
