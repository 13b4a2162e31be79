"""Forces of some groups within the drifts of a scheme, in steps of their own: multiple time steps."""

from __future__ import annotations

import math
import operator
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import openmm

from openmm_exactrb.checks import whole
from openmm_exactrb.context.bonded import acting, bonded_groups, fastest, groups_of
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import DRIFT, FAST, KICK, Word, nested

# Inner schemes, and the longest time between two kicks of the fast forces over the period of the fastest bond or angle:
# for outer schemes of order 2, and for those of higher order or with force gradients. These are for small errors, which
# with the first would be those of the inner scheme. With the second and a kick for each twentieth of the period they
# still were, of SRKN4_6b with 2000 evaluations of the other forces per ps (docs: Any molecule).
_COARSE, _FINE = ("S2_2", 0.05), ("SRKN4_6b", 0.0125)


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
        if fast is None:
            if scheme or steps:
                raise ValueError(
                    'inner and innerSteps are for nested forces: name these with fast="bonded", for example'
                )
            return None
        return cls("bonded" if isinstance(fast, str) and fast == "bonded" else _groups(fast), scheme, steps)

    def arguments(self) -> dict[str, Any]:
        """Return what an integrator that nests the same is made with."""
        return {"fast": self.fast, "inner": self.scheme, "innerSteps": self.steps}


def _groups(fast: Any) -> tuple[int, ...]:
    """Return the force groups that a user names, each once."""
    try:
        groups = {operator.index(group) for group in fast}
    except TypeError:  # a number, a force, or names
        groups = set()
    if not groups or not groups <= set(range(32)):
        raise ValueError(
            f'fast is None, "bonded" or force groups such as (1, 2), not {reprlib.repr(fast)}: force.getForceGroup() '
            "tells the one of a force"
        )
    return tuple(sorted(groups))


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

    def put_into(self, scheme: Scheme, h: float) -> Scheme:
        """Return a scheme with the fast forces in its drifts, for steps of h (ps)."""
        if not self.groups:
            return scheme
        usual, share = _COARSE if scheme.order <= 2 and not scheme.gradients else _FINE
        own = self.scheme or look_up(usual)
        kicks = abs(h) * self.frequency / (2.0 * math.pi * share)  # in a step
        inner = tuple((FAST if letter == KICK else letter, part) for letter, part in own.word)

        def within(word: Word) -> Word:
            return nested(word, DRIFT, inner, self.steps or (lambda part: math.ceil(part * kicks / own.stages)))

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
