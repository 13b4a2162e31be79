"""What every engine of the catalogue does: its steps are those of the host, and it continues its checkpoints."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.engines import ENGINES
from places import REFERENCE
from starts import context_of

_, WATER, POSITIONS = rb.rigid_water(3)


def moving(engine, friction=1.0, scheme="BAOA"):
    """Return the Context of a few molecules that an engine has moved by some steps."""
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, friction, 0.002, scheme, engine=engine)
    integrator.setRandomNumberSeed(3)
    context = context_of(WATER, integrator, POSITIONS, kelvin=300.0, platform=REFERENCE)
    integrator.step(6)
    assert integrator.getEngine() == engine
    return context


@pytest.fixture(params=ENGINES)
def engine(request):
    return request.param


def test_steps_and_heat_are_those_of_the_host(engine):
    ours, theirs = moving(engine), moving("host")
    for one, other in zip(*(c.getIntegrator().fullState()[1] for c in (ours, theirs)), strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-11)
    heats = [c.getIntegrator().heat()._value for c in (ours, theirs)]
    assert heats[0] == pytest.approx(heats[1], abs=1e-9)
    assert abs(heats[1]) > 1e-3


def test_a_checkpoint_is_continued(engine):
    context = moving(engine)
    checkpoint, ends = context.createCheckpoint(), []
    for _ in range(2):
        context.loadCheckpoint(checkpoint)
        context.getIntegrator().step(5)
        ends.append(np.array(context.getState(positions=True).getPositions(asNumpy=True)._value))
    np.testing.assert_array_equal(*ends)


def test_an_engine_has_its_own_word(engine):
    """In the note, in the list of those that there are, and in a copy."""
    integrator = moving(engine).getIntegrator()
    assert f'engine="{engine}"' in integrator.engineNote()
    assert openmm.XmlSerializer.clone(integrator).getSettings()["arguments"]["engine"] == engine
    with pytest.raises(ValueError, match=rf"choose one of .*\b{engine}\b"):
        rb.ExactRigidBodyIntegrator(0.001, engine="none of them")
