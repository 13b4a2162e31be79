"""What every substep of the package is said to do, it does."""

import dataclasses
import inspect

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from both_engines import begun
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps import substeps
from openmm_exactrb.steps.moves import Op
from openmm_exactrb.steps.substeps import DRIFT, KICK, Substep
from openmm_exactrb.thermostats import Langevin
from places import REFERENCE, device_platform

_, WATER, POSITIONS = rb.rigid_water(3)
KINDS = {
    name: kind
    for name, kind in inspect.getmembers(substeps, inspect.isclass)
    if issubclass(kind, Substep) and kind not in (Substep, substeps.LastForcesKick)  # which is for output alone
}
#: Values of the arguments that a substep needs, by their types.
VALUES = {"float": 0.7, "tuple[float, ...]": (0.7,)}


@pytest.fixture(params=KINDS)
def substep(request):
    kind = KINDS[request.param]
    needed = (f for f in dataclasses.fields(kind) if f.default is dataclasses.MISSING)
    return kind(**{f.name: VALUES[f.type] for f in needed})


def ends(rows, *numbers, platform=REFERENCE, **options):
    """Return the states of molecules in motion before and after numbers of steps, and what the engine is and why."""
    if any(isinstance(row, substeps.HeatExchange) for row, _ in rows):
        options["thermostat"] = Langevin(300.0, 1.0 if len(rows) > 1 else 0.0)
    integrator = rb.ExactRigidBodyIntegrator(0.002, Scheme("mine", 2, rows), checkDivergence=False, **options)
    integrator.setRandomNumberSeed(5)
    _context = begun(WATER, POSITIONS, integrator, platform=platform)
    states = [integrator.fullState()[1]]
    for n in numbers:
        integrator.step(n)
        states.append(integrator.fullState()[1])
    return states, integrator.getEngine(), integrator.engineNote()


def test_a_substep_that_moves_nothing_leaves_positions_and_orientations(substep):
    (before, after), *_ = ends(((substep, 1.0),), 1, engine="host")
    kept = [np.array_equal(*pair) for pair in ((before.R, after.R), (before.q, after.q))]
    assert all(kept) if not substep.moves else not any(kept)


def test_two_substeps_are_one_over_the_sum_of_their_times_if_they_say_so(substep):
    (*_, twice), *_ = ends(((substep, 1.0),), 1, 1, engine="host")
    (*_, once), *_ = ends(((substep, 2.0),), 1, engine="host")
    apart = max(np.abs(one - other).max() for one, other in zip(twice, once, strict=True))
    assert apart < 1e-12 if substep.additive else apart > 0.0 or not substep.kicks


def within_a_step(substep):
    return (KICK, 0.5), (substep, 0.5), (DRIFT, 1.0), (substep, 0.5), (KICK, 0.5)


def assert_same(one, other):
    for ours, theirs in zip(one, other, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-11)


@pytest.mark.opencl
def test_kernels_on_a_device_perform_the_same_flow(substep):
    platform, rows = device_platform(), within_a_step(substep)
    (*_, host), *_ = ends(rows, 6, engine="host", platform=platform)
    (*_, native), *_ = ends(rows, 6, engine="native", platform=platform)
    assert_same(native, host)


@pytest.mark.library
@pytest.mark.parametrize("name", ["Reference", "CPU"])
def test_kernels_on_a_processor_perform_the_same_flow_or_leave_it_to_the_host(substep, name):
    platform, rows = openmm.Platform.getPlatform(name), within_a_step(substep)
    (*_, host), *_ = ends(rows, 6, engine="host", platform=platform)
    (*_, found), engine, note = ends(rows, 6, platform=platform)
    if any(move.op == Op.OWN for move in substep.kernel_moves(1.0)):
        why = f"the kernels for the platform {name} are compiled without the kernel_moves of {substep!r}"
        assert (engine, why in note) == ("host", True)
    else:
        assert engine == "native"
    assert_same(found, host)
