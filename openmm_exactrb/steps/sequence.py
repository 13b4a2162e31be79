"""Sequences of substeps, each with its fraction of the step, and their flows."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from typing import TypeVar

from openmm_exactrb.mechanics.state import Flow
from openmm_exactrb.steps.substeps import Drift, HeatExchange, Substep, of_symbol
from openmm_exactrb.steps.substeps import Sequence as Sequence
from openmm_exactrb.support.descriptions import mismatch

_S = TypeVar("_S")


def inverse(sequence: Sequence) -> Sequence:
    """Return the sequence whose flow inverts that of a given sequence."""
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
        if rows and rows[-1][0] == substep and substep.additive and not mismatch(substep, "additive", "bind"):
            part += rows.pop()[1]
        rows.append((substep, part))
    return tuple(rows)


def repeated(sequence: Sequence, n: int) -> Sequence:
    """Return the sequence of n steps, with the outer substeps of neighbouring steps merged."""
    return merged(sequence * n)


def second_moments(kicks: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Return B = sum_j b_j c_j (1 - c_j) and D = sum_{j<k} b_j b_k (c_k - c_j) of ordered kicks (b_j, c_j).

    b_j is the fraction of a kick and c_j its time since the thermostat, in units of the step.
    """
    kicks = tuple(kicks)
    single = math.fsum(b * c * (1.0 - c) for b, c in kicks)
    double = math.fsum(b * other * (there - c) for (b, c), (other, there) in itertools.combinations(kicks, 2))
    return single, double


def behind_exchange(sequence: Sequence) -> Sequence:
    """Return the drifts after the last heat exchange if a step ends with them, otherwise an empty sequence.

    From one heat exchange to the next, a step is symmetric in time, so that errors of the energy at the exchanges are
    of order 2. At the end of the step, positions are at a later time than momenta, and the errors of the total energy
    are of order 1.
    """
    rows: list[tuple[Substep, float]] = []
    for substep, part in reversed(sequence):
        if isinstance(substep, HeatExchange):
            return tuple(reversed(rows))
        if not isinstance(substep, Drift):
            break
        rows.append((substep, part))
    return ()


def up_to_kick(sequence: Sequence) -> Sequence:
    """Return the drifts from the end of a step to the next kick if the step ends with a heat exchange and drifts.

    A barostat acts after these drifts. With W2_3m, step-size errors of the pressure are smaller at the positions of the
    kick than at the end of a step. At these positions, bodies with and without inner steps have drifted for the same
    time.
    """
    if not behind_exchange(sequence):
        return ()
    return tuple(itertools.takewhile(lambda row: isinstance(row[0], Drift), sequence))


def spelled(text: str) -> Sequence:
    """Return the sequence of a text such as "B A O A B"; substeps of the same kind have equal fractions of the step.

    A ValueError is raised if the text contains no substep, or an unknown one.
    """
    symbols = text.split()
    if not symbols:
        raise ValueError(f'a sequence must consist of substeps separated by spaces, such as "B A O A B", not {text!r}')
    return tuple((of_symbol(symbol), 1.0 / symbols.count(symbol)) for symbol in symbols)


def bound(sequence: Sequence, flows: Mapping[Substep, Flow[_S]], h: float) -> list[tuple[Flow[_S], float]]:
    """Return the flows of the substeps in a step of size h, each with its time."""
    return [(flows[substep], part * h) for substep, part in sequence]


def through(rows: Iterable[tuple[Flow[_S], float]], state: _S) -> _S:
    """Return the state after successive flows, each over its own time."""
    for flow, tau in rows:
        state = flow(state, tau)
    return state


def run(sequence: Sequence, flows: Mapping[Substep, Flow[_S]], state: _S, h: float) -> _S:
    """Return the state after a step of size h, for a sequence and the flows of its substeps."""
    return through(bound(sequence, flows, h), state)
