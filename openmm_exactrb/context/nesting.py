"""Forces of some groups within the drifts of a scheme, in steps of their own: multiple time steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import openmm

from openmm_exactrb.checks import whole
from openmm_exactrb.context.bonded import acting, bonded_groups, fastest, groups_of
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import DRIFT, FAST, KICK, Word, nested

#: The longest time between two kicks of the fast forces, over the period of the fastest bond or angle by itself.
SHARE = 0.05
# Inner schemes for outer ones of order 2, and for those of higher order or with force gradients: there the errors of an
# inner scheme of order 2 would be what is left.
_COARSE, _FINE = "S2_2", "SRKN4_6b"


@dataclass(frozen=True)
class Nesting:
    """What a user wants within the drifts.

    Attributes
    ----------
    fast : "bonded" or tuple of int
        Force groups.
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
        if fast is None or fast == "bonded":
            return None if fast is None else cls("bonded", scheme, steps)
        if isinstance(fast, str) or not all(isinstance(g, int) and 0 <= g < 32 for g in fast) or not len(fast):
            raise ValueError(f'fast is None, "bonded" or force groups such as (1, 2), not {fast!r}')
        return cls(tuple(sorted(set(fast))), scheme, steps)

    def arguments(self) -> dict[str, Any]:
        """Return what an integrator that nests the same is made with."""
        return {"fast": self.fast, "inner": self.scheme, "innerSteps": self.steps}


@dataclass(frozen=True)
class Nested:
    """The same in a System.

    Attributes
    ----------
    groups : tuple of int
        Of the forces within the drifts.
    scheme : Scheme or None
    steps : int or None
    frequency : float
        The highest one of these forces, in 1/ps.
    """

    groups: tuple[int, ...]
    scheme: Scheme | None
    steps: int | None
    frequency: float

    @property
    def bits(self) -> int:
        """The force groups as OpenMM takes them."""
        return sum(1 << group for group in self.groups)

    def inner_steps(self, inner: Scheme, time: float) -> int:
        """Return how many inner steps the fast forces need in a time (ps), if nobody has told it."""
        return math.ceil(time * self.frequency / (2.0 * math.pi * SHARE * inner.stages))

    def put_into(self, scheme: Scheme, h: float) -> Scheme:
        """Return a scheme with the fast forces in its drifts, for steps of h (ps)."""
        if not self.groups:
            return scheme
        own = self.scheme or look_up(_COARSE if scheme.order <= 2 and not scheme.gradients else _FINE)
        inner = tuple((FAST if letter == KICK else letter, part) for letter, part in own.word)

        def within(word: Word) -> Word:
            return nested(word, DRIFT, inner, self.steps or (lambda part: self.inner_steps(own, part * abs(h))))

        return replace(scheme, word=within(scheme.word), processor=within(scheme.processor))


#: Nothing stands within the drifts.
UNNESTED = Nested((), None, None, 0.0)


def nested_in(system: openmm.System, nesting: Nesting) -> Nested:
    """Find in a System what is to be nested.

    Raises
    ------
    ValueError
        If groups have no forces, all forces are in them, or the number of inner steps has to be told.
    """
    groups = bonded_groups(system) if nesting.fast == "bonded" else tuple(map(int, nesting.fast))
    present = {group for force in acting(system) for group in groups_of(force)}
    for group in groups:
        if group not in present:
            raise ValueError(f"the System has no force in group {group}: fast must name groups that act")
    if present <= set(groups):
        raise ValueError("fast names all forces of the System: there is nothing left that could have longer steps")
    frequency = fastest(system, groups)
    if nesting.steps is None and not frequency:
        raise ValueError(
            f"the forces of groups {groups} have no harmonic bonds or angles that tell how fast they are: say how many "
            "inner steps a step needs with innerSteps="
        )
    return Nested(groups, nesting.scheme, nesting.steps, frequency)
