"""One launch for inner steps and for the segment of rigid bodies, which move different atoms."""

from __future__ import annotations

import math
from collections.abc import Sequence

from openmm_exactrb.engines.native.flexible.part import INNER_STEPS, FlexiblePart
from openmm_exactrb.engines.native.program import Launch, Operation
from openmm_exactrb.engines.native.rigid import SEGMENT, RigidPart


def joined(parts: Sequence[FlexiblePart | RigidPart]) -> None:
    """Give the first part of flexible molecules and the small rigid bodies one source, if there are both."""
    flexible = next((part for part in parts if isinstance(part, FlexiblePart)), None)
    rigid = next((part for part in parts if isinstance(part, RigidPart) and part.lanes == 1), None)
    if flexible is not None and rigid is not None:
        flexible.source = rigid.source = flexible.source.with_pieces_of(rigid.source, "together.cl")


def together(operations: Sequence[Operation]) -> list[Operation]:
    """Return the operations of a segment, with rigid bodies in the first launch of inner steps of the same source."""
    segment = next((o for o in operations if isinstance(o, Launch) and o.function == SEGMENT), None)
    inner = next((o for o in operations if isinstance(o, Launch) and o.function == INNER_STEPS), None)
    if segment is None or inner is None or segment.source != inner.source:
        return list(operations)
    threads = inner.threads + inner.block * math.ceil(segment.threads / inner.block)
    own = (given for given in segment.arguments if isinstance(given, int) or given not in inner.arguments)
    both = Launch(inner.source, "inner_steps_and_segment", threads, (*inner.arguments, *own), inner.block)
    return [both if o is inner else o for o in operations if o is not segment]
