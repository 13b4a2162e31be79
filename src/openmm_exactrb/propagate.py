"""Compose a scheme with the two flows of a problem: the only loop over stages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

from openmm_exactrb.schemes import Flow, Scheme

State = TypeVar("State")


def compose(
    scheme: Scheme, drift: Callable[[State, float], State], kick: Callable[[State, float], State]
) -> Callable[..., State]:
    """Return the splitting integrator of a scheme.

    Parameters
    ----------
    scheme : Scheme
    drift, kick : callable
        drift(state, tau) and kick(state, tau) return the state moved by the flow of T or of V over the time tau.

    Returns
    -------
    advance : callable
        advance(state, h, n=1) moves the state by n steps of size h. The last stage of a step and the first of the
        next are one, so that n steps cost n * scheme.stages kicks, and one more if the scheme starts with a kick.
    """
    flows: dict[Flow, Callable[[State, float], State]] = {"drift": drift, "kick": kick}

    def advance(state: State, h: float, n: int = 1) -> State:
        for flow, coefficient in _coalesced(scheme, n):
            state = flows[flow](state, coefficient * h)
        return state

    return advance


def _coalesced(scheme: Scheme, n: int) -> Iterator[tuple[Flow, float]]:
    """Yield the flows of n steps, where neighbouring steps share their outer stage."""
    if n < 1:
        return
    first, *inner, last = scheme.sequence
    yield first
    for _ in range(n - 1):
        yield from inner
        yield last[0], last[1] + first[1]
    yield from inner
    yield last
