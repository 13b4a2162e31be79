"""What the letters of a word do in a Context: a table from their first character to what makes their flow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from openmm_exactrb.context.account import Account
from openmm_exactrb.context.clock import Clock
from openmm_exactrb.context.forces import Forces, Kicks
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.guard import Guard
from openmm_exactrb.motion.kick import gradient_kick, kick
from openmm_exactrb.motion.kinetic import Kinetic
from openmm_exactrb.motion.state import State
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import DRIFT, GRADIENT, KICK, Word


@dataclass(frozen=True)
class Parts:
    """What flows are made of, for one call of `step`.

    Attributes
    ----------
    bodies : RigidBodies
    kinetic : Kinetic
        With what is nested in its drift.
    forces : Forces
        Those of all force groups that act.
    slow : Kicks
        Those of the kicks of a scheme: all that are not nested in its drifts.
    guard : Guard
    scheme : Scheme
    clock : Clock
        Whose number is that of the last step that was made.
    account : Account
        What a run adds up.
    """

    bodies: RigidBodies
    kinetic: Kinetic
    forces: Forces
    slow: Kicks
    guard: Guard
    scheme: Scheme
    clock: Clock
    account: Account


#: maker(parts, letters) -> the flows of all letters of a word that begin with one character.
Maker = Callable[[Parts, set[str]], dict[str, Flow[State]]]


def _drifts(parts: Parts, letters: set[str]) -> dict[str, Flow[State]]:
    return {DRIFT: parts.kinetic.drift}


def _kicks(parts: Parts, letters: set[str]) -> dict[str, Flow[State]]:
    """Make "B", a kick of the forces that are not nested, and "B3" of those of group 3."""
    forces = {letter: parts.slow if letter == KICK else parts.forces.of(1 << int(letter[1:])) for letter in letters}
    return {letter: parts.guard.finite(kick(forces[letter])) for letter in letters}


def _gradient_kicks(parts: Parts, letters: set[str]) -> dict[str, Flow[State]]:
    strengths, bodies = dict(parts.scheme.gradients), parts.bodies
    here, there = parts.slow, parts.slow.twin()
    kicks = {
        letter: gradient_kick(here, there, parts.kinetic, bodies.inertia.T, strengths[letter]) for letter in letters
    }
    return {letter: parts.guard.finite(flow) for letter, flow in kicks.items()}


#: The letters of the package by their first character.
LETTERS: Mapping[str, Maker] = MappingProxyType({DRIFT: _drifts, KICK: _kicks, GRADIENT: _gradient_kicks})


def flows(word: Word, parts: Parts, makers: Mapping[str, Maker]) -> dict[str, Flow[State]]:
    """Return the flows of the letters of a word.

    Raises
    ------
    ValueError
        If nobody makes one of them.
    """
    made: dict[str, Flow[State]] = {}
    names = {letter for letter, _ in word}
    for first in sorted({letter[0] for letter in names}):
        if first not in makers:
            raise ValueError(
                f"scheme {parts.scheme.name} has the letter {first!r}, which nobody has told this integrator: "
                f"call addLetter({first!r}, maker) first"
            )
        made |= makers[first](parts, {letter for letter in names if letter[0] == first})
    return made
