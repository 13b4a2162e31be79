"""What happens to flexible molecules between two evaluations of the slow forces, as rows of a table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple


class Operation(NamedTuple):
    """A kick by fast or slow forces, a heat exchange with its number in the step, or a drift, over a part of a step."""

    kind: str  # "fast", "slow", "exchange" or "drift"
    part: float
    number: int = 0


class Row(NamedTuple):
    """Kicks, a heat exchange, kicks, and a drift, over parts of a step."""

    fast: float = 0.0
    slow: float = 0.0
    exchange: float = 0.0
    number: float = 0.0
    slow_after: float = 0.0
    fast_after: float = 0.0
    drift: float = 0.0

    def behind(self, operation: Operation) -> tuple[Row | None, Row]:
        """Return this row if it is complete behind an operation, else None, and the one that the next belongs to."""
        kind, part, number = operation
        if kind == "drift":
            return self._replace(drift=part), Row()
        if kind == "exchange":
            alone = Row(exchange=part, number=number)
            return (self, alone) if self.exchange else (None, self._replace(exchange=part, number=number))
        column = f"{kind}_after" if self.exchange else kind
        return None, self._replace(**{column: getattr(self, column) + part})


def rows_of(operations: Iterable[Operation]) -> tuple[list[Row], Row]:
    """Return the rows of operations that a drift, or a second heat exchange, ends, and what is left."""
    made, row = [], Row()
    for operation in operations:
        complete, row = row.behind(operation)
        made += [] if complete is None else [complete]
    return made, row


def without_drift(operations: Sequence[Operation]) -> int:
    """Return how many operations there are behind the last drift."""
    kinds = [operation.kind for operation in operations]
    return kinds[::-1].index("drift") if "drift" in kinds else len(kinds)
