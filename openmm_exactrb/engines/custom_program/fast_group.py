"""The force group that the fast forces have to themselves while a program needs it."""

from __future__ import annotations

import functools
import re
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import openmm

from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.multiple_time_steps.bonded import BONDED_FORCES, acts, groups_of
from openmm_exactrb.multiple_time_steps.excerpt import members

# The name of a force that was moved ends with the group that it came from.
_ENDING = " [of force group {}]"
_OWN = re.compile(r"^(.*) \[of force group (\d+)\]$", re.DOTALL)
# Where `Context.getState` has its argument `groups`.
_GROUPS = 8


def indices_of_fast(system: openmm.System, groups: Sequence[int] | None, active: int = -1) -> list[int]:
    """Return the indices of the forces of some groups, or without groups of bonded ones, in `active` groups (bits)."""
    named = _named(groups, active)
    wanted = acts if groups is not None else lambda force: isinstance(force, BONDED_FORCES)
    return [i for i, force in enumerate(system.getForces()) if wanted(force) and groups_of(force) & named]


def group_of(
    system: openmm.System, fast: Sequence[int], groups: Sequence[int] | None, active: int, sums: int
) -> int | None:
    """Return the force group that these forces have to themselves, or one that is free for them; None without any.

    `groups` and `active` are those of `indices_of_fast`, `sums` is the group of the sums over bodies.
    """
    forces = [(i, groups_of(force)) for i, force in enumerate(system.getForces()) if acts(force)]
    own = {group for i, of_force in forces if i in fast for group in of_force & _named(groups, active)}
    others = {group for i, of_force in forces if i not in fast for group in of_force}
    if len(own) == 1 and not own & others:
        return own.pop()
    if any(len(of_force) > 1 for i, of_force in forces if i in fast):  # of which only one could be moved
        return None
    return max(set(range(32)) - own - others - {sums}, default=None)


def slow_groups(system: openmm.System, fast: Sequence[int], group: int, active: int) -> list[int]:
    """Return the groups of all other forces, or parts of forces, than those that are fast in a group."""
    forces = [(i, groups_of(force)) for i, force in enumerate(system.getForces()) if acts(force)]
    slow = {g for i, of_force in forces if i not in fast or group in of_force for g in of_force} - {group}
    return sorted(g for g in slow if active >> g & 1)


def _named(groups: Sequence[int] | None, active: int) -> set[int]:
    return {group for group in (range(32) if groups is None else groups) if active >> group & 1}


def move(system: openmm.System, fast: Sequence[int], group: int) -> None:
    """Give forces a group, and names that record from where they came."""
    for force in map(system.getForce, fast):
        if force.getForceGroup() != group:
            force.setName(force.getName() + _ENDING.format(force.getForceGroup()))
            force.setForceGroup(group)


def restore(system: openmm.System) -> None:
    """Give forces their own groups and names back."""
    for force in system.getForces():
        if moved := _OWN.match(force.getName()):
            force.setName(moved[1])
            force.setForceGroup(int(moved[2]))


def restore_after(context: openmm.Context) -> Any:
    """Have `restore` called for the System of a Context when that is gone; return what is alive until then."""
    end = weakref.finalize(context, restore, context.getSystem())
    end.atexit = False
    return end


def answer(context: openmm.Context) -> None:
    """Have ``getState`` of a Context find the forces that were moved by the group that they came from.

    OpenMM has the groups that forces had when it made its kernels, whatever another Context of the System does. It
    raises ValueError if it is asked for some of the groups that they came from, but not for all.
    """
    method, moved = context.getState, _moved(context.getSystem())

    @functools.wraps(method)
    def finding(*arguments: Any, **options: Any) -> openmm.State:
        if "groups" in options:
            options["groups"] = _found(moved, options["groups"])
        elif len(arguments) > _GROUPS:
            arguments = (*arguments[:_GROUPS], _found(moved, arguments[_GROUPS]), *arguments[_GROUPS + 1 :])
        return method(*arguments, **options)

    context.getState = finding


def _moved(system: openmm.System) -> dict[int, int]:
    """Return the groups that forces were moved from, and to."""
    matches = ((_OWN.match(force.getName()), force) for force in system.getForces())
    return {int(own[2]): force.getForceGroup() for own, force in matches if own}


def _found(moved: Mapping[int, int], groups: Any) -> Any:
    """Return force groups, as bits or a set, with that of the forces that were moved from them."""
    asked = {group for group in range(32) if groups >> group & 1} if isinstance(groups, int) else set(groups)
    if moved.keys() <= asked:
        return groups if not moved else asked | {*moved.values()}
    if moved.keys() & asked:
        names = ", ".join(map(str, sorted(moved)))
        raise ValueError(
            f"the fast forces of groups {names} share one group while the engine on the device has the Context: "
            "request all of these groups, or one of them in a Context with another integrator"
        )
    return groups


def any_moved(system: openmm.System) -> bool:
    """Return whether forces of a System are in another group than their own."""
    return bool(_moved(system))


def unsupported(system: openmm.System, bodies: RigidBodies, fast: Sequence[int]) -> str | None:
    """Return why forces cannot be the fast ones of a program, or None: they act on rigid bodies or virtual sites."""
    sites = {i for i in range(system.getNumParticles()) if system.isVirtualSite(i)}
    owner, rigid = bodies.owner, bodies.n_turning
    if not (rigid or sites):
        return None
    for force in map(system.getForce, fast):
        if not isinstance(force, BONDED_FORCES):
            return (
                f"the fast forces include a {type(force).__name__}, which may act on rigid bodies: the device has "
                "inner steps for bonds, angles and torsions between other particles only"
            )
        for particles in members(force):
            touched = {int(owner[i]) for i in particles}
            turning = [body for body in touched if 0 <= body < rigid]
            if (turning and len(touched) > 1) or sites & set(particles):
                where = bodies.name(turning[0]) if turning else f"virtual site {min(sites & set(particles))}"
                return f"fast forces act on {where}, and the device has no inner steps for rigid bodies"
    return None
