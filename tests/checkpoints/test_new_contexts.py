"""A new Context continues from a checkpoint or a State, by every engine."""

import openmm
import pytest

import openmm_exactrb as rb
from both_engines import apart, begun, maker
from openmm_exactrb.openmm_access import platforms
from places import REFERENCE, device_platform
from zoo import water

H = 0.001


@pytest.fixture(scope="module")
def box():
    """A System of 27 molecules of water, and positions."""
    return water()


@pytest.mark.parametrize(("how", "friction"), [("checkpoint", 1.0), ("State", None), ("checkpoint", None)])
def test_a_new_context_continues_with_the_same_bits(box, how, friction, place):
    engine, platform = place

    def fresh():
        return begun(*box, maker("S2_2" if friction else "W2_1", H, friction)(engine), platform=platform)

    one = fresh()
    one.getIntegrator().step(8)
    if how == "checkpoint":
        saved = one.createCheckpoint()
        one.loadCheckpoint(saved)
    else:
        state = one.getState(positions=True, velocities=True, integratorParameters=True)
        text = openmm.XmlSerializer.serialize(state)
        one = fresh()  # a run in which a State is set gets noise of its own
        one.setState(openmm.XmlSerializer.deserialize(text))
    other = fresh()
    if how == "checkpoint":
        other.loadCheckpoint(saved)
    else:
        other.setState(openmm.XmlSerializer.deserialize(text))
    for context in (one, other):
        context.getIntegrator().step(9)
    assert apart(one, other) == 0.0 if how == "checkpoint" else apart(one, other) < 1e-12  # OpenMM sorts molecules anew


@pytest.mark.library
@pytest.mark.parametrize(
    "first", [True, pytest.param(False, marks=pytest.mark.opencl)], ids=["chosen before", "chosen by the checkpoint"]
)
def test_auto_continues_a_run_of_the_native_engine(box, first, monkeypatch):
    """To the last bit, whether or not the engine was chosen before."""
    scheme, platform = ("W2_1", REFERENCE) if first else ("S2_2", device_platform())
    one = begun(*box, maker(scheme, H)("native"), platform=platform)
    one.getIntegrator().step(8)
    checkpoint = one.createCheckpoint()
    one.loadCheckpoint(checkpoint)
    one.getIntegrator().step(3)
    integrator = rb.ExactRigidBodyIntegrator(H, scheme, engine="auto")
    other = begun(*box, integrator, kelvin=None, platform=platform)
    if first:
        monkeypatch.setattr(platforms, "no_gpu", lambda context: None)  # else auto prefers the host
        integrator.step(0)
    other.loadCheckpoint(checkpoint)
    integrator.step(3)
    assert apart(one, other) == 0.0
    assert integrator.getEngine() == "native"
