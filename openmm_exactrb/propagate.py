"""Compose a scheme with the two flows of a problem: the only loop over stages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import TypeVar

from openmm_exactrb.schemes import Flow, Scheme

State = TypeVar("State")


Move = Callable[[State, float], State]


def compose(
    scheme: Scheme, drift: Move[State], kick: Move[State], gradient: Move[State] | None = None
) -> Callable[..., State]:
    """Return the splitting integrator of a scheme.

    Parameters
    ----------
    scheme : Scheme
    drift, kick : callable
        drift(state, tau) and kick(state, tau) return the state moved by the flow of T or of V over the time tau.
    gradient : callable, optional
        The same for the force-gradient potential f . M^-1 f, which only some schemes need.

    Returns
    -------
    advance : callable
        advance(state, h, n=1) moves the state by n steps of size h. The last stage of a step and the first of the
        next are one, so that n steps cost n * scheme.stages kicks, and one more if the scheme starts with a kick.
        A processed scheme prepares the state before them and finishes it after them, for `scheme.processing` kicks.

    Raises
    ------
    ValueError
        If the scheme has force-gradient kicks and there is no `gradient`.
    """
    if scheme.c and gradient is None:
        raise ValueError(
            f"scheme {scheme.name} needs force-gradient kicks, which this problem has not: choose another scheme"
        )

    def advance(state: State, h: float, n: int = 1) -> State:
        flows = chain(scheme.processor, _coalesced(scheme, n), scheme.postprocessor) if n else ()
        return move(flows, state, h, drift, kick, gradient)

    return advance


def move(
    flows: Iterable[tuple[Flow, float]],
    state: State,
    h: float,
    drift: Move[State],
    kick: Move[State],
    gradient: Move[State] | None = None,
) -> State:
    """Move a state by a sequence of flows with their coefficients, as part of steps of size h."""
    for flow, coefficient in flows:
        if flow == "drift":
            state = drift(state, coefficient * h)
        elif flow == "kick":
            state = kick(state, coefficient * h)
        else:
            assert gradient is not None
            state = gradient(state, coefficient * h**3)
    return state


def _coalesced(scheme: Scheme, n: int) -> Iterator[tuple[Flow, float]]:
    """Yield the flows of n steps, where neighbouring steps share their outer stage."""
    first, *inner, last = scheme.sequence
    yield first
    for _ in range(n - 1):
        yield from inner
        yield last[0], last[1] + first[1]
    yield from inner
    yield last
