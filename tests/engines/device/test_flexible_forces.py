"""Fast forces on the device are those of OpenMM's Reference platform, in blocks of any size."""

import numpy as np
import openmm
import pytest

from bonded_terms import FORMS, N, system_of, terms_in
from on_device import device_platform
from openmm_exactrb.engines.device.flexible import blocks
from openmm_exactrb.engines.device.flexible.blocks import Group
from openmm_exactrb.engines.device.flexible.molecules import Molecules
from openmm_exactrb.engines.device.flexible.part import FlexiblePart
from openmm_exactrb.engines.device.library import Device, library
from openmm_exactrb.engines.device.program import Program
from openmm_exactrb.engines.device.rigid import Demands
from openmm_exactrb.engines.device.segments import Segment, Table
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.moves import Move, Op
from starts import context_of

pytestmark = pytest.mark.opencl
RNG = np.random.default_rng(11)


def kicked(system, x, precision):
    """Return the fast forces that the kernel has on particles of mass 1, and the part with it."""
    single = Group(np.arange(N)[:, None], np.zeros((0, 2), dtype=np.int64), np.zeros(0))
    molecules = Molecules([single], np.ones(N), np.arange(N), terms_in(system, -1))
    part, table, program = FlexiblePart(molecules, x, precision, Demands()), Table(), Program()
    program.sequence("kick", part.launches(Segment((Move(Op.FAST_KICK, 1.0),), shows=True), table))
    program.scalars |= {"turn": 0.0, "key": 0.0}
    part.declare(program)
    program.array("factors", 2)
    table.declare(program, 0)
    integrator = library().make()
    integrator.setStepSize(1.0)
    precisions = {"Precision": "double" if precision is np.float64 else "mixed"}
    context = openmm.Context(system, integrator, device_platform(), precisions)
    context.setPositions(x)
    device = Device(library(), integrator)
    device.load(program.text)
    moves, numbers = table.values(1.0, None)
    for name, values in (part.tables() | {"moves": moves, "numbers": numbers}).items():
        device.upload(name, values)
    part.write(device, BodyState(x.T.copy(), np.zeros((3, N)), np.zeros((4, 0)), np.zeros((3, 0))))
    device.run("kick")
    out = BodyState(np.zeros((3, N)), np.zeros((3, N)), np.zeros((4, 0)), np.zeros((3, 0)))
    part.read(device, out)
    return out.P.T, part


@pytest.mark.parametrize(("precision", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-6)])
@pytest.mark.parametrize("make", FORMS)
def test_each_form_is_openmms(make, precision, tolerance, monkeypatch):
    monkeypatch.setattr(blocks, "COST_OF_BLOCK", 150)
    monkeypatch.setattr(blocks, "COST_OF_MOLECULE", 150)
    turn = 1.7 * np.arange(N)  # a helix: where bonds are almost straight, torsions lose digits
    helix = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), 0.05 * np.arange(N)], axis=1)
    system, x = system_of(make()), helix + 0.01 * RNG.normal(size=(N, 3))
    ours, part = kicked(system, x, precision)
    assert len(part.blocks) > 3
    context = context_of(system, openmm.VerletIntegrator(0.001), x)
    theirs = context.getState(forces=True).getForces(asNumpy=True)._value
    resolution = 8.0 * 2.0**-32  # of sums in fixed point, for a few terms on an atom
    assert np.abs(ours - theirs).max() < tolerance * np.abs(theirs).max() + resolution


def test_forces_that_have_no_place_in_sums_are_no_numbers():
    """Of two atoms at almost one place: sums in fixed point would wrap round."""
    force = FORMS[5]()
    x = RNG.normal(size=(N, 3))
    x[3] = x[0] + 1e-5
    ours, _ = kicked(system_of(force), x, np.float64)
    assert np.isnan(ours[:, 0]).all()
