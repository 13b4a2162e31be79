"""Which checkpoints are read by which integrators."""

import pytest

import openmm_exactrb as rb
from openmm_exactrb.context import variables
from starts import droplet_of
from thermostatted import snapshot


@pytest.mark.parametrize("after", ["S2_2", "W2_1", "V2_C17", "W4_4"])
@pytest.mark.parametrize("before", ["S2_2", "W2_1", "V2_C17", "W4_4"])
def test_any_scheme_continues_from_the_checkpoint_of_any_other(before, after):
    """Processed ones remember forces, each as many as it needs, and have inner coordinates of their own."""
    source, target = (droplet_of(rb.ExactRigidBodyIntegrator(0.01, scheme)) for scheme in (before, after))
    source.integrator.step(9)
    target.context.loadCheckpoint(source.context.createCheckpoint())
    assert snapshot(target) == snapshot(source)
    energy = target.integrator.totalEnergy()._value
    target.integrator.step(20)
    assert target.context.getStepCount() == 29
    assert target.integrator.totalEnergy()._value == pytest.approx(energy, abs=0.02)


def test_each_format_has_a_mark_of_its_own():
    formats = [(), ("a",), ("b",), ("a", "b"), ("b", "a"), ("ab",)]
    for mark, least in ((variables.written, 1.0), (variables.by_library, 3.0), (variables.native, 5.0)):
        found = [mark(own) for own in formats]
        assert found[0] == least
        assert len(set(found)) == len(formats)
        assert all(least <= value < least + 1.0 for value in found)
