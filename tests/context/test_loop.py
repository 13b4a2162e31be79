"""The integrator is the loop over the letters of a word, bit for bit, and nothing else."""

import numpy as np
import openmm
import pytest

from few_dipoles import REFERENCE, simulation_of, snapshot
from openmm_exactrb.context import arrays
from openmm_exactrb.motion.engine import run
from openmm_exactrb.motion.kick import gradient_kick, kick
from openmm_exactrb.motion.kinetic import rigid
from openmm_exactrb.rotors import rotor_of_sums


class OpenMMForces:
    """Forces of a Context of its own at the places of a state; those of the last places are kept."""

    def __init__(self, system, bodies, x):
        self.context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
        self.bodies, self.x, self.evaluations = bodies, x.copy(), 0
        self.places, self.value = (None, None), None

    def __call__(self, state):
        if not (state.R is self.places[0] and state.q is self.places[1]):
            self.context.setPositions(self.bodies.positions(state.rounded, self.x))
            self.context.computeVirtualSites()
            forces = arrays.forces(self.context.getState(forces=True))
            self.places, self.value = (state.R, state.q), self.bodies.forces(state.rounded, forces)
            self.evaluations += 1
        return self.value


def test_the_integrator_is_the_loop_bit_for_bit(pairing):
    scheme, method = pairing
    n, h = 3, 0.02
    simulation = simulation_of(4, h, scheme, method)
    x, _ = snapshot(simulation)
    bodies, state = simulation.integrator.fullState()
    forces, displaced = (OpenMMForces(simulation.system, bodies, x) for _ in range(2))
    kinetic = rigid(bodies.mass, rotor_of_sums(method, bodies.inertia))
    word = scheme.processor + scheme.word * n + scheme.postprocessor
    flows = {"A": kinetic.drift, "B": kick(forces)}
    for letter, strength in scheme.gradients:
        flows[letter] = gradient_kick(forces, displaced, kinetic, bodies.inertia.T, strength)
    with np.errstate(all="ignore"):
        end = run(word, flows, state, h)

    simulation.integrator.step(n)
    for ours, theirs in zip(end, simulation.integrator.fullState()[1], strict=True):
        np.testing.assert_array_equal(theirs, ours)
    massive = np.concatenate([kind.particles.ravel() for kind in bodies.kinds])
    for ours, theirs in zip((bodies.positions, bodies.velocities), snapshot(simulation), strict=True):
        np.testing.assert_array_equal(theirs[massive], ours(end.rounded, np.zeros_like(x))[massive])
    evaluations = forces.evaluations + displaced.evaluations
    assert simulation.integrator.timings.evaluations == evaluations
    assert evaluations == n * scheme.forces + (scheme.first == "kick") + scheme.processing
    assert simulation.integrator.forceEvaluationsPerStep == scheme.forces
    assert np.abs(end.R[0] - state.R[0]).max() > 1e-3


@pytest.mark.parametrize("kernel", ["openmm", "compiled"])
def test_a_run_goes_on_from_the_full_state_of_another(kernel):
    """What fullState returns, setBodyState takes: all that is known, rounding nothing."""
    whole, first, second = (simulation_of(4, scheme="V2", kernel=kernel) for _ in range(3))
    whole.integrator.step(6)
    first.integrator.step(3)
    second.integrator.setBodyState(first.integrator.fullState()[1])
    second.integrator.step(3)
    for a, b in zip(whole.integrator.fullState()[1], second.integrator.fullState()[1], strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_state_that_is_none_is_refused():
    simulation = simulation_of(2)
    integrator = simulation.integrator
    _, state = integrator.bodyState()
    for wrong in (state._replace(R=state.R[:, :1]), state._replace(m=np.full_like(state.m, np.nan))):
        with pytest.raises(ValueError, match=r"take one of bodyState\(\)"):
            integrator.setBodyState(wrong)
