"""A turn of the loop where OpenMM's constraints close the drifts, which may have fast forces within them.

The particles of constrained clusters move alone: constraints change where they arrive, and so their momenta. That is a
step of RATTLE, by H. C. Andersen, J. Comput. Phys. 52, 24 (1983), doi:10.1016/0021-9991(83)90014-1, for the free
motion: what a kick, or the noise, adds to momenta along the bonds is taken out by the next drift, whose multipliers
stand along the same gradients. Only what is shown needs the constraints of velocities.

Rigid bodies feel no fast force, so that they turn once in a drift of the scheme, and inner steps need neither sums nor
the rotor. Constraints touch them too, with lengths in single precision, so that they are put back before all forces
are evaluated, and at the end of a step.

The drift is the first block that writes positions, since what is written before the last ``addConstrainPositions`` is
kept as differences. Its end is in the positions alone until the next kernel takes it up, which saves one.
"""

from __future__ import annotations

from openmm_exactrb.engines.custom_program import names
from openmm_exactrb.engines.custom_program.noise import exchange
from openmm_exactrb.engines.custom_program.program import ALONE, AXES, Program, turned_back
from openmm_exactrb.engines.custom_program.rotor import rotate
from openmm_exactrb.engines.custom_program.stages import (
    NEXT,
    PLACE,
    gather_forces,
    kick_by_last_forces,
    placed,
    remember,
    show,
    show_bodies,
)


def turn(program: Program) -> None:
    """Write a turn of the loop, which is a row."""
    table = program.table
    has = {part: f"(1-{program.is_zero(part)})" for part in ("before", "long", "kick", "moves", "acts")}
    program.number(names.ROW, names.INDEX)
    program.number(names.KNOWN, f"{names.KNOWN}*{program.is_zero('drift')}")
    program.number(names.NEEDED, f"(1-{names.KNOWN})*{has['kick']}")
    if table.has("before"):
        with program.when(f"{has['before']} > 0"):
            _take_up_drift(program)
            exchange(program, "before")
    with program.when(f"{has['long']} > 0"):
        _drift_of_bodies(program)
    sites = f"{names.SITES}*max({has['long']},{names.NEEDED}*delta({names.INDEX}-{names.FIRST}))"
    with program.when(f"max({has['moves']},{sites}) > 0"):
        _drift(program)
    with program.when(f"{names.NEEDED} > 0"):
        _take_up_drift(program)
        program.let("x", PLACE)
        gather_forces(program)
        _kick(program, evaluated=True)
        program.let("x", PLACE)
    with program.when(f"(1-{names.NEEDED})*{has['acts']} > 0"):
        _take_up_drift(program)
        _kick(program, evaluated=False)
    program.number(names.EVALUATED, f"{names.EVALUATED}+{names.NEEDED}")
    program.number(names.KNOWN, f"max({names.KNOWN},{names.NEEDED})")
    program.number(names.INDEX, f"{names.INDEX}+1")


def end(program: Program) -> None:
    """Write what a step shows."""
    _take_up_drift(program)
    show(program)
    program.let("x", PLACE)
    if program.clusters:
        program.integrator.addConstrainVelocities()
        show_bodies(program, constrained=True)


def _drift_of_bodies(program: Program) -> None:
    """Write the drift of rigid bodies, in as many rotations as it needs."""
    program.number(names.TURN, "0.0")
    with program.loop(f"{names.TURN} < {names.TURNS}"):
        program.times("c", (("long", "1"),) * 3)
        program.let("R", f"R+(1-{ALONE})*c*_z(shape)*P*_y(inverse)")
        rotate(program, "(_x(c)*_z(shape))")
        program.number(names.TURN, f"{names.TURN}+1")


def _drift(program: Program) -> None:
    """Write the kick by the fast forces and the drift of the particles that are alone; either may be zero."""
    _take_up_drift(program)
    program.times("c", (("fast", "1"), ("drift", "1"), ("acts", "1")))
    if program.fast is not None:
        program.let("v", f"f{program.fast}")
        program.let("P", f"P+_x(c)*{ALONE}*v")
    program.let(names.PENDING, "_y(c)")
    program.let(names.SPAN, f"select(_z(c),at,{NEXT})")
    placed(program)
    program.place(f"{PLACE}+{ALONE}*{names.PENDING}*P*_y(inverse)", program.fast)
    program.integrator.addConstrainPositions()


def _take_up_drift(program: Program) -> None:
    """Write R and P behind a drift whose end is in x alone."""
    if program.clusters:
        program.let("p", "x-d-image-R")
        program.let("P", f"select({names.CLUSTERED}*{names.PENDING},p/({names.PENDING}*_y(inverse)),P)")
    program.let("R", f"R+{ALONE}*{names.PENDING}*P*_y(inverse)")
    program.let(names.PENDING, f"0*{names.PENDING}")


def _kick(program: Program, evaluated: bool) -> None:
    """Write the kick by all but the fast forces, which may have been `evaluated` for it, and by those of last kicks."""
    program.times("c", (("kick", "1"),) * 3)
    program.let("P", "P+c*F")
    torque = turned_back("q", "w", "N")
    program.let("L", f"L+c*{AXES}*{torque}")
    if any(program.table.memory):
        if evaluated:
            remember(program, torque)
        kick_by_last_forces(program)
    program.let(names.SPAN, NEXT)
