"""What is saved after changes continues the same run, and what cannot be continued is refused."""

import copy
import itertools
import random

import numpy as np
import openmm
import pytest

from changes import (
    CHANGES,
    PLACES,
    Run,
    assert_goes_on_from_what_is_shown,
    charges,
    frozen_particle,
    minimiser,
    removed_force,
    restraint,
    shown,
)
from products import pairwise, spread_over


def continued(run, how, system=None, place=None):
    """Return a new Context of the same System and place, or another one, that continues from what is saved now."""
    integrator = run.made(place or run.place)
    integrator.setStepSize(run.integrator.getStepSize())
    integrator.setIntegrationForceGroups(run.integrator.getIntegrationForceGroups())
    context = openmm.Context(copy.deepcopy(system or run.system), integrator, *run.platform.values())
    if how == "checkpoint":
        context.loadCheckpoint(run.context.createCheckpoint())
        return context
    state = run.context.getState(positions=True, velocities=True, parameters=True, integratorParameters=True)
    context.setState(openmm.XmlSerializer.deserialize(openmm.XmlSerializer.serialize(state)))
    return context


def first_step(context):
    context.getIntegrator().step(1)


AXES = ["S2_2", "W2_1", "W4_4"], ["host", "no library", "kernels"]
OPENCL = pytest.param("W2_1", "OpenCL", marks=pytest.mark.opencl)
HOW = ["checkpoint", "State"]


@pytest.mark.parametrize(
    ("scheme", "place", "how", "looks"),
    [
        *pairwise(*AXES, HOW, (True, False)),
        *(pytest.param(*OPENCL.values, how, how == "State", marks=OPENCL.marks) for how in HOW),
    ],
)
def test_what_is_saved_behind_a_change_continues_with_the_same_bits(scheme, place, how, looks):
    rng = random.Random(f"{scheme}{place}{how}{looks}")
    changes = rng.sample([c for c in CHANGES if c not in (removed_force, minimiser)], 3 if place != "OpenCL" else 1)
    for change in (None, *changes):
        run = Run(place, scheme, False)
        run.integrator.step(5 if change is None else rng.choice([0, 1, 5]))
        if change is not None:
            change(run, rng)
        if looks:
            run.integrator.step(0)
        other = continued(run, how)
        for n in (1, 3):  # a step is shown with the help of the forces of several steps before it
            for context in (run.context, other):
                context.getIntegrator().step(n)
            if place != "OpenCL" or how == "checkpoint":
                np.testing.assert_array_equal(shown(other), shown(run.context), err_msg=str(change))
            else:  # OpenMM sorts molecules anew
                np.testing.assert_allclose(shown(other), shown(run.context), rtol=0.0, atol=1e-10, err_msg=str(change))


@spread_over({"scheme, place": [*itertools.product(*AXES), OPENCL], "how": HOW})
def test_a_frozen_particle_that_is_moved_before_a_checkpoint_acts_from_its_new_place(scheme, place, how):
    run = Run(place, scheme, False)
    run.integrator.step(5)
    frozen_particle(run, random.Random(1))
    other = continued(run, how)
    for context in (run.context, other):
        first_step(context)
    allowed = 0.0 if how == "checkpoint" and place != "OpenCL" else 1e-10
    np.testing.assert_allclose(shown(other), shown(run.context), rtol=0.0, atol=allowed)


@pytest.mark.library
@pytest.mark.parametrize("scheme", ["S2_2", "W4_4"])
@pytest.mark.parametrize(
    ("how", "before", "after", "message"),
    [
        ("checkpoint", "host", "no library", "saved with the library .* stores its state without the library"),
        ("State", "host", "no library", "saved with the library .* stores its state without the library"),
        ("checkpoint", "no library", "host", "saved without the library .* stores its state with the library"),
        ("State", "no library", "host", "saved without the library .* stores its state with the library"),
        ("checkpoint", "kernels", "no library", 'is from a run with engine="native"'),
        ("checkpoint", "no library", "kernels", 'is from a run with engine="host"'),
    ],
)
def test_what_an_integrator_cannot_read_is_refused(scheme, how, before, after, message):
    """Also by an integrator that has already performed steps."""
    run = Run(before, scheme, False)
    run.integrator.step(3)
    with pytest.raises((ValueError, openmm.OpenMMException), match=message):
        first_step(continued(run, how, place=after))
    other = Run(after, scheme, False)
    other.integrator.step(2)
    if how == "checkpoint":
        other.context.loadCheckpoint(run.context.createCheckpoint())
        with pytest.raises(ValueError, match=message):
            other.integrator.step(1)


@spread_over({"place": PLACES, "how": HOW})
def test_what_is_loaded_into_a_context_with_other_forces_goes_on_from_what_is_shown(place, how):
    """As from an equilibration with restraints."""
    run, other = Run(place, "W2_1", False), Run(place, "W2_1", False)
    for of_run, change in ((run, restraint), (other, charges)):
        change(of_run, random.Random(1))
    run.integrator.step(12)
    other.context = continued(run, how, other.system)
    other.integrator = other.context.getIntegrator()
    assert_goes_on_from_what_is_shown(other)
