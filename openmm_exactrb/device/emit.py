"""The program of a scheme: a loop over the rows of its table.

A turn of the loop carries out a row: a kick, the thermostat before or after it, and the drift that follows. Rows are
data on the device, so that all schemes share the same kernels, whatever their length, and no host-to-device transfer,
and so no synchronisation, is needed within a step.

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
from openmm_exactrb.device import names
from openmm_exactrb.device.gather import MOST, STRENGTH
from openmm_exactrb.device.noise import exchange
from openmm_exactrb.device.program import ALONE, AXES, INVERSE_INERTIA, Program, turned, turned_back
from openmm_exactrb.device.rotor import rotate
from openmm_exactrb.device.rows import STAGES, Table

# By what numbers are multiplied that are to be summed: forces up to 2^30 kJ/mol/nm, moves up to 1000 nm, and changes of
# momentum up to 1e6 amu nm/ps then are within the reach of the sums, over the number of particles of the body each.
_FORCE, _MOVE, _MOMENTUM = 1.0 / STRENGTH, 2.0**-24, 2.0**-34
# x that differs from that of the body by less than this, in nm, was not moved.
_STILL = 1e-9
# The time of a drift where "c" holds times.
_DRIFT = "(_y(c)*_z(shape))"
_PLACE, _DISPLACED_PLACE = "R+d+image", "R+move+d+image"
_PARTS = (("kick", "begins"), ("drift", "1"), ("shift", "ends"))


def declare(integrator: openmm.CustomIntegrator, table: Table, group: int) -> None:
    """Give an integrator without a Context the variables and the program of a scheme; sums over bodies have a group.

    Until bodies are loaded, steps make positions nan.
    """
    program = Program(integrator, table, group)
    program.numbers(0.0, names.LOADED)
    variables.declare_numbers(integrator)
    _declare_variables(program)
    with program.when(f"{names.CHANGED} > 0"):
        program.let(names.SPAN, f"vector({names.FIRST},{names.FIRST},{names.LAST})")
        program.number(names.PACE, f"1/{names.TURNS}")
        program.let("shape", f"vector(_x(shape),_y(shape),{names.PACE})")
        if table.has_thermostat:
            program.let(names.THERMOSTAT, f"vector({names.FRICTION},{names.TURNING_FRICTION},{names.KT})")
        if table.continues:
            _keep_or_return(program)
        program.number(names.CHANGED, "0.0")
    program.number(names.INDEX, names.FIRST)
    with program.loop(f"{names.INDEX} < {names.LAST}+1"):
        _turn(program)
    _openmm(program)
    with program.when(f"{names.ASKED} > 0"):
        program.total(names.FASTEST, f"(_x(abc)*sqrt(dot(L,L)))^{names.POWER}")


def _declare_variables(program: Program) -> None:
    table = program.table
    program.vectors(*names.STATE, *names.CONSTANTS, names.SPAN, *names.FORCES, *names.TEMPORARY)
    program.numbers(0.0, names.SITES, names.BAROSTAT, names.PUSHED, names.ASKED)
    program.numbers(0.0, names.INDEX, names.ROW, names.NEEDED, names.KNOWN, names.MOVED, names.FASTEST, names.FIRST)
    program.numbers(0.0, names.EVALUATED, names.KEEP, names.RETURN)
    program.numbers(1.0, names.TURNS, names.PACE, names.CHANGED)
    program.numbers(table.span(1, False, "step", "step")[1], names.LAST)
    if table.displaces:
        program.vectors(*names.DISPLACED)
        program.numbers(0.0, names.SHIFTED, names.WAS)
    if table.continues:
        program.vectors(*names.INNER, names.LAG, *(name for k in range(sum(table.memory)) for name in names.last(k)))
    if table.has_thermostat:
        program.vectors(names.THERMOSTAT, *names.STREAMS)
        program.numbers(0.0, names.KT, names.FRICTION, names.TURNING_FRICTION, names.SEEDED)
    for name, column in zip(names.TABLES, table.columns(), strict=True):
        program.integrator.addTabulatedFunction(name, openmm.Discrete1DFunction(column))


def _keep_or_return(program: Program) -> None:
    """Write that the inner state is kept, or returned to from the output that was shown; x stays what it is."""
    state = [name for name in names.STATE if name != "image"]
    for name, inner in zip(state, names.INNER, strict=True):
        program.let(inner, f"{names.KEEP}*{name}+(1-{names.KEEP})*{inner}")
    program.let(names.LAG, f"{names.RETURN}*(R+d-iR-id)")
    for name, inner in zip(state, names.INNER, strict=True):
        program.let(name, f"{names.RETURN}*{inner}+(1-{names.RETURN})*{name}")
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
        _take_up_images(program)
    with program.when(f"{names.SITES} > 0"):
        program.integrator.addConstrainPositions()
        # OpenMM's constraints have lengths in single precision.
        program.let("x", _DISPLACED_PLACE if displaces else _PLACE)
        _placed(program)
    with program.when(f"{names.NEEDED} > 0"):
        _gather_forces(program)
        _row(program, evaluated=True)
    with program.when(f"{names.NEEDED} < 1"):
        _take_up_images(program)
        _row(program, evaluated=False)
    program.number(names.EVALUATED, f"{names.EVALUATED}+{names.NEEDED}")
    known = f"max({names.KNOWN},{names.NEEDED})*{_is_zero(program, 'drift')}"
    program.number(names.KNOWN, f"{known}*(1-max({names.SHIFTED},{names.WAS}))" if displaces else known)
    if displaces:
        program.number(names.WAS, names.SHIFTED)
    program.number(names.INDEX, f"{names.INDEX}+1")


def _what_is_needed(program: Program) -> None:
    """Write whether forces are needed: for a kick in the first turn of its row, or a displacement in the last one."""
    program.number(names.ROW, f"floor(({names.INDEX}+0.5)/{names.TURNS})")
    needed = f"(1-{_is_zero(program, 'kick')})*delta({names.INDEX}-{names.ROW}*{names.TURNS})"
    if program.table.displaces:
        shifted = f"(1-{_is_zero(program, 'shift')})*delta({names.INDEX}+1-({names.ROW}+1)*{names.TURNS})"
        program.number(names.SHIFTED, shifted)
        needed = f"max({names.SHIFTED},{needed})"
    program.number(names.NEEDED, f"(1-{names.KNOWN})*{needed}")


def _is_zero(program: Program, part: str) -> str:
    """Return the expression that is 1 where a part of the row is zero, else 0."""
    return f"delta({names.TABLES[0]}({names.ROW}+{program.table.column(part) * len(program.table.rows)}))"


def _gather_forces(program: Program) -> None:
    """Write F and N: the forces of the particles are in v as torques, or as they are where a particle is alone."""
    program.let("v", f"cross(d,f)+{ALONE}*f")
    program.let("x", f"{_FORCE!r}*f")
    _take_sum(program, "F", _FORCE)
    program.let("x", f"{_FORCE!r}*v")
    _take_sum(program, "N", _FORCE)
    program.let("F", f"F+{ALONE}*v")


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
        _remember(program, torque)
    if any(table.memory):
        _kick_by_last_forces(program)
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
    _show(program)
    program.let(names.SPAN, "vector(select(step(_x(at)-_z(at)),_y(at),_x(at)+1),_y(at),_z(at))")  # the next turn
    if table.displaces:
        _displace(program)
    else:
        program.let("x", _PLACE)
    _placed(program)


def _placed(program: Program) -> None:
    """Write that x is where the body is."""
    if program.table.continues:
        program.let(names.LAG, "0.0")


def _remember(program: Program, torque: str) -> None:
    """Remember the force and the torque in the body, or what displaced ones differ by, if the row says so."""
    forces, differences = program.table.memory
    program.times("n", (("remember", "1"), ("differ", "1"), ("differ", "1")))
    program.let("p", torque)
    first = ("F", "p"), tuple(f"{value}-{known}" for value, known in zip(("F", "p"), names.last(0), strict=True))
    parts = (("_x(n)", 0, forces, first[0]), ("_y(n)", forces, differences, first[1]))
    for flag, begin, count, newest in parts:
        for k in reversed(range(begin, begin + count)):
            values = newest if k == begin else names.last(k - 1)
            for name, value in zip(names.last(k), values, strict=True):
                program.let(name, f"(1-delta({flag}))*({value})+delta({flag})*{name}")


def _kick_by_last_forces(program: Program) -> None:
    """Write `openmm_exactrb.substeps.LastForcesKick`."""
    count = sum(program.table.memory)
    for begin in range(0, count, 3):
        some = [min(k, count - 1) for k in range(begin, begin + 3)]
        program.times("n", tuple((f"last{k}", "begins") for k in some))
        terms = [(f"_{axis}(n)", *names.last(k)) for axis, k in zip("xyz", dict.fromkeys(some), strict=False)]
        program.let("P", "+".join(["P", *(f"{weight}*{force}" for weight, force, _ in terms)]))
        torque = "+".join(f"{weight}*{torque}" for weight, _, torque in terms)
        program.let("L", f"L+{AXES}*({torque})")


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


def _take_sum(program: Program, name: str, scale: float) -> None:
    """Write a sum over the particles of each body, of what was written to x times a scale.

    It is infinite, or no number, for a particle whose part is too large for sums. The Reference platform knows the
    force of a group in statements without vectors only.
    """
    largest = f"{MOST / STRENGTH!r}*_z(inverse)"
    program.let(name, f"{-1.0 / (scale * STRENGTH)!r}*f{program.group}")
    program.let(name, f"{name}/step({largest}*{largest}-(1-{ALONE})*dot(x,x))")


def _sum(program: Program, name: str, of: str, scale: float) -> None:
    """Write a sum over the particles of each body, in space; x loses the places."""
    program.let("x", f"{scale!r}*{of}")
    _take_sum(program, name, scale)
    program.let(name, f"{name}+{ALONE}*{of}")


def _take_up_images(program: Program) -> None:
    """Write the vectors of the lattice by which OpenMM wrapped molecules since they were placed.

    The particles of a body may be in several molecules, so each has its own. Before bodies are loaded, 1/M is zero.
    """
    program.let("p", f"x-R-d-image-{names.LAG}" if program.table.continues else "x-R-d-image")
    program.let("image", f"image+p*step(abs(p)-{_STILL})+(1-loaded)/loaded;loaded=min(1,1e30*_y(inverse))")


def _show(program: Program) -> None:
    """Write the velocities of the particles, and in y too, to see what OpenMM makes of them."""
    program.let("p", f"L*{INVERSE_INERTIA}")
    program.let("v", f"P*_y(inverse)+{turned('q', 'w', 'cross(p,s)')}")
    program.let("y", "v")


def _openmm(program: Program) -> None:
    """Write OpenMM's own updates between steps, and apply them to the bodies."""
    program.integrator.addUpdateContextState()
    with program.when(f"{names.BAROSTAT} > 0"):
        program.total(names.MOVED, f"step(abs(x-R-d-image)-{_STILL})")
    with program.when(f"{names.MOVED} > 0"):
        _take_up_moves(program)
    with program.when(f"{names.PUSHED} > 0"):
        _take_up_velocities(program)


def _take_up_moves(program: Program) -> None:
    """Move all particles of a body by the mean of what they were moved, twice, since sums may have 24 bits only."""
    program.let("p", "x-R-d-image")
    for _ in range(2):
        _sum(program, "n", "p", _MOVE)
        program.let("n", "n*_z(inverse)")
        program.let("image", "image+n")
        program.let("p", "p-n")
    program.let("x", _PLACE)
    program.number(names.KNOWN, "0.0")
    program.number(names.MOVED, "0.0")


def _take_up_velocities(program: Program) -> None:
    """Add up what a thermostat, or the remover of the motion of the centre of mass, changed of the momenta.

    The remover gives all particles one velocity more, which turns no body.
    """
    program.let("p", "m*(v-y)")
    program.let("c", "cross(d,p)")
    _sum(program, "n", "p", _MOMENTUM)
    program.let("P", "P+n")
    _show(program)
    program.let("x", _PLACE)
    with program.when(f"{names.PUSHED} > 1"):
        _sum(program, "n", "c", _MOMENTUM)
        program.let("L", f"L+{AXES}*{turned_back('q', 'w', 'n')}")
        _show(program)
        program.let("x", _PLACE)
