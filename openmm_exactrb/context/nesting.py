"""Forces within the drifts of a scheme, in steps of their own: what a user asks for, and what a System makes of it."""

from __future__ import annotations

import math
import operator
import reprlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import openmm

from openmm_exactrb.checks import whole
from openmm_exactrb.context.bonded import acting, groups_of, others
from openmm_exactrb.context.excerpt import Excerpt, bonded_excerpt
from openmm_exactrb.context.stiffness import fastest
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import BATH, DRIFT, GRADIENT, KICK

# Inner schemes, and the longest time between two kicks of the fast forces over the period of the fastest bond or angle:
# for outer schemes of order 2, and for those of higher order or with force gradients. These are for small errors, which
# with the first would be those of the inner scheme. With the second and a kick for each twentieth of the period they
# still were, of SRKN4_6b with 2000 evaluations of the other forces per ps (docs: Any molecule).
_COARSE, _FINE = ("S2_2", 0.05), ("SRKN4_6b", 0.0125)
# A force evaluation each such part of the period or more often, and every scheme shows its order and little error with
# bonded forces among the others: 1.5 fs where bonds to hydrogen are held, 0.6 fs where they are not.
_OFTEN = 1.0 / 16.0

#: What `fast` may be beside force groups: bonded forces where that helps; wherever there are some.
AUTO, BONDED = "auto", "bonded"


@dataclass(frozen=True)
class Nesting:
    """What a user wants within the drifts.

    Attributes
    ----------
    fast : "auto", "bonded" or tuple of int
        Bonded forces and pairs, where that helps or always, or force groups.
    scheme : Scheme or None
        Of the inner steps; None for one that suits the outer scheme.
    steps : int or None
        Inner steps a step; None for as many as the fastest bonds need.
    """

    fast: str | tuple[int, ...]
    scheme: Scheme | None = None
    steps: int | None = None

    @classmethod
    def of(cls, fast: str | Sequence[int] | None, inner: str | Scheme | None, steps: int | None) -> Nesting | None:
        """Return what arguments of a user ask for, None for nothing.

        Raises
        ------
        ValueError
            If they are of another kind.
        """
        scheme = None if inner is None else look_up(inner)
        if scheme is not None and ({letter for letter, _ in scheme.word} != {DRIFT, KICK} or scheme.processor):
            raise ValueError(f"the inner scheme {scheme.name} must be made of drifts and kicks alone, such as S2_2")
        if steps is not None:
            steps = whole(steps, "innerSteps")
        if fast is None:
            if scheme or steps:
                raise ValueError(
                    'inner and innerSteps are for nested forces: name these with fast="bonded", for example'
                )
            return None
        if isinstance(fast, str) and fast == AUTO and (scheme or steps):
            fast = BONDED  # inner steps that somebody tells are wanted
        return cls(fast if isinstance(fast, str) and fast in (AUTO, BONDED) else _groups(fast), scheme, steps)

    @property
    def certain(self) -> bool:
        """Whether something is nested whatever the System is."""
        return self.fast != AUTO

    @staticmethod
    def arguments(nesting: Nesting | None) -> dict[str, Any]:
        """Return what an integrator that nests the same is made with."""
        if nesting is None:
            return {"fast": None}
        return {"fast": nesting.fast, "inner": nesting.scheme, "innerSteps": nesting.steps}


def _groups(fast: Any) -> tuple[int, ...]:
    """Return the force groups that a user names, each once."""
    try:
        groups = {operator.index(group) for group in fast}
    except TypeError:  # a number, a force, or names
        groups = set()
    if not groups or not groups <= set(range(32)):
        raise ValueError(
            f'fast is "auto", None, "bonded" or force groups such as (1, 2), not {reprlib.repr(fast)}: '
            "force.getForceGroup() tells the one of a force"
        )
    return tuple(sorted(groups))


@dataclass(frozen=True)
class Nested:
    """The same in a System.

    Attributes
    ----------
    asked : Nesting
    frequency : float
        The highest one of the fast forces, in 1/ps.
    excerpt : Excerpt or None
        The bonded forces, if it is they; else the fast forces are those of some groups.
    """

    asked: Nesting
    frequency: float
    excerpt: Excerpt | None = None

    @property
    def bits(self) -> int:
        """The force groups of the fast forces as OpenMM takes them, where they are named."""
        return 0 if isinstance(self.asked.fast, str) else sum(1 << group for group in self.asked.fast)

    def inner(self, outer: Scheme) -> Scheme:
        """Return the inner scheme that an outer one has."""
        return self.asked.scheme or look_up(_usual(outer)[0])

    def repetitions(self, outer: Scheme, h: float) -> Callable[[float], int]:
        """Return what tells the inner steps in a drift from its time (ps), in steps of h (ps) of the outer scheme."""
        if self.asked.steps:
            rate = self.asked.steps / abs(h) if h else 0.0
            return lambda tau: max(1, round(rate * abs(tau)))
        rate = self.frequency / (2.0 * math.pi * _usual(outer)[1] * self.inner(outer).stages)
        return lambda tau: max(1, math.ceil(rate * abs(tau)))

    def acts(self, outer: Scheme, h: float, known: bool = True) -> bool:
        """Tell whether the fast forces have kicks of their own in steps of h (ps).

        They have if they were asked for, or if those of the outer scheme come too rarely and it is `known` what its
        letters do.

        Raises
        ------
        ValueError
            If a letter kicks a force group that is nested, or one that may have bonded forces where these are.
        """
        groups = sorted({letter for letter, _ in outer.word if letter[0] == KICK and letter != KICK})
        if self.asked.fast == BONDED and groups:
            raise ValueError(
                f"scheme {outer.name} kicks force groups by themselves ({', '.join(groups)}), which may have bonded "
                "forces in them: name what is nested by a group that no letter kicks, such as fast=(7,)"
            )
        twice = [letter for letter in groups if letter[1:].isdecimal() and self.bits >> int(letter[1:]) & 1]
        if twice:
            raise ValueError(
                f"scheme {outer.name} kicks by itself what is nested in its drifts ({', '.join(twice)}), which would "
                "act twice: take its group out of fast=, or the letter out of the word"
            )
        if self.asked.certain or not (outer.stages and known):
            return self.asked.certain
        ours = all(letter in (DRIFT, KICK) or letter[0] in (GRADIENT, BATH) for letter, _ in outer.word)
        return ours and abs(h) / outer.stages * self.frequency / (2.0 * math.pi) > _OFTEN


def _usual(outer: Scheme) -> tuple[str, float]:
    return _COARSE if outer.order <= 2 and not outer.gradients else _FINE


def nested_in(system: openmm.System, bodies: RigidBodies, nesting: Nesting | None) -> Nested | None:
    """Find in a System what is to be nested.

    Raises
    ------
    ValueError
        If groups have no forces, all forces are in them, or the number of inner steps has to be told.
    """
    if nesting is None:
        return None
    return _bonded(system, bodies, nesting) if isinstance(nesting.fast, str) else _of_groups(system, nesting)


def _bonded(system: openmm.System, bodies: RigidBodies, nesting: Nesting) -> Nested | None:
    excerpt = bonded_excerpt(system, bodies)
    frequency = 0.0 if excerpt is None else fastest(excerpt.system)
    if not nesting.certain:
        return Nested(nesting, frequency, excerpt) if frequency and others(system) else None
    if excerpt is None:
        raise ValueError(
            "the System has no bonded forces that move anything, and nothing to be nested: leave fast=, inner= and "
            "innerSteps= away"
        )
    if not others(system):
        raise ValueError(
            "all forces of the System are bonded, and nothing is left that could have longer steps: leave fast=, "
            "inner= and innerSteps= away"
        )
    _refuse_unknown(frequency, nesting, "bonded forces")
    return Nested(nesting, frequency, excerpt)


def _of_groups(system: openmm.System, nesting: Nesting) -> Nested:
    groups = tuple(map(int, nesting.fast))
    present = {group for force in acting(system) for group in groups_of(force)}
    for group in groups:
        if group not in present:
            raise ValueError(f"the System has no force in group {group}: fast must name groups that act")
    if present <= set(groups):
        raise ValueError("fast names all forces of the System: there is nothing left that could have longer steps")
    frequency = fastest(system, groups)
    _refuse_unknown(frequency, nesting, f"forces of groups {groups}")
    return Nested(nesting, frequency)


def _refuse_unknown(frequency: float, nesting: Nesting, what: str) -> None:
    if nesting.steps is None and not frequency:
        raise ValueError(
            f"the {what} have no bonds or harmonic angles that tell how fast they are: say how many inner steps a step "
            "needs with innerSteps="
        )
