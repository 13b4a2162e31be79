"""The program of a scheme: a loop over the rows of its table.

A turn of the loop carries out a row: a kick, the thermostat before or after it, and the drift that follows; where
OpenMM's constraints close the drifts it is that of `openmm_exactrb.engines.custom_program.constrained`. Rows are data
on the device, so that all schemes share the same kernels, whatever their length, and no host-to-device transfer, and
so no synchronisation, is needed within a step.

Three properties of OpenMM determine the order of statements. Neighbouring statements become one kernel if they need
forces of the same group, or none and the next forces that are needed are of this group; a statement that writes
positions ends the kernel. A kernel that computes any per-DOF variable reads and writes all of them; a kernel that
computes only positions and velocities does not. And if the System has constraints, positions that are written before
the last ``addConstrainPositions`` of a program are kept as differences, which forces do not see; hence the one for
virtual sites is the first statement of the loop, and nothing writes positions before it.

OpenMM analyses every path through two passes of a program, with two passes of its loop in each. One more block that
writes positions multiplies the number of paths, so numbers are multiplied by conditions where that suffices.
"""

from __future__ import annotations

import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.engines.custom_program import constrained, names
from openmm_exactrb.engines.custom_program.noise import exchange
from openmm_exactrb.engines.custom_program.program import AXES, INVERSE_INERTIA, Layout, Program, turned, turned_back
from openmm_exactrb.engines.custom_program.rotor import rotate
from openmm_exactrb.engines.custom_program.rows import STAGES
from openmm_exactrb.engines.custom_program.stages import (
    MOMENTUM,
    MOVE,
    NEXT,
    PLACE,
    STILL,
    gather_forces,
    kick_by_last_forces,
    placed,
    remember,
    show,
    show_bodies,
    sum_over_bodies,
    take_up_images,
)

# The time of a drift where "c" holds times.
_DRIFT = "(_y(c)*_z(shape))"
_DISPLACED_PLACE = "R+move+d+image"
_PARTS = (("kick", "begins"), ("drift", "1"), ("shift", "ends"))


def declare(integrator: openmm.CustomIntegrator, layout: Layout) -> None:
    """Give an integrator without a Context the variables and the program of a scheme.

    Until bodies are loaded, steps make positions nan.
    """
    program, table = Program(integrator, layout), layout.table
    program.numbers(0.0, names.LOADED)
    variables.declare_numbers(integrator)
    _declare_variables(program)
    with program.when(f"{names.CHANGED} > 0"):
        program.let(names.SPAN, f"vector({names.FIRST},{names.FIRST},{names.LAST})")
        program.number(names.PACE, f"1/{names.TURNS}")
        program.let("shape", f"vector(_x(shape),_y(shape),{names.PACE})")
        if table.has_thermostat:
            one, other = (f"vector({','.join(of)},{names.KT})" for of in (names.FLEXIBLE_FRICTIONS, names.FRICTIONS))
            program.let(names.THERMOSTAT, f"select({names.FLEXIBLE},{one},{other})")
        if table.continues:
            _keep_or_return(program)
        program.number(names.CHANGED, "0.0")
    program.number(names.INDEX, names.FIRST)
    if table.constrained:
        take_up_images(program)
    with program.loop(f"{names.INDEX} < {names.LAST}+1"):
        (constrained.turn if table.constrained else _turn)(program)
    if table.constrained:
        constrained.end(program)
    _openmm(program)
    with program.when(f"{names.ASKED} > 0"):
        program.total(names.FASTEST, f"(_x(abc)*sqrt(dot(L,L)))^{names.POWER}")


def _declare_variables(program: Program) -> None:
    table = program.table
    program.vectors(*names.STATE, *names.CONSTANTS, names.SPAN, *names.FORCES, *names.TEMPORARY)
    program.numbers(0.0, names.SITES, names.BAROSTAT, names.PUSHED, names.ASKED)
    program.numbers(0.0, names.INDEX, names.ROW, names.NEEDED, names.KNOWN, names.MOVED, names.FASTEST)
    program.numbers(0.0, names.EVALUATED, names.KEEP, names.RETURN)
    program.numbers(1.0, names.TURNS, names.PACE, names.CHANGED)
    first, last = table.span(1, False, *(("enter", "leave") if table.enter else ("step", "step")))
    program.numbers(first, names.FIRST)
    program.numbers(last, names.LAST)
    if table.constrained:
        program.vectors(names.PENDING, names.CLUSTERED)
        program.numbers(0.0, names.TURN)
    if table.displaces:
        program.vectors(*names.DISPLACED)
        program.numbers(0.0, names.SHIFTED, names.WAS)
    if table.continues:
        program.vectors(*names.INNER, names.LAG, *(name for k in range(sum(table.memory)) for name in names.last(k)))
    if table.has_thermostat:
        program.vectors(names.THERMOSTAT, *names.STREAMS, names.FLEXIBLE)
        program.numbers(0.0, names.KT, *names.FRICTIONS, *names.FLEXIBLE_FRICTIONS, names.SEEDED, names.FLAGGED)
    for name, column in zip(names.TABLES, table.columns(), strict=True):
        program.integrator.addTabulatedFunction(name, openmm.Discrete1DFunction(column))


def _keep_or_return(program: Program) -> None:
    """Write that the inner state is kept, or returned to from the output that was shown; x stays what it is.

    Numbers that are not finite, of a call that failed, are not multiplied by zero: they would stay.
    """
    state = [name for name in names.STATE if name != "image"]
    for name, inner in zip(state, names.INNER, strict=True):
        program.let(inner, f"select({names.KEEP},{name},{inner})")
    program.let(names.LAG, f"select({names.RETURN},R+d-iR-id,vector(0,0,0))")
    for name, inner in zip(state, names.INNER, strict=True):
        program.let(name, f"select({names.RETURN},{inner},{name})")
    if program.table.displaces:
        program.let("sq", "q")
        program.let("sw", "w")
    program.number(names.KEEP, "0.0")
    program.number(names.RETURN, "0.0")


def _turn(program: Program) -> None:
    """Write a turn of the loop: virtual sites, then a row, with a force evaluation if one is needed."""
    displaces = program.table.displaces
    _what_is_needed(program)
    with program.when(f"delta({names.INDEX}-{names.FIRST})*max({names.SITES},{names.NEEDED}) > 0"):
        take_up_images(program)
    with program.when(f"{names.SITES} > 0"):
        program.integrator.addConstrainPositions()
        # OpenMM's constraints have lengths in single precision.
        program.let("x", _DISPLACED_PLACE if displaces else PLACE)
        placed(program)
    with program.when(f"{names.NEEDED} > 0"):
        gather_forces(program)
        _row(program, evaluated=True)
    with program.when(f"{names.NEEDED} < 1"):
        take_up_images(program)
        _row(program, evaluated=False)
    program.number(names.EVALUATED, f"{names.EVALUATED}+{names.NEEDED}")
    known = f"max({names.KNOWN},{names.NEEDED})*{program.is_zero('drift')}"
    program.number(names.KNOWN, f"{known}*(1-max({names.SHIFTED},{names.WAS}))" if displaces else known)
    if displaces:
        program.number(names.WAS, names.SHIFTED)
    program.number(names.INDEX, f"{names.INDEX}+1")


def _what_is_needed(program: Program) -> None:
    """Write whether forces are needed: for a kick in the first turn of its row, or a displacement in the last one."""
    program.number(names.ROW, f"floor(({names.INDEX}+0.5)/{names.TURNS})")
    needed = f"(1-{program.is_zero('kick')})*delta({names.INDEX}-{names.ROW}*{names.TURNS})"
    if program.table.displaces:
        shifted = f"(1-{program.is_zero('shift')})*delta({names.INDEX}+1-({names.ROW}+1)*{names.TURNS})"
        program.number(names.SHIFTED, shifted)
        needed = f"max({names.SHIFTED},{needed})"
    program.number(names.NEEDED, f"(1-{names.KNOWN})*{needed}")


def _row(program: Program, evaluated: bool) -> None:
    """Write the stages of a row and the new positions; forces may have been `evaluated` for it."""
    table = program.table
    program.times("c", _PARTS)
    if table.has("before"):
        exchange(program, "before")
    if table.displaces:
        program.let("q", "sq")
        program.let("w", "sw")
    program.let("P", "P+_x(c)*F")
    torque = turned_back("q", "w", "(N+cross(move,F))" if table.displaces else "N")
    program.let("L", f"L+_x(c)*{AXES}*{torque}")
    if evaluated and any(table.memory):
        remember(program, torque)
    if any(table.memory):
        kick_by_last_forces(program)
    if table.has("after"):
        exchange(program, "after")
    for name, statements in STAGES.items():
        if table.has(name):
            program.times("n", ((name, "begins"),) * 3)
            for momentum, expression in statements.items():
                program.let(momentum, f"{expression};t=_x(n)")
    program.let("R", f"R+{_DRIFT}*P*_y(inverse)")
    rotate(program, _DRIFT)
    if table.displaces:
        program.times("c", _PARTS)
    show(program)
    program.let(names.SPAN, NEXT)
    if table.displaces:
        _displace(program)
    else:
        program.let("x", PLACE)
    placed(program)


def _displace(program: Program) -> None:
    """Displace bodies by e F/M and e I^-1 N, for `openmm_exactrb.substeps.gradient_kick`; e may be zero."""
    program.let("a", "dt*c")
    program.let("sq", "q")
    program.let("sw", "w")
    program.let("p", turned_back("q", "w", "N"))
    program.let("c", f"_z(a)*{AXES}*{INVERSE_INERTIA}*p")
    program.let("g", "0.5*sqrt(dot(c,c))")
    program.let("n", "0.5*c*sin(g)/max(g,1e-300)")
    program.let("g", "cos(g)")
    program.let("q", "sw*n+g*sq+cross(sq,n)")
    program.let("w", "sw*g-dot(sq,n)")
    program.let("d", turned("q", "w", "s"))
    program.let("move", "_z(a)*F*_y(inverse)")
    program.let("x", _DISPLACED_PLACE)


def _openmm(program: Program) -> None:
    """Write OpenMM's own updates between steps, and apply them to the bodies."""
    program.integrator.addUpdateContextState()
    with program.when(f"{names.BAROSTAT} > 0"):
        program.total(names.MOVED, f"step(abs(x-R-d-image)-{STILL})")
    with program.when(f"{names.MOVED} > 0"):
        _take_up_moves(program)
    with program.when(f"{names.PUSHED} > 0"):
        _take_up_velocities(program)


def _take_up_moves(program: Program) -> None:
    """Move all particles of a body by the mean of what they were moved, twice, since sums may have 24 bits only."""
    program.let("p", "x-R-d-image")
    for _ in range(2):
        sum_over_bodies(program, "n", "p", MOVE)
        program.let("n", "n*_z(inverse)")
        program.let("image", "image+n")
        program.let("p", "p-n")
    program.let("x", PLACE)
    program.number(names.KNOWN, "0.0")
    program.number(names.MOVED, "0.0")


def _take_up_velocities(program: Program) -> None:
    """Add up what a thermostat, or the remover of the motion of the centre of mass, changed of the momenta.

    The remover gives all particles one velocity more, which turns no body.
    """
    program.let("p", "m*(v-y)")
    program.let("c", "cross(d,p)")
    sum_over_bodies(program, "n", "p", MOMENTUM)
    program.let("P", "P+n")
    show(program, program.clusters)
    program.let("x", PLACE)
    with program.when(f"{names.PUSHED} > 1"):
        sum_over_bodies(program, "n", "c", MOMENTUM)
        program.let("L", f"L+{AXES}*{turned_back('q', 'w', 'n')}")
        show(program, program.clusters)
        program.let("x", PLACE)
        if program.clusters:
            program.integrator.addConstrainVelocities()
            show_bodies(program, constrained=True)
