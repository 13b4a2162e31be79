"""What a user changes between calls: `step(0)` shows the same state, and steps go on from what is shown."""

import random

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from changes import (
    CHANGES,
    PLACES,
    PULL,
    SILENT,
    Run,
    assert_goes_on_from_what_is_shown,
    bonds,
    minimiser,
    state_of_another_integrator,
    with_silent_forces,
)
from products import spread_over
from starts import positions_of

SCHEMES = [name for name in rb.SCHEMES if name != "V2_drift"]
PROCESSED = [name for name in SCHEMES if rb.SCHEMES[name].processor]


def cases(place, scheme, rng, changes, flexible=False, thermostat=None):
    run = Run(place, scheme, flexible, thermostat)
    for change in changes:
        if change is minimiser and run.context.getPlatform().getName() == "OpenCL":
            continue  # OpenMM's minimiser may crash on devices that are CPUs
        run.integrator.step(rng.choice([1, 4, 7]))
        change(run, rng)
        assert_goes_on_from_what_is_shown(run, exact=change not in (state_of_another_integrator, minimiser))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_steps_of_every_scheme_go_on_from_what_is_shown(scheme):
    rng = random.Random(scheme)
    for place in ("no library", "kernels"):
        cases(place, scheme, rng, rng.sample(CHANGES, 2))


@spread_over({"scheme": ["S2_2", *PROCESSED], "place": PLACES})
def test_every_change_is_noticed(scheme, place):
    rng = random.Random(place + scheme)
    count = len(CHANGES) if place != "OpenCL" else 6  # Contexts of devices take long to create
    cases(place, scheme, rng, rng.sample(CHANGES, count))


@spread_over({"scheme": ["S2_2", "W2_1", "SRKN4_6b"], "place": PLACES}, times=2)
def test_every_change_is_noticed_with_inner_steps(scheme, place):
    rng = random.Random(place + scheme)
    changes = [bonds, *rng.sample(CHANGES, 4), bonds, *(rng.sample(CHANGES, 4) if place != "OpenCL" else [])]
    cases(place, scheme, rng, changes, flexible=True)


@spread_over({"scheme": ["BAOA", "BAOAB"], "place": PLACES}, times=2)
def test_every_change_is_noticed_with_a_thermostat(scheme, place):
    rng = random.Random(place + scheme)
    changes = [bonds, *rng.sample(CHANGES, 4 if place != "OpenCL" else 2)]
    cases(place, scheme, rng, changes, flexible=True, thermostat=True)


@pytest.mark.parametrize("place", ["host", "kernels"])
def test_bonds_that_become_stiff_have_inner_steps_or_an_error(place):
    """As if they had been stiff; the program of kernels has no inner steps before the Context is made anew."""
    run = Run(place, "W2_1", True)
    bond = run.force("bonds")
    for stiffness in (0.0, 3e5):
        for k in range(bond.getNumBonds()):
            i, j, length, _ = bond.getBondParameters(k)
            bond.setBondParameters(k, i, j, length, stiffness)
        if not stiffness:
            run.context.reinitialize(preserveState=True)
            run.integrator.step(3)
    bond.updateParametersInContext(run.context)
    if place == "kernels":
        with pytest.raises(ValueError, match=r"call context.reinitialize\(preserveState=True\)"):
            run.integrator.step(1)
        run.context.reinitialize(preserveState=True)
    assert_goes_on_from_what_is_shown(run)


@spread_over({"scheme": ["V2", "S2_2", "W2_3", "BAOAB", *PROCESSED], "place": PLACES})
def test_changes_that_openmm_does_not_report_are_noticed(scheme, place):
    """Those of data that a function of Python reads, and of an inner Context."""
    rng = random.Random(place + scheme)
    run = Run(place, scheme, False, True if scheme == "BAOAB" else None)
    with_silent_forces(run)
    for change in rng.sample(SILENT, 2 if place != "OpenCL" else 1):
        run.integrator.step(rng.choice([1, 4]))
        change(run, rng)
        assert_goes_on_from_what_is_shown(run)


@spread_over({"place": PLACES, "scheme": ["S2_2", "W2_1", "W4_4"]})
def test_looking_for_such_changes_alters_no_bit(scheme, place):
    ends = []
    for calls in ([6], [1, 3, 2]):
        run = Run(place, scheme, False)
        with_silent_forces(run)
        PULL["strength"] = 3.0
        for count in calls:
            run.integrator.step(count)
        ends.append(positions_of(run.context))
    np.testing.assert_array_equal(*ends)


# -- what changes nothing ---------------------------------------------------------------------------------------------


def test_step_0_evaluates_no_forces():
    run = Run("host", "W2_1", False)
    for _ in range(2):
        run.integrator.step(0)
        assert run.integrator.timings.evaluations == 0
        run.integrator.step(5)
        run.integrator.timings.reset()


NOISE = np.random.default_rng(1)


def random_pull(state):
    """Return no energy, and other forces at each evaluation."""
    return 0.0, NOISE.normal(0.0, 10.0, (25, 3))


def pull_at_a_time(state):
    """Return the energy and the forces of a field that depends on the time and the number of steps."""
    x, t = state.getPositions(asNumpy=True)._value, state.getTime()._value
    strength = 100.0 * np.sin(50.0 * t + state.getStepCount())
    return strength * x[:, 0].sum(), -strength * np.eye(3)[[0] * len(x)]


@pytest.mark.parametrize("pull", [None, random_pull, pull_at_a_time])
@pytest.mark.parametrize("scheme", ["W2_1", "W4_4"])
@pytest.mark.parametrize("place", [pytest.param("host", marks=pytest.mark.library), "no library"])
def test_forces_that_change_by_themselves_leave_the_inner_state(place, scheme, pull):
    """Calls cost the output and, if OpenMM may report no change, one look at the forces, or two at random ones."""
    run = Run(place, scheme, False)
    if pull is not None:
        run.system.addForce(openmm.PythonForce(pull))
        run.context.reinitialize(preserveState=True)
    run.integrator.checkDivergence = False  # which asks for energies
    for _ in range(5):
        run.integrator.step(3)
    run.integrator.timings.reset()
    run.integrator.step(3)
    looks = 0 if place == "host" and pull is None else 2 if pull is random_pull else 1  # the library is told of changes
    expected = 3 * rb.SCHEMES[scheme].forces + rb.SCHEMES[scheme].output_forces + looks
    assert run.integrator.timings.evaluations == expected
