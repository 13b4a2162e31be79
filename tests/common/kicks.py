"""Programs that kick particles of mass 1 by fast forces, for comparisons of these forces."""

import numpy as np
import openmm

from openmm_exactrb.engines.native.flexible.part import Flexible, FlexiblePart
from openmm_exactrb.engines.native.program import Program
from openmm_exactrb.engines.native.rigid import Demands
from openmm_exactrb.engines.native.segments import Segment, Table
from openmm_exactrb.library.library import Machine, library
from openmm_exactrb.mechanics.state import BodyState, State
from openmm_exactrb.steps.moves import Move, Op
from places import REFERENCE


class Kicks:
    """A program for single particles of mass 1 (`Molecules`), in a Context of a System with as many particles."""

    def __init__(self, system, molecules, platform, precision=np.float64):
        n, on_processor = system.getNumParticles(), platform is REFERENCE
        flexible = Flexible(molecules, np.zeros((n, 3)))
        self.n, self.precision = n, precision
        self.part = FlexiblePart(flexible, Demands(pairs=on_processor, single=precision is np.float32), "flexible_")
        table, program = Table(), Program()
        program.sequence("kick", self.part.launches(Segment((Move(Op.FAST_KICK, 1.0),), shows=True), table))
        program.scalars |= {"turn": 0.0, "key": 0.0, "hottest": 1e300}
        self.part.declare(program)
        program.array("factors", 2)
        table.declare(program, 0)
        integrator = library().make()
        integrator.setStepSize(1.0)
        properties = {} if on_processor else {"Precision": "double" if precision is np.float64 else "mixed"}
        self.context = openmm.Context(system, integrator, platform, properties)
        self.context.setPositions(np.zeros((n, 3)))
        self.machine = Machine(library(), integrator)
        self.machine.load(program.text(on_processor))
        moves, numbers = table.values(1.0, None)
        for name, values in (self.part.tables() | {"moves": moves, "numbers": numbers}).items():
            self.machine.upload(name, values)

    def __call__(self, x, **parameters):
        """Return the forces at positions (n, 3) with given parameters of the Context."""
        for name, value in parameters.items():
            self.context.setParameter(name, value)
        still = np.zeros((3, self.n)), np.zeros((4, 0)), np.zeros((3, 0))
        self.part.write(self.machine, State.of(BodyState(x.T.copy(), *still)))
        self.machine.run("kick")
        out = State.of(BodyState(np.zeros((3, self.n)), *still))
        self.part.read(self.machine, out)
        return out.rounded.P.T
