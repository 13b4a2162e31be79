"""The sequences of a program, written from the launches of its parts (see `segments`)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from openmm_exactrb.engines.native import program
from openmm_exactrb.engines.native.program import Operation, Program
from openmm_exactrb.engines.native.segments import Rows, Segment, Step, Table, divided
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.steps.sequence import Sequence as Substeps
from openmm_exactrb.steps.sequence import inverse
from openmm_exactrb.steps.substeps import Drift
from openmm_exactrb.support.types import Array


class Part(Protocol):
    """A subset of the bodies of a program, with its arrays and the launches of a segment.

    With `copied`, methods act on the shown state of a processed scheme instead of the state in inner coordinates.
    """

    def declare(self, to: Program) -> None:
        """Declare arrays."""

    def launches(self, segment: Segment, table: Table) -> Sequence[Operation]:
        """Return the launches of a segment, which read forces from "force" and finally write positions to "posq"."""

    def state(self, copied: bool) -> Sequence[str]:
        """Return the names of the arrays of a state."""

    def reductions(self, copied: bool, adds: bool) -> Sequence[Operation]:
        """Return the operations that write kinetic energies and the number of invalid bodies to "totals"."""

    def read_exchange(self, machine: Any, around: tuple[State, State]) -> None:
        """Read the momenta of these bodies before and after the last heat exchange into two states of all bodies."""

    def kinetic_by_kind(self, machine: Any) -> Array:
        """Return the kinetic energies that the last reductions found: of translation, rotation and other particles."""

    def pushed(self, copied: bool, to_copy: bool) -> Sequence[Operation]:
        """Return operations that add to state(to_copy) the change of the Context's velocities since state(copied)."""

    def moved(self, copied: bool) -> Sequence[Operation]:
        """Return the operations that read positions changed by OpenMM."""


@dataclass
class Sequences:
    """Writes the sequences of a program from the launches of its parts.

    Attributes
    ----------
    sites : bool
        Whether the System has virtual sites.
    factors : callable, optional
        factors(row) -> the launch that computes the factors of the heat exchange in a row of the table from the kinetic
        energies.
    together : callable
        together(operations) -> the launches of a segment, of which some may be joined.
    """

    parts: Sequence[Part]
    table: Table
    sites: bool
    factors: Callable[[int], Operation] | None = None
    together: Callable[[list[Operation]], list[Operation]] = list

    def carried_out(self, segments: Iterable[Segment]) -> list[Operation]:
        """Return the operations of segments, each preceded by the evaluation that it needs."""
        return [operation for segment in segments for operation in (*self.before(segment), *self.moved(segment))]

    def before(self, segment: Segment) -> list[Operation]:
        """Return the operations before a segment: an evaluation of forces, or of kinetic energies and factors."""
        if segment.reduces:
            assert self.factors is not None
            row, _ = self.table.rows(segment.moves)
            return [*self.reductions(segment.copied), self.factors(row)]
        return [] if segment.groups is None else self.evaluation(segment.groups, segment.time)

    def reductions(self, copied: bool = False) -> list[Operation]:
        """Return the operations that write the kinetic energies of all parts to "totals"."""
        return [operation for k, part in enumerate(self.parts) for operation in part.reductions(copied, k > 0)]

    def evaluation(self, groups: int, time: float) -> list[Operation]:
        """Return the operations that evaluate the forces of groups at the present positions and a given time."""
        return [*self._sites, program.REORDER, program.clock(time), program.forces(groups)]

    @property
    def _sites(self) -> list[Operation]:
        return [program.SITES] if self.sites else []

    def moved(self, segment: Segment) -> list[Operation]:
        """Return the launches of all parts for a segment."""
        if not segment.moves and not segment.shows and not segment.places:
            return []
        return self.together([operation for part in self.parts for operation in part.launches(segment, self.table)])

    def _each(self, method: str, *arguments: bool) -> list[Operation]:
        """Return the operations that a method returns for all parts."""
        return [operation for part in self.parts for operation in getattr(part, method)(*arguments)]

    def write_step(self, to: Program, step: Step, processed: bool) -> None:
        """Write the sequences of steps: "forces", "open", "body", "between", "close" and "report".

        If steps hold drifts, a call ends with "hold" instead of "close", and the next call begins with "resume" instead
        of "open".
        """
        first, *middle, last = step.segments
        ends: list[Operation] = [program.STEP, program.add("turn", 1.0)]
        placed = self.moved(Segment(places=True))  # the Context may show other positions, or miss constraints
        to.sequence("forces", [] if step.needs is None else [*placed, *self.evaluation(step.needs, 0.0)])
        to.sequence("open", self.moved(first))
        to.sequence("body", [*self.carried_out(middle), *self.before(last)])
        to.sequence("between", [*self.moved(step.between), *ends])
        to.sequence("close", [*self.moved(last), *ends, *self._sites])
        to.sequence("report", self.reductions(copied=True))
        if processed:
            to.sequence("report_inner", self.reductions(copied=False))
        if step.held:
            to.sequence("hold", [*self.moved(step.hold), *ends])
            to.sequence("resume", self.moved(step.resume))

    def write_processor(self, to: Program, scheme: Scheme, held: Substeps) -> None:
        """Write "enter", the map to inner coordinates, and the maps back: "output" and the exact "postprocess".

        The maps back named "output_held" and "postprocess_held" begin with the drifts `held` that a call omitted.
        """
        to.sequence("enter", [*self._copies(shown=False), *self._way(scheme.processor, copied=False)])
        placed = self.moved(Segment(places=True, copied=True))  # because forces are evaluated at these positions
        to.sequence("postprocess", [*self._copies(shown=True), *placed, *self._way(scheme.postprocessor, copied=True)])
        to.sequence("output", [*self._copies(shown=True), *self._way(scheme.output, copied=True)])
        if held:
            for name, rows in (("postprocess", scheme.postprocessor), ("output", scheme.output)):
                to.sequence(f"{name}_held", [*self._copies(shown=True), *self._way((*held, *rows), copied=True)])

    def _copies(self, shown: bool) -> list[Operation]:
        """Return the operations that copy the state in inner coordinates to the shown state, or vice versa."""
        pairs = [zip(part.state(not shown), part.state(shown), strict=True) for part in self.parts]
        return [program.copy(*names) for names in itertools.chain(*pairs)]

    def _way(self, rows: Rows, copied: bool, begins: float | None = None) -> list[Operation]:
        """Return the operations that perform substeps outside of a step and then show the state in the Context.

        The time does not advance, unless `begins` is the fraction of the step at which the substeps begin.
        """
        some = [
            replace(segment, copied=copied, time=0.0 if begins is None else begins + segment.time)
            for segment in divided(rows)
        ]
        some[-1] = replace(some[-1], shows=True, places=True)
        return [*self.carried_out(some), *self._sites]

    def write_updates(self, to: Program, updates: Any, processed: bool, ahead: Substeps) -> None:
        """Write the sequences around OpenMM's updates of the Context; flags of `updates` state which may occur.

        A barostat acts after the drifts `ahead`, which follow the end of a step and are then undone.
        """
        velocities = updates.has_thermostats or updates.removes_motion
        pushed, moved = self._each("pushed", False, False) if velocities else [], self._each("moved", False)
        # Thermostats set velocities that are not those of rigid bodies, and a call may end here.
        to.sequence("pushed", [*pushed, *(self.moved(Segment(shows=True)) if updates.has_thermostats else [])])
        if not processed:
            to.sequence("moved", moved)
            if ahead:
                late = math.fsum(part for substep, part in ahead if substep in (Drift(), Drift("others")))
                to.sequence("leave", [*self._way(ahead, False, 0.0), program.clock(late)])
                to.sequence("return", [*self._way(inverse(ahead), False, late), program.clock(0.0)])
            return
        enters = to.sequences["enter"]
        pushes = [*self._each("pushed", True, False), *self._each("pushed", True, True)] if velocities else []
        to.sequence("leave", to.sequences["postprocess"])
        to.sequence("leave_pushed", pushes)
        # Entering writes positions and velocities to the Context, so it follows when both have been read from there.
        to.sequence("leave_moved", [*self._each("moved", True), *([] if updates.has_thermostats else enters)])
        to.sequence("return", enters if updates.has_thermostats else [])
