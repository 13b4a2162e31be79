"""Multiple time steps: the settings of fast forces within the drifts of a scheme, and the fast forces of a System."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import openmm

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.multiple_time_steps.bonded import acting, groups_of, others
from openmm_exactrb.multiple_time_steps.excerpt import Excerpt, bonded_excerpt
from openmm_exactrb.multiple_time_steps.stiffness import LIBRATION, fastest
from openmm_exactrb.schemes.catalogue import scheme as look_up
from openmm_exactrb.schemes.scheme import Scheme, symmetric
from openmm_exactrb.steps.substeps import DRIFT, KICK, Drift, GradientKick, HeatExchange, Kick
from openmm_exactrb.support.checks import whole
from openmm_exactrb.support.messages import shown
from openmm_exactrb.support.types import Array
from openmm_exactrb.support.warn import warn

# Inner schemes, and the longest time between two kicks by the fast forces as a fraction of the shortest period of the
# normal modes. The pairs are for outer schemes of order 2, for those of higher order or with force gradients, and for
# those of order 2 with a heat exchange within the step, whose drifts have equal or unequal lengths. High-order outer
# schemes need a finer inner scheme: with S2_2, or with SRKN4_6b at 16 kicks per period, the error of the inner steps
# dominated at 2000 outer force evaluations per ps. Schemes with a heat exchange within the step
# are used for averages. With 0.198 instead of the 0.193 of S2_2, the mean energies of the bonds and of the angles of a
# protein have errors of opposite signs of at most 0.15 %, and the energy of a mode has one of at most 1.8 %. Drifts of
# unequal lengths are different maps for the same mode, and the exchange of energy between the maps is driven near
# multiples of half a period. S2_4 is nearly exact there, at the cost of two steps of S2_2
# (benchmarks/proteins/inner_energies.py).
_BETWEEN_EXCHANGES = symmetric("S2_2 with b = 0.198", order=2, stages=2, first="kick", b=(0.198,))
_SECOND_ORDER, _HIGHER_ORDER = ("S2_2", 1.0 / 16.0), ("SRKN4_6b", 1.0 / 64.0)
_EQUAL_DRIFTS, _UNEQUAL_DRIFTS = (_BETWEEN_EXCHANGES, 1.0 / 8.4), ("S2_4", 1.0 / 7.5)
# The longest time between force evaluations, as a fraction of the shortest period, at which every scheme without inner
# steps converges with its order and has a small error. This time is 1.2 fs if bonds to hydrogen are constrained,
# otherwise 0.6 fs.
_LONGEST_PLAIN = 1.0 / 16.0

_NO_PERIOD = (
    "the fast forces have no bonds, and no harmonic angles between bonds of known length, so the fastest period is "
    "unknown: set the number of inner steps per step with innerSteps="
)
_NO_INNER_STEPS = "there are no inner steps, because "
#: Values of `fast` other than force groups: bonded forces are fast where this is useful, or wherever they exist.
AUTO, BONDED = "auto", "bonded"


@dataclass(frozen=True)
class MultipleTimeSteps:
    """The user's settings for fast forces.

    Attributes
    ----------
    fast : "auto", "bonded" or tuple of int
        With "auto", bonded forces and exceptions are fast where inner steps are useful; with "bonded", they are always
        fast. A tuple contains the fast force groups.
    scheme : Scheme or None
        Scheme of the inner steps; None for the default of the outer scheme.
    steps : int or None
        Number of inner steps per step; None for the number that the fastest normal mode needs.
    """

    fast: str | tuple[int, ...]
    scheme: Scheme | None = None
    steps: int | None = None

    @classmethod
    def of(
        cls, fast: str | Sequence[int] | None, inner: str | Scheme | None, steps: int | None
    ) -> MultipleTimeSteps | None:
        """Return settings for an integrator's arguments, or None if fast=None; raise ValueError for invalid ones."""
        scheme = None if inner is None else look_up(inner)
        if scheme is not None and ({substep for substep, _ in scheme.sequence} != {DRIFT, KICK} or scheme.processor):
            raise ValueError(
                f"the inner scheme {scheme.name} must consist only of drifts and kicks, without a processor: choose a "
                "scheme such as S2_2"
            )
        if steps is not None:
            steps = whole(steps, "innerSteps")
        if fast is None:
            if scheme or steps:
                raise ValueError(
                    'inner= and innerSteps= have no effect with fast=None: omit them, or pass fast="bonded"'
                )
            return None
        if isinstance(fast, str) and fast == AUTO and (scheme or steps):
            fast = BONDED  # settings of inner steps request inner steps
        return cls(fast if isinstance(fast, str) and fast in (AUTO, BONDED) else _groups(fast), scheme, steps)

    @property
    def asked_for(self) -> bool:
        """Whether inner steps were requested, so that they are used for every System."""
        return self.fast != AUTO

    @staticmethod
    def arguments(settings: MultipleTimeSteps | None) -> dict[str, Any]:
        """Return the keyword arguments of an integrator with these settings."""
        if settings is None:
            return {"fast": None}
        return {"fast": settings.fast, "inner": settings.scheme, "innerSteps": settings.steps}


def _groups(fast: Any) -> tuple[int, ...]:
    """Return the sorted force groups of the argument `fast`; raise ValueError for any other argument."""
    try:
        groups = {operator.index(group) for group in fast}
    except TypeError:  # such as a number, a force or names
        groups = set()
    if not groups or not groups <= set(range(32)):
        raise ValueError(
            f'fast must be "auto", None, "bonded" or force groups from 0 to 31, such as (1, 2), not {shown(fast)}: '
            "call force.getForceGroup() for the group of a force"
        )
    return tuple(sorted(groups))


@dataclass(frozen=True)
class FastForces:
    """The fast forces of a System.

    Attributes
    ----------
    settings : MultipleTimeSteps
    frequency : float
        The highest frequency of the normal modes of the fast forces, in 1/ps.
    excerpt : Excerpt or None
        The bonded forces if these are fast, or None if the fast forces are defined by force groups.
    """

    settings: MultipleTimeSteps
    frequency: float
    excerpt: Excerpt | None = None

    @property
    def named(self) -> tuple[int, ...]:
        """The fast force groups that the user named, or an empty tuple if bonded forces are fast."""
        return () if isinstance(self.settings.fast, str) else self.settings.fast

    @property
    def groups(self) -> int:
        """The named force groups, as a bit mask."""
        return sum(1 << group for group in self.named)

    def inner(self, outer: Scheme) -> Scheme:
        """Return the inner scheme for an outer scheme."""
        return self.settings.scheme or look_up(_usual(outer)[0])

    def repetitions(self, outer: Scheme, h: float) -> Callable[[float], int]:
        """Return a function that gives the number of inner steps of a drift over a time (ps) within a step h (ps)."""
        if self.settings.steps:
            rate = self.settings.steps / abs(h) if h else 0.0
            return cache(lambda tau: max(1, round(rate * abs(tau))))
        rate = self.frequency / (2.0 * math.pi * _usual(outer)[1] * self.inner(outer).stages)
        return cache(lambda tau: max(1, math.ceil(rate * abs(tau))))

    def acts(self, outer: Scheme, h: float) -> bool:
        """Return whether an outer scheme with the step size h (ps) has inner steps.

        Inner steps are used if they were requested, or if the outer scheme consists of substeps of this package and its
        force evaluations are too far apart for bonded forces. A ValueError is raised if a kick by a single force group
        applies a fast group, or may apply bonded forces that are fast.
        """
        groups = sorted({s.group for s, _ in outer.sequence if isinstance(s, Kick) and s.group is not None})
        if self.settings.fast == BONDED and groups:
            raise ValueError(
                f"scheme {outer.name} has kicks with single force groups ({', '.join(map(str, groups))}), which may "
                "contain bonded forces: put the fast forces into a group that no kick uses, and name this group in "
                "fast=, such as fast=(7,)"
            )
        twice = [group for group in groups if group in self.named]
        if twice:
            raise ValueError(
                f"scheme {outer.name} has a kick with force group {twice[0]} alone, but fast= also names this group, "
                "so its forces would act twice: remove the group from fast= or from the scheme"
            )
        if self.settings.asked_for or not outer.stages:
            return self.settings.asked_for
        known = all(type(s) in (Drift, GradientKick, HeatExchange) or s == KICK for s, _ in outer.sequence)
        return known and abs(h) / outer.stages * self.frequency / (2.0 * math.pi) > _LONGEST_PLAIN


def _usual(outer: Scheme) -> tuple[str | Scheme, float]:
    """Return the default inner scheme of an outer scheme, and the longest time between two of its kicks in periods."""
    if outer.order > 2 or outer.has_gradients:
        return _HIGHER_ORDER
    if not any(isinstance(substep, HeatExchange) for substep, _ in outer.sequence):
        return _SECOND_ORDER
    return _EQUAL_DRIFTS if len(set(outer.a)) == 1 else _UNEQUAL_DRIFTS


def fast_forces(
    system: openmm.System, bodies: RigidBodies, settings: MultipleTimeSteps | None, masses: Array
) -> FastForces | None:
    """Return the fast forces of a System, or None if there are no fast forces.

    The masses (n_particles,) include those of virtual sites; see `virtual_sites.masses`.

    Raises
    ------
    ValueError
        If all forces of the System are fast, or if ``innerSteps`` is required but not given.

    Warns
    -----
    UserWarning
        If the named groups contain no bonded forces and no number of inner steps is given, so that there are no inner
        steps.
    """
    if settings is None:
        return None
    if isinstance(settings.fast, str):
        return _bonded(system, bodies, settings, masses)
    return _of_groups(system, settings, masses)


def _bonded(
    system: openmm.System, bodies: RigidBodies, settings: MultipleTimeSteps, masses: Array
) -> FastForces | None:
    excerpt = bonded_excerpt(system, bodies)
    if excerpt is not None and not settings.asked_for:
        on_sites = excerpt.on_sites
        if on_sites and fastest(system, forces=on_sites, masses=masses) < LIBRATION:  # kernels are faster without them
            excerpt = bonded_excerpt(system, bodies, sites=False)
    frequency = 0.0 if excerpt is None else fastest(system, forces=excerpt.forces, masses=masses)
    if not settings.asked_for:
        return FastForces(settings, frequency, excerpt) if frequency and others(system) else None
    if excerpt is None:
        raise ValueError(
            "the System contains no bonded forces that change its motion, so inner steps have no effect: omit "
            "fast=, inner= and innerSteps="
        )
    if not others(system):
        raise ValueError(
            "all forces of the System are bonded, so no forces remain for the outer steps: omit fast=, inner= and "
            "innerSteps="
        )
    if settings.steps is None and not frequency:
        raise ValueError(_NO_PERIOD)
    return FastForces(settings, frequency, excerpt)


def _of_groups(system: openmm.System, settings: MultipleTimeSteps, masses: Array) -> FastForces | None:
    present = {group for force in acting(system) for group in groups_of(force)}
    groups = tuple(group for group in map(int, settings.fast) if group in present)
    if not groups:
        warn(
            f"{_NO_INNER_STEPS}the force groups in fast= ({', '.join(map(str, settings.fast))}) contain no forces: "
            f"choose from the force groups of this System ({', '.join(map(str, sorted(present))) or 'none'})"
        )
        return None
    if present <= set(groups):
        raise ValueError(
            "fast= names all forces of the System, so no forces remain for the outer steps: name fewer groups, or omit "
            "fast="
        )
    frequency = fastest(system, groups, masses=masses)
    if not frequency and settings.steps is None:
        warn(f"{_NO_INNER_STEPS}{_NO_PERIOD}")
        return None
    return FastForces(settings, frequency)
