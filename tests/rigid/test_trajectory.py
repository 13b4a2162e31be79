"""Steps in kernels are those of the host, to roundoff: schemes, bodies, thermostats, precisions."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
import starts
from both_engines import apart, begun, maker, pair
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.moves import Move, Op
from openmm_exactrb.steps.sequence import spelled
from openmm_exactrb.steps.substeps import DRIFT, KICK, Substep
from starts import held
from zoo import every_kind, water

pytestmark = [pytest.mark.library, pytest.mark.opencl]
LONG = pytest.mark.validate
STEPS = 20
# Of the order of summation in the forces; by force-gradient kicks differences are multiplied.
DOUBLE, MIXED = 1e-11, 2e-8


def stepped(contexts, n=STEPS):
    for context in contexts:
        context.getIntegrator().step(n)
    return apart(*contexts)


# One of each structure: drift first, a processor, and this with displaced forces; kick first are those below.
@pytest.mark.parametrize(
    "scheme", ["S6_10", "W2_1", "W4_4", *(pytest.param(name, marks=LONG) for name in ("S2_2", "SRKN6_14a", "Chin4A"))]
)
def test_a_scheme_moves_water_as_the_host_does(scheme):
    start = water(64, method=app.PME) if scheme == "W2_1" else water()
    contexts = pair(*start, maker(scheme, 0.001))
    assert stepped(contexts) < DOUBLE
    assert contexts[0].getTime()._value == pytest.approx(contexts[1].getTime()._value, rel=1e-14)
    assert contexts[1].getStepCount() == STEPS


@pytest.mark.parametrize("scheme", [pytest.param("S2_2", marks=LONG), "W2_1"])
def test_increments_in_single_precision_err_less_than_the_forces(scheme):
    """Which in mixed precision are those of positions in single precision."""
    mixed = pair(*water(), maker(scheme, 0.001), precision="mixed")
    double = begun(*water(), maker(scheme, 0.001)("host"), kelvin=None)
    starts.put(double, mixed[0].getState(positions=True, velocities=True))
    for context in (*mixed, double):
        context.getIntegrator().step(STEPS)
    host, device, exact = (held(context)[0] for context in (*mixed, double))
    of_increments, of_forces = (np.sqrt(((a - b) ** 2).mean()) for a, b in ((device, host), (host, exact)))
    assert 0.0 < of_increments < of_forces < MIXED


@pytest.mark.parametrize("scheme", ["S2_2", pytest.param("W2_1", marks=LONG), "Chin4A"])
def test_bodies_of_every_kind_move_as_on_the_host(scheme):
    system, positions, bodies = every_kind()
    contexts = pair(system, positions, maker(scheme, 0.002, bodies=bodies))
    assert stepped(contexts) < 1e-13
    assert np.abs(held(contexts[1])[0] - positions).max() > 0.05


def test_virtual_sites_move_as_on_the_host():
    contexts = pair(*water(model="tip4pew"), maker("W2_1", 0.001))
    assert stepped(contexts) < DOUBLE


def test_kicks_by_force_groups_are_those_of_the_host():
    system, positions = water()
    field = openmm.CustomExternalForce("20*(x-1)^2")
    for i in range(0, system.getNumParticles(), 3):
        field.addParticle(i)
    field.setForceGroup(3)
    system.addForce(field)
    scheme = Scheme("split", 2, spelled("B3 B0 A B0 B3"))
    contexts = pair(system, positions, maker(scheme, 0.001))
    assert stepped(contexts) < DOUBLE


def test_a_lopsided_scheme_is_that_of_the_host():
    scheme = Scheme("Euler", 1, ((KICK, 1.0), (DRIFT, 1.0)))
    contexts = pair(*water(), maker(scheme, 0.001))
    assert stepped(contexts) < DOUBLE


@pytest.mark.parametrize("scheme", ["BAOA", "W2_3m", pytest.param("S2_2", marks=LONG)])
def test_with_one_seed_langevin_dynamics_has_the_noise_of_the_host(scheme):
    def make(engine):
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002, scheme, engine=engine)
        integrator.setRandomNumberSeed(11)
        return integrator

    host, device = pair(*water(), make)
    host.getIntegrator().step(STEPS)
    for n in (1, 7, STEPS - 8):  # noise depends on neither the number of calls nor what is between them
        device.getIntegrator().step(n)
    assert apart(host, device) < 1e-9


def moving_water(integrator, platform):
    """Return the Context of a few water molecules on a platform."""
    _, system, positions = rb.rigid_water(8)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform))
    context.setPositions(positions)
    context.setVelocitiesToTemperature(300.0, 1)
    return context


@dataclass(frozen=True)
class Fading(Substep):
    """Momenta fade at a rate; all have one name for their function in kernels."""

    rate: float

    def bind(self, environment):
        def flow(state, tau):
            return state._replace(P=math.exp(-self.rate * tau) * state.P)

        return flow

    def kernel_moves(self, part):
        text = f"""
        DEVICE inline double faded(double x, double tau) {{ return exp(-{self.rate!r}*tau)*x; }}
        DEVICE inline void fade(Body* body, double tau) {{
            for (int k = 0; k < 3; k++)
                body->P[k] = faded(body->P[k], tau);
        }}"""
        return (Move(Op.OWN, part, text=text),)


def test_moves_of_users_may_have_functions_of_one_name():
    system, positions, bodies = every_kind()
    rows = ((Fading(3.0), 0.5), (KICK, 0.5), (DRIFT, 1.0), (KICK, 0.5), (Fading(50.0), 0.5))
    scheme = Scheme("fading", 1, rows)
    contexts = pair(system, positions, maker(scheme, 0.002, bodies=bodies))
    assert stepped(contexts) < 1e-12


@pytest.mark.parametrize("platform", ["Reference", "CPU"])
def test_moves_of_users_are_left_to_the_host_where_kernels_are_compiled_before(platform):
    rows = ((Fading(3.0), 0.5), (KICK, 0.5), (DRIFT, 1.0), (KICK, 0.5), (Fading(50.0), 0.5))
    scheme, ends = Scheme("fading", 1, rows), []
    for engine in ("host", "auto"):
        integrator = rb.ExactRigidBodyIntegrator(0.002, scheme, engine=engine)
        context = moving_water(integrator, platform)
        integrator.step(10)
        ends.append(context.getState(positions=True).getPositions(asNumpy=True)._value)
    np.testing.assert_array_equal(*ends)
    assert "compiled without the kernel_moves of Fading(rate=3.0)" in integrator.engineNote()
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme, engine="native")
    _context = moving_water(integrator, platform)
    with pytest.raises(ValueError, match=f"for the platform {platform} are compiled without .*: use engine='host'"):
        integrator.step(1)


@pytest.mark.parametrize(("kind", "together"), [("rescaling", True), ("chain", False)])
def test_thermostats_that_multiply_momenta_are_those_of_the_host(kind, together):
    def make(engine):
        if kind == "chain":
            return rb.ExactRigidBodyNoseHooverIntegrator(300.0, 10.0, 0.002, together=together, engine=engine)
        integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.1, 0.002, together=together, engine=engine)
        integrator.setRandomNumberSeed(11)
        return integrator

    host, device = pair(*water(), make)
    assert stepped((host, device)) < 1e-9
    kept = [
        context.getIntegrator().effectiveEnergy() if kind == "chain" else context.getIntegrator().heat()
        for context in (host, device)
    ]
    assert kept[1]._value == pytest.approx(kept[0]._value, rel=1e-8)


def test_forces_that_depend_on_time_have_the_time_of_the_host():
    system, positions = water()
    system.addForce(openmm.PythonForce(partial(_pull, n=system.getNumParticles())))
    contexts = pair(system, positions, maker("SRKN4_6b", 0.001))
    assert stepped(contexts) < DOUBLE


def _pull(state, n):
    force = np.zeros((n, 3))
    force[::3, 0] = 50.0 * np.sin(40.0 * state.getTime()._value)
    return 0.0, force


def test_single_precision_keeps_the_state_in_double():
    """What the Context shows is rounded to 1e-7 nm; the bodies are not."""
    system, positions, bodies = every_kind()
    contexts = pair(
        system,
        positions,
        maker("S2_2", 0.002, bodies=bodies),
        precision="single",
    )
    assert stepped(contexts) < 2e-6
    state = contexts[1].getIntegrator().bodyState()[1]
    np.testing.assert_allclose(np.einsum("in,in->n", state.q, state.q), 1.0, rtol=0.0, atol=1e-14)


@pytest.mark.validate
def test_bodies_stay_rigid_over_a_hundred_thousand_steps():
    """Free ones, for forces cost time and roundoff of positions does not depend on them."""
    system, positions = water(8)
    while system.getNumForces():
        system.removeForce(0)
    context = begun(system, positions, rb.ExactRigidBodyIntegrator(0.002, "S2_2", engine="native"))

    def lengths():
        x = held(context)[0].reshape(-1, 3, 3)
        return np.array([np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in ((0, 1), (0, 2), (1, 2))])

    context.getIntegrator().step(1)  # bodies have the lengths of the constraints, positions to 12 digits
    before = lengths()
    context.getIntegrator().step(100_000)
    np.testing.assert_allclose(lengths(), before, rtol=0.0, atol=1e-13)
