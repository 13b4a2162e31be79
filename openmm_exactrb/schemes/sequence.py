"""Sequences of substeps, each with its fraction of the step, and their flows."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from typing import TypeVar

from openmm_exactrb.mechanics.state import Flow
from openmm_exactrb.substeps import Sequence as Sequence
from openmm_exactrb.substeps import Substep, of_symbol

_S = TypeVar("_S")


def inverse(sequence: Sequence) -> Sequence:
    """Return the inverse of a sequence."""
    return tuple((substep, -part) for substep, part in reversed(sequence))


def palindromic(sequence: Sequence) -> bool:
    """Return whether a sequence is a palindrome, up to the order of neighbouring kicks, which commute."""
    pairs = zip(_in_order(sequence), _in_order(sequence[::-1]), strict=True)
    return all(a == b and math.isclose(i, j, rel_tol=1e-14) for (a, i), (b, j) in pairs)


def _in_order(sequence: Sequence) -> Sequence:
    """Return a sequence with neighbouring kicks in a canonical order."""
    places = ((kicks, list(some)) for kicks, some in itertools.groupby(sequence, lambda row: row[0].kicks))
    by_name = lambda row: (repr(row[0]), row[1])  # noqa: E731
    return tuple(itertools.chain(*(sorted(some, key=by_name) if kicks else some for kicks, some in places)))


def merged(sequence: Iterable[tuple[Substep, float]]) -> Sequence:
    """Return a sequence in which equal neighbouring substeps are merged if they are additive."""
    rows: list[tuple[Substep, float]] = []
    for substep, part in sequence:
        if rows and rows[-1][0] == substep and substep.additive:
            part += rows.pop()[1]
        rows.append((substep, part))
    return tuple(rows)


def repeated(sequence: Sequence, n: int) -> Sequence:
    """Return the sequence of n steps, with the outer substeps of neighbouring steps merged."""
    return merged(sequence * n)


def second_moments(kicks: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Return B = sum_j b_j c_j (1 - c_j) and D = sum_{j<k} b_j b_k (c_k - c_j) of kicks (b_j, c_j), in their order.

    b_j is the fraction of a kick and c_j its time since the thermostat, in units of the step.
    """
    kicks = tuple(kicks)
    single = math.fsum(b * c * (1.0 - c) for b, c in kicks)
    double = math.fsum(b * other * (there - c) for (b, c), (other, there) in itertools.combinations(kicks, 2))
    return single, double


def spelled(text: str) -> Sequence:
    """Return the sequence of a text such as "B A O A B"; substeps of the same kind have equal fractions of the step.

    A ValueError is raised if the text contains no substep, or an unknown one.
    """
    symbols = text.split()
    if not symbols:
        raise ValueError('a sequence needs substeps separated by spaces, such as "B A O A B"')
    return tuple((of_symbol(symbol), 1.0 / symbols.count(symbol)) for symbol in symbols)


def bound(sequence: Sequence, flows: Mapping[Substep, Flow[_S]], h: float) -> list[tuple[Flow[_S], float]]:
    """Return the flows of the substeps in a step of size h, each with its time."""
    return [(flows[substep], part * h) for substep, part in sequence]


def through(rows: Iterable[tuple[Flow[_S], float]], state: _S) -> _S:
    """Return the state after successive flows, each over its time: the loop of every step."""
    for flow, tau in rows:
        state = flow(state, tau)
    return state


def run(sequence: Sequence, flows: Mapping[Substep, Flow[_S]], state: _S, h: float) -> _S:
    """Return the state after a step of size h, for a sequence and the flows of its substeps."""
    return through(bound(sequence, flows, h), state)
