"""Fast forces in kernels are those of OpenMM's Reference platform, in blocks of any size."""

import numpy as np
import openmm
import pytest

from bonded_terms import FORMS, N, lennard_jones_pairs, system_of, terms_in
from kicks import Kicks
from openmm_exactrb.engines.native.flexible import blocks
from openmm_exactrb.engines.native.flexible.blocks import Group
from openmm_exactrb.engines.native.flexible.molecules import Molecules
from places import device_platform
from starts import context_of

pytestmark = [pytest.mark.library, pytest.mark.opencl]
RNG = np.random.default_rng(11)


ALL = N * len(FORMS)


@pytest.fixture(scope="module", params=[np.float64, np.float32], ids=["double", "float"])
def kicked(request):
    """Return a System with a chain of each form, and a function that returns the forces of its kernels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "COST_OF_BLOCK", 150)
        patch.setattr(blocks, "COST_OF_MOLECULE", 150)
        system = system_of(*(make(N * k) for k, make in enumerate(FORMS)), n=ALL)
        molecules = Molecules([Group(np.arange(ALL)[:, None])], np.ones(ALL), np.arange(ALL), terms_in(system))
        return system, Kicks(system_of(n=ALL), molecules, device_platform(), request.param)


def test_each_form_is_openmms(kicked):
    system, kicks = kicked
    turns = np.radians(100.0) * np.arange(N)
    helix = np.stack([0.1 * np.cos(turns), 0.1 * np.sin(turns), 0.08 * np.arange(N)], axis=1)  # no angle is straight
    x = np.tile(helix + 0.03 * RNG.normal(size=(N, 3)), (len(FORMS), 1))
    assert len(kicks.part.blocks) > 3 * len(FORMS)
    ours = kicks(x)
    context = context_of(system, openmm.VerletIntegrator(0.001), x)
    theirs = context.getState(forces=True).getForces(asNumpy=True)._value
    resolution = 8.0 * 2.0**-32  # of sums in fixed point, for a few terms on an atom
    tolerance = 1e-12 if kicks.precision is np.float64 else 1e-6
    for k, make in enumerate(FORMS):
        chain = slice(N * k, N * (k + 1))
        largest = np.abs(theirs[chain]).max()
        assert np.abs(ours[chain] - theirs[chain]).max() < tolerance * largest + resolution, make.__name__


def test_forces_that_have_no_place_in_sums_are_no_numbers(kicked):
    """Of two atoms at almost one place: sums in fixed point would wrap round."""
    _, kicks = kicked
    x = RNG.normal(size=(ALL, 3))
    first = N * FORMS.index(lennard_jones_pairs)
    x[first + 3] = x[first] + 1e-5
    ours = kicks(x)
    assert np.isnan(ours[first, 0])
