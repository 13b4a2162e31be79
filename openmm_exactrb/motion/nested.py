"""Multiple time steps: some bodies have a drift with kicks of its own, made of shorter steps."""

from __future__ import annotations

from collections.abc import Callable

from openmm_exactrb.motion.engine import Flow, run
from openmm_exactrb.motion.part import Portion
from openmm_exactrb.motion.state import State
from openmm_exactrb.schemes.word import DRIFT, KICK, Word, repeated


def nested_drift(
    all_drift: Flow[State] | None,
    portion: Portion,
    drift: Flow[State],
    kick: Flow[State],
    word: Word,
    repetitions: Callable[[float], int],
) -> Flow[State]:
    """Return a drift in which fast forces act on some bodies.

    M. Tuckerman, B. J. Berne and G. J. Martyna, J. Chem. Phys. 97, 1990 (1992), doi:10.1063/1.463137: the drift of the
    outer scheme is the flow of the kinetic energy and of a potential, which has a splitting of its own. Bodies that
    this potential does not move have no part in it, so that their drift is one.

    Parameters
    ----------
    all_drift : callable or None
        Free motion of all bodies, which the others keep; None where there are no others.
    portion : Portion
        The bodies that the fast forces move.
    drift : callable
        Their free motion.
    kick : callable
        The flow of the fast forces on them.
    word : Word
        Of the inner scheme, drifts and kicks.
    repetitions : callable
        repetitions(tau) -> inner steps in a drift of this time.
    """
    moves = {DRIFT: drift, KICK: kick}
    words: dict[int, Word] = {}

    def flow(state: State, tau: float) -> State:
        n = repetitions(tau)
        if n not in words:
            words[n] = repeated(word, n)
        inner = run(words[n], moves, portion.of(state), tau / n)
        return portion.into(state if all_drift is None else all_drift(state, tau), inner)

    return flow
