"""Force-gradient kicks by forces at displaced places: their formula, order, reversibility and symplectic defect."""

import numpy as np
import openmm
import pytest

import charts
import openmm_exactrb as rb
from benchmarks.paper.problems import HeavyTop, Satellite, energy, integrate
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.mechanics.free_motion import rigid
from openmm_exactrb.mechanics.state import ForceMemory, State
from openmm_exactrb.rotors import rotor_of_sums
from openmm_exactrb.steps.sequence import repeated, run
from openmm_exactrb.steps.substeps import DRIFT, KICK, GradientKick, gradient_kick, kick
from orders import exponent, slope
from sequences import gradient_kicks
from starts import context_of

CHIN = rb.SCHEMES["Chin4A"]


def tops(n=8):
    return HeavyTop.random(np.random.default_rng(8), 2.0, 1.0, n)


def satellites(n=8):
    rng = np.random.default_rng(9)
    problem = Satellite(rng.uniform(1.0, 2.0, (3, n)), gravity=1.0, radius=1.0)
    return problem, (np.ascontiguousarray(quaternions.random(rng, n).T), rng.standard_normal((3, n)))


class Torques:
    """The torques of a problem on bodies that do not move from their place."""

    def __init__(self, problem):
        self.problem, self.memory = problem, ForceMemory()

    def __call__(self, state):
        torque = self.problem.torque(state.q[0])
        return np.zeros_like(torque), torque

    at = __call__


def displaced(problem, gradients):
    """Return flows of a problem without its gradients: forces at displaced places stand in for them."""
    kinetic, forces = (
        rigid(np.ones(problem.inertia.shape[1]), rotor_of_sums("exact", problem.inertia.T)),
        Torques(problem),
    )
    kicks = {s: gradient_kick(forces, kinetic, problem.inertia, s.strength) for s in gradients}
    return {DRIFT: kinetic.drift, KICK: kick(forces), **kicks}


def at_the_origin(q, m):
    return State(np.zeros_like(m), np.zeros_like(m), q, m)


def moved(problem, state, h, n, scheme=CHIN):
    """Return (q, m) after n steps with forces at displaced places."""
    q, m = map(exactly, state)
    flows = displaced(problem, gradient_kicks(scheme))
    end = run(repeated(scheme.sequence, n), flows, at_the_origin(q, m), h)
    return end.q[0], end.m[0]


@pytest.mark.parametrize("make", [tops, satellites])
def test_it_is_the_kick_of_the_force_gradient_potential_up_to_the_square_of_the_displacement(make):
    """Without the commutator of the body axes the difference would fall with the displacement itself."""
    problem, (q, m) = make()
    state = at_the_origin(exactly(q), exactly(m))
    wanted = 0.5 * problem.gradient_torque(q)
    differences = []
    for e in (0.02, 0.01, 0.005):
        substep = GradientKick(e)
        kicked = displaced(problem, [substep])[substep](state, 1.0)
        torque = kicked.m[0] - m
        differences.append(np.abs(torque - problem.torque(q) + e * wanted).max())
        np.testing.assert_array_equal(kicked.q, state.q)
    assert np.diff(np.log2(differences)) == pytest.approx([-2.0, -2.0], abs=0.1)


def test_the_commutator_of_the_body_axes_is_needed():
    problem, (q, _) = tops()
    torque, e = problem.torque(q), 1e-4
    turn = e * torque / problem.inertia
    twist = np.cross(turn, torque, axis=0)
    assert np.abs(twist).max() > 0.05 * e * np.abs(problem.gradient_torque(q)).max()


GRADIENTS = [name for name, scheme in rb.SCHEMES.items() if scheme.has_gradients and scheme.symmetric]


@pytest.mark.parametrize(("name", "make"), [*((name, tops) for name in GRADIENTS), ("Chin4A", satellites)])
def test_schemes_keep_their_order_with_displaced_forces(name, make):
    (problem, state), scheme = make(), rb.SCHEMES[name]
    steps = [round(factor * 80 / scheme.forces) for factor in (1.0, 1.5, 2.0)]
    order = slope(lambda n: moved(problem, state, 2.0 / n, n, scheme)[1], steps)
    assert abs(order - scheme.order) < 0.35


def test_displaced_forces_lead_where_exact_gradients_do_up_to_order_four():
    problem, state = tops()
    steps, apart = (24, 34, 48), []
    for n in steps:
        exact = integrate(problem, state, 2.0 / n, n, CHIN)[1]
        apart.append(np.median(np.abs(moved(problem, state, 2.0 / n, n)[1] - exact).max(axis=0)))
    assert abs(exponent(steps, apart) + 4.0) < 0.35


@pytest.mark.parametrize("make", [tops, satellites])
def test_steps_are_reversible_at_any_size(make):
    problem, (q, m) = make()
    q1, m1 = moved(problem, (q, m), 0.3, 30)
    q2, m2 = moved(problem, (q1, -m1), 0.3, 30)
    np.testing.assert_allclose(-m2, m, rtol=0.0, atol=2e-13)
    np.testing.assert_allclose(np.abs((q2 * q).sum(axis=0)), 1.0, rtol=0.0, atol=5e-15)


def test_a_step_misses_being_symplectic_by_the_fifth_power_of_its_size():
    problem, (q, m) = tops(1)
    sizes, defects = (0.2, 0.14, 0.1), []
    for h in sizes:
        end, _ = moved(problem, (q, m), h, 1)

        def step(x, h=h, end=end):
            ends = (moved(problem, charts.state_at(q, column), h, 1) for column in x.T)
            return np.stack([charts.coordinates_of(end, *state) for state in ends], axis=1)

        defects.append(charts.symplectic_defect(charts.jacobian(step, np.concatenate([np.zeros(3), m[:, 0]]))))
    assert abs(exponent(sizes, defects) - 5.0) < 0.5
    assert defects[0] < 1e-4


def test_the_energy_of_tops_has_no_trend_over_a_thousand_steps():
    problem, state = tops()
    start, halves = energy(problem, state), []
    for _ in range(2):
        largest = 0.0
        for _ in range(100):
            state = moved(problem, state, 0.1, 5)
            largest = np.maximum(largest, np.abs(energy(problem, state) - start))
        halves.append(np.median(largest))
    assert halves[1] < 1.5 * halves[0]


# -- in OpenMM --------------------------------------------------------------------------------------------------------


def water(n=8):
    """Return a System of water and a State of its own at some temperature."""
    _, system, positions = rb.rigid_water(n)
    langevin = openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.002)
    langevin.setRandomNumberSeed(1)
    context = context_of(system, langevin, positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    context.setVelocitiesToTemperature(300.0, 1)
    langevin.step(200)
    return system, context.getState(positions=True, velocities=True)


def dumbbells():
    """Return a System of three charged linear molecules and one particle, and a State."""
    system, force = openmm.System(), openmm.NonbondedForce()
    places = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.35, 0.1, 0], [0.35, 0.2, 0], [0.1, 0.3, 0.3], [0.1, 0.3, 0.4]])
    positions = np.vstack([places, [[0.5, 0.5, 0.1]]])
    for i in range(len(positions)):
        system.addParticle(12.0 + (i % 2))
        force.addParticle(0.3 * (-1) ** i, 0.25, 0.4)
    for i in (0, 2, 4):
        system.addConstraint(i, i + 1, 0.1)
        force.addException(i, i + 1, 0.0, 0.25, 0.0)
    system.addForce(force)
    context = context_of(system, openmm.VerletIntegrator(1e-3), positions, kelvin=200.0, seed=3)
    return system, context.getState(positions=True, velocities=True)


def integrator_at(system, state, h, scheme=CHIN):
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme)
    context = context_of(system, integrator, state)
    return integrator, context


@pytest.mark.parametrize(("make", "T", "steps"), [(water, 0.02, (8, 11, 16)), (dumbbells, 0.1, (8, 11, 16))])
def test_it_has_order_four_in_openmm_also_with_linear_molecules_and_single_particles(make, T, steps):
    system, state = make()

    def end(n):
        integrator, _context = integrator_at(system, state, T / n)
        integrator.step(n)
        return integrator.bodyState()[1].P

    assert abs(slope(end, steps) - 4.0) < 0.35


def test_a_linear_molecule_gets_no_momentum_about_its_axis():
    integrator, _context = integrator_at(*dumbbells(), 0.004)
    integrator.step(20)
    state = integrator.bodyState()[1]
    assert np.abs(state.m[0]).max() < 1e-14 * np.abs(state.m).max()


def test_water_comes_back_when_its_momenta_are_turned_round():
    integrator, _context = integrator_at(*water(), 0.006)
    start = integrator.bodyState()[1]
    for _ in range(2):
        integrator.step(20)
        state = integrator.bodyState()[1]
        integrator.setBodyState(state._replace(P=-state.P, m=-state.m))
    end = integrator.bodyState()[1]
    np.testing.assert_allclose(end.P, start.P, rtol=0.0, atol=3e-13 * np.abs(start.P).max())
    np.testing.assert_allclose(np.abs((end.q * start.q).sum(axis=0)), 1.0, rtol=0.0, atol=3e-15)


def momenta(state):
    """Return the linear momentum of all bodies, and the angular one about the origin."""
    spin = np.einsum("ijn,jn->i", quaternions.matrix(state.q), state.m)
    return state.P.sum(axis=1), spin + np.cross(state.R.T, state.P.T).sum(axis=0)


@pytest.mark.parametrize("name", ["Chin4A", "W2_5", "W2_4g"])
def test_a_droplet_keeps_its_momentum_and_its_angular_momentum(name):
    """Forces at displaced places sum up to zero, and their torques about the places themselves."""
    integrator, _context = integrator_at(*water(), 0.008, rb.SCHEMES[name])
    before = momenta(integrator.bodyState()[1])
    integrator.step(100)
    after = momenta(integrator.bodyState()[1])
    np.testing.assert_allclose(after[0], before[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(after[1], before[1], rtol=0.0, atol=3e-13 * np.abs(before[1]).max())


def test_linear_molecules_and_single_particles_keep_the_angular_momentum_up_to_order_four():
    """They cannot take up all torques."""
    system, state = dumbbells()
    steps, lost = (12, 17, 24), []
    for n in steps:
        integrator, _context = integrator_at(system, state, 0.3 / n)
        before = momenta(integrator.bodyState()[1])
        integrator.step(n)
        after = momenta(integrator.bodyState()[1])
        np.testing.assert_allclose(after[0], before[0], rtol=0.0, atol=1e-13)
        lost.append(np.abs(after[1] - before[1]).max())
    assert abs(exponent(steps, lost) + 4.0) < 0.5


def test_forces_are_counted_at_displaced_places_too():
    integrator, _context = integrator_at(*water(2), 0.003)
    integrator.step(5)
    assert integrator.forceEvaluationsPerStep == 3
    assert integrator.timings.evaluations == 5 * 3 + 1
