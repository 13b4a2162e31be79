"""Assembly of the program for the bodies of a Context from its scheme, its thermostat and its parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from openmm_exactrb.context import variables
from openmm_exactrb.engines.native.flexible.evaluated import Evaluated
from openmm_exactrb.engines.native.flexible.part import Flexible, FlexiblePart
from openmm_exactrb.engines.native.program import Launch, Program, Source
from openmm_exactrb.engines.native.rigid import Demands, RigidPart, parts_of
from openmm_exactrb.engines.native.segments import ALL, Step, Table, divided
from openmm_exactrb.engines.native.sequences import Sequences
from openmm_exactrb.engines.native.together import joined, together
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.thermostatted import canonical_momenta
from openmm_exactrb.steps.moves import Move, Op, of_substep
from openmm_exactrb.steps.sequence import inverse, up_to_kick
from openmm_exactrb.thermostats.thermostat import Factors, Thermostat

#: Number of parameters of a heat exchange in addition to its time; see kernels/rigid.cl.
EXCHANGE_NUMBERS = 8


class Assembly:
    """The program that performs a scheme for given bodies.

    Attributes
    ----------
    parts : list of Part
    table : Table
    program : Program
    scheme : Scheme
    fast_evaluations : int
        Number of evaluations of fast forces per step.
    evaluated, evaluated_around : int
        Numbers of evaluations of fast forces that OpenMM performs per step, and around each action of a barostat.
    """

    def __init__(
        self,
        bodies: RigidBodies,
        scheme: Scheme,
        updates: Any,
        sites: bool,
        thermostat: Thermostat | None = None,
        flexible: Sequence[Flexible] = (),
        evaluated: Evaluated | None = None,
        pairs: bool = False,
        single: bool = False,
    ) -> None:
        self.scheme, processed = scheme, bool(scheme.processor)
        factors = None if thermostat is None else thermostat.factors
        inner = next((some.molecules.inner for some in flexible if some.molecules.inner), None)
        if inner is not None or evaluated is not None:
            scheme = scheme.with_inner_steps
        late = any(some.molecules.late for some in flexible)
        rows = canonical_momenta(scheme.sequence) if late else scheme.sequence
        ahead = up_to_kick(rows)
        if evaluated is not None:
            scheme = evaluated.within(scheme)
            rows, ahead = evaluated.rows(rows), evaluated.rows(ahead)
        moves = [move for row in rows for move in of_substep(*row)]
        drifts = [move.part for move in moves if move.op == Op.DRIFT and move.bodies != "others"]
        kicks = ALL if evaluated is None else evaluated.slow
        step = Step.of(rows, factors is not None, kicks if any(scheme.memory) else None, processed)
        self.evaluated = 0 if evaluated is None else step.evaluations(evaluated.groups)
        ways = (divided(ahead), divided(inverse(ahead)))
        self.evaluated_around = sum(segment.groups is not None for way in ways for segment in way)
        self.fast_evaluations = self.evaluated
        if inner is not None:  # and one at the positions of each displaced kick
            self.fast_evaluations = sum(map(inner.evaluations, drifts)) + step.remembered[1]
        self._has_output = bool(scheme.output)
        self._demands = demands = _demands(scheme, step, thermostat, pairs, single)
        self.table = Table(demands.own)
        prefixes = "flexible_", "constrained_"
        molecules = [FlexiblePart(some, demands, prefix) for some, prefix in zip(flexible, prefixes, strict=False)]
        others = np.concatenate([np.zeros(0, int), *(part.bodies for part in molecules)])
        self.parts: list[RigidPart | FlexiblePart] = [*molecules, *parts_of(bodies, demands, others)]
        if single:  # otherwise a thread of the joined kernel needs more registers than it has
            joined(self.parts)
        self.program = to = Program()
        to.scalars |= {"turn": 0.0, "key": 0.0, "hottest": 0.0, "removes": 0.0, "enough": self._enough}
        to.array("factors", 2)
        to.array("totals", 3)
        numbers = () if thermostat is None else thermostat.persistent
        to.array("thermostat", len(numbers), saved=True)
        to.numbers = "thermostat", [variables.PREFIX + name for name in numbers]
        sequences = Sequences(self.parts, self.table, sites, factors and self._factors(factors), together)
        sequences.write_step(to, step, processed)
        if processed:
            sequences.write_processor(to, scheme, rows[len(rows) - step.held :])
        sequences.write_updates(to, updates, processed, ahead)
        self.table.declare(to, EXCHANGE_NUMBERS)
        for part in self.parts:
            part.declare(to)

    def _factors(self, factors: Factors) -> Callable[[int], Launch]:
        """Return a function that maps the row of a heat exchange to the launch that computes its factors."""
        source = Source("thermostats", ("precision.cl", "random.cl", "thermostats.cl"), factors.defines)
        arrays = "totals", "factors", "thermostat", Table.MOVES, Table.NUMBERS
        return lambda row: Launch(source, factors.kernel, 1, (*arrays, row, "#step", "$key"), 1)

    @property
    def _enough(self) -> float:
        """The number of steps that store enough forces for the output, which is infinite if the output needs none."""
        pairs = (self._demands.memory, self._demands.differences)
        return max(math.ceil(size / per_step) for size, per_step in pairs) if self._has_output else 1e300


def _demands(scheme: Scheme, step: Step, thermostat: Thermostat | None, pairs: bool, single: bool) -> Demands:
    """Return what a scheme and its thermostat require of the kernels; `pairs` and `single` are those of `Demands`."""
    moves = _moves(scheme)
    (forces, differences), (per_step, of_differences) = scheme.memory, step.remembered
    return Demands(
        (forces, max(per_step, 1)),
        (differences, max(of_differences, 1)),
        bool(scheme.processor),
        any(move.op == Op.DISPLACE for move in moves),
        any(move.op == Op.EXCHANGE for move in moves),
        thermostat is not None and thermostat.factors is not None,
        -1 if thermostat is None or thermostat.heat is None else thermostat.persistent.index(thermostat.heat),
        tuple(dict.fromkeys(move.text for move in moves if move.text)),
        pairs,
        single,
    )


def _moves(scheme: Scheme) -> Iterable[Move]:
    """Return the moves of the sequence, the processor and the output of a scheme."""
    return [move for row in scheme.rows for move in of_substep(*row)]
