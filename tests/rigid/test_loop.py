"""The integrator is the loop over the substeps of a sequence, bit for bit, and nothing else."""

from types import SimpleNamespace

import numpy as np
import openmm
import pytest

from few_dipoles import simulation_of, snapshot
from openmm_exactrb.mechanics.free_motion import rigid
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.rotors import rotor_of_sums
from openmm_exactrb.steps.sequence import run
from openmm_exactrb.steps.substeps import DRIFT, KICK, GradientKick, LastForcesKick, gradient_kick, kick
from places import REFERENCE

pytestmark = pytest.mark.usefixtures("host_is_advised")


class OpenMMForces:
    """Forces of a Context of its own at the places of a state; those of the last places are kept."""

    def __init__(self, system, bodies, x):
        self.context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
        self.bodies, self.x, self.evaluations = bodies, x.copy(), 0
        self.places, self.value = (None, None), None
        self.forget()

    def forget(self):
        """Forget the last forces and differences of displaced ones, which begin with the most recent one."""
        self.memory, self.watched = SimpleNamespace(forces=[], differences=[], add_difference=self.differ), True

    def differ(self, difference):
        if self.watched:
            self.memory.differences.insert(0, difference)

    def at(self, state):
        self.context.setPositions(self.bodies.positions(state.rounded, self.x))
        self.context.computeVirtualSites()
        self.evaluations += 1
        return self.bodies.forces(state.rounded, arrays.forces(self.context.getState(forces=True)))

    def __call__(self, state):
        if not (state.R is self.places[0] and state.q is self.places[1]):
            self.places, self.value = (state.R, state.q), self.at(state)
            if self.watched:
                self.memory.forces.insert(0, self.value)
        return self.value


def flows_of(scheme, forces, kinetic, inertia):
    """Return the flows of all substeps of a scheme."""
    flows = {DRIFT: kinetic.drift, KICK: kick(forces)}
    for substep, _ in (*scheme.sequence, *scheme.output):
        if isinstance(substep, GradientKick):
            flows[substep] = gradient_kick(forces, kinetic, inertia, substep.strength)
        elif isinstance(substep, LastForcesKick):
            flows[substep] = substep.bind(SimpleNamespace(forces=lambda: forces))  # it looks at the memory alone
    return flows


def test_the_integrator_is_the_loop_bit_for_bit(pairing):
    scheme, method = pairing
    n, h = 3, 0.02
    simulation = simulation_of(4, h, scheme, method)
    simulation.integrator.checkDivergence = False  # which asks for energies
    x, _ = snapshot(simulation)
    bodies, state = simulation.integrator.fullState()
    forces = OpenMMForces(simulation.system, bodies, x)
    flows = flows_of(scheme, forces, rigid(bodies.mass, rotor_of_sums(method, bodies.inertia)), bodies.inertia.T)
    with np.errstate(all="ignore"):
        inner = run(scheme.processor, flows, state, h)
        forces.forget()
        inner = run(scheme.sequence * n, flows, inner, h)
        forces.watched = False
        end = run(scheme.output or scheme.postprocessor, flows, inner, h)

    simulation.integrator.step(n)
    for ours, theirs in zip(end, simulation.integrator.fullState()[1], strict=True):
        np.testing.assert_array_equal(theirs, ours)
    if scheme.processor:
        for ours, theirs in zip(inner, simulation.integrator._propagator.sync.inner.state, strict=True):  # noqa: SLF001
            np.testing.assert_array_equal(theirs, ours)
    massive = np.concatenate([kind.particles.ravel() for kind in bodies.kinds])
    for ours, theirs in zip((bodies.positions, bodies.velocities), snapshot(simulation), strict=True):
        np.testing.assert_array_equal(theirs[massive], ours(end.rounded, np.zeros_like(x))[massive])
    assert simulation.integrator.timings.evaluations == forces.evaluations
    around = scheme.processing // 2 + scheme.output_forces
    assert forces.evaluations == n * scheme.forces + (scheme.first == "kick") + around
    assert simulation.integrator.forceEvaluationsPerStep == scheme.forces
    assert np.abs(end.R[0] - state.R[0]).max() > 1e-3


@pytest.mark.parametrize("kernel", ["openmm", "compiled"])
def test_a_run_continues_from_the_full_state_of_another(kernel):
    """What fullState returns, setBodyState takes: all that is known, rounding nothing."""
    whole, first, second = (simulation_of(4, scheme="V2", kernel=kernel) for _ in range(3))
    whole.integrator.step(6)
    first.integrator.step(3)
    second.integrator.setBodyState(first.integrator.fullState()[1])
    second.integrator.step(3)
    for a, b in zip(whole.integrator.fullState()[1], second.integrator.fullState()[1], strict=True):
        np.testing.assert_array_equal(a, b)
