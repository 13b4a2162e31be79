"""Fast forces in kernels are those of OpenMM's Reference platform, in blocks of any size."""

import numpy as np
import openmm
import pytest

from bonded_terms import FORMS, N, lennard_jones_pairs, system_of, terms_in
from openmm_exactrb.engines.library import Machine, library
from openmm_exactrb.engines.native.flexible import blocks
from openmm_exactrb.engines.native.flexible.blocks import Group
from openmm_exactrb.engines.native.flexible.molecules import Molecules
from openmm_exactrb.engines.native.flexible.part import Flexible, FlexiblePart
from openmm_exactrb.engines.native.program import Program
from openmm_exactrb.engines.native.rigid import Demands
from openmm_exactrb.engines.native.segments import Segment, Table
from openmm_exactrb.mechanics.state import BodyState, State
from openmm_exactrb.moves import Move, Op
from places import device_platform
from starts import context_of

pytestmark = pytest.mark.opencl
RNG = np.random.default_rng(11)


ALL = N * len(FORMS)


class Kicks:
    """One program for a chain of each form: the fast forces that the kernel has on particles of mass 1."""

    def __init__(self, precision):
        self.precision = precision
        self.system = system_of(*(make(N * k) for k, make in enumerate(FORMS)), n=ALL)
        single = Group(np.arange(ALL)[:, None])
        molecules = Molecules([single], np.ones(ALL), np.arange(ALL), terms_in(self.system))
        self.part, table, program = (
            FlexiblePart(Flexible(molecules, np.zeros((ALL, 3)), precision), Demands(), "flexible_"),
            Table(),
            Program(),
        )
        program.sequence("kick", self.part.launches(Segment((Move(Op.FAST_KICK, 1.0),), shows=True), table))
        program.scalars |= {"turn": 0.0, "key": 0.0, "hottest": 1e300}
        self.part.declare(program)
        program.array("factors", 2)
        table.declare(program, 0)
        integrator = library().make()
        integrator.setStepSize(1.0)
        precisions = {"Precision": "double" if precision is np.float64 else "mixed"}
        self.context = openmm.Context(system_of(n=ALL), integrator, device_platform(), precisions)
        self.context.setPositions(np.zeros((ALL, 3)))
        self.device = Machine(library(), integrator)
        self.device.load(program.text(processor=False))
        moves, numbers = table.values(1.0, None)
        for name, values in (self.part.tables() | {"moves": moves, "numbers": numbers}).items():
            self.device.upload(name, values)

    def __call__(self, x):
        """Return the forces at places."""
        rounded = BodyState(x.T.copy(), np.zeros((3, ALL)), np.zeros((4, 0)), np.zeros((3, 0)))
        self.part.write(self.device, State.of(rounded))
        self.device.run("kick")
        out = State.of(BodyState(np.zeros((3, ALL)), np.zeros((3, ALL)), np.zeros((4, 0)), np.zeros((3, 0))))
        self.part.read(self.device, out)
        return out.rounded.P.T


@pytest.fixture(scope="module", params=[np.float64, np.float32], ids=["double", "float"])
def kicks(request):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "COST_OF_BLOCK", 150)
        patch.setattr(blocks, "COST_OF_MOLECULE", 150)
        return Kicks(request.param)


def test_each_form_is_openmms(kicks):
    turns = np.radians(100.0) * np.arange(N)
    helix = np.stack([0.1 * np.cos(turns), 0.1 * np.sin(turns), 0.08 * np.arange(N)], axis=1)  # no angle is straight
    x = np.tile(helix + 0.03 * RNG.normal(size=(N, 3)), (len(FORMS), 1))
    assert len(kicks.part.blocks) > 3 * len(FORMS)
    ours = kicks(x)
    context = context_of(kicks.system, openmm.VerletIntegrator(0.001), x)
    theirs = context.getState(forces=True).getForces(asNumpy=True)._value
    resolution = 8.0 * 2.0**-32  # of sums in fixed point, for a few terms on an atom
    tolerance = 1e-12 if kicks.precision is np.float64 else 1e-6
    for k, make in enumerate(FORMS):
        chain = slice(N * k, N * (k + 1))
        largest = np.abs(theirs[chain]).max()
        assert np.abs(ours[chain] - theirs[chain]).max() < tolerance * largest + resolution, make.__name__


def test_forces_that_have_no_place_in_sums_are_no_numbers(kicks):
    """Of two atoms at almost one place: sums in fixed point would wrap round."""
    x = RNG.normal(size=(ALL, 3))
    first = N * FORMS.index(lennard_jones_pairs)
    x[first + 3] = x[first] + 1e-5
    ours = kicks(x)
    assert np.isnan(ours[first, 0])
