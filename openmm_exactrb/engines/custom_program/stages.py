"""Stages of a step that all programs have: statements that carry them out."""

from __future__ import annotations

from openmm_exactrb.engines.custom_program import names
from openmm_exactrb.engines.custom_program.gather import MOST, STRENGTH
from openmm_exactrb.engines.custom_program.program import ALONE, AXES, INVERSE_INERTIA, Program, turned

#: By what numbers are multiplied that are to be summed: forces up to 2^30 kJ/mol/nm, moves up to 1000 nm, and changes
#: of momentum up to 1e6 amu nm/ps then are within the reach of the sums, over the number of particles of the body each.
FORCE, MOVE, MOMENTUM = 1.0 / STRENGTH, 2.0**-24, 2.0**-34
#: x that differs from that of the body by less than this, in nm, was not moved.
STILL = 1e-9
#: The expression of the positions of particles.
PLACE = "R+d+image"
#: Of the turns of a step, the next one.
NEXT = "vector(select(step(_x(at)-_z(at)),_y(at),_x(at)+1),_y(at),_z(at))"


def gather_forces(program: Program) -> None:
    """Write F and N: the forces of the particles are in v as torques, or as they are where a particle is alone."""
    f = "f" if program.fast is None else "F"
    if program.fast is not None and not program.slow:
        program.let("F", "0*R")
    for group in program.slow:
        program.let("F", f"f{group}" if group == program.slow[0] else f"F+f{group}")
    program.let("v", f"cross(d,{f})+{ALONE}*{f}")
    program.place(f"{FORCE!r}*{f}", program.slow[-1] if program.slow else None)
    take_sum(program, "F", FORCE)
    program.let("x", f"{FORCE!r}*v")
    take_sum(program, "N", FORCE)
    program.let("F", f"F+{ALONE}*v")


def placed(program: Program) -> None:
    """Write that x is where the body is."""
    if program.table.continues:
        program.let(names.LAG, "0.0")


def remember(program: Program, torque: str) -> None:
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
                program.let(name, f"select({flag},{value},{name})")


def kick_by_last_forces(program: Program) -> None:
    """Write `openmm_exactrb.substeps.LastForcesKick`."""
    count = sum(program.table.memory)
    for begin in range(0, count, 3):
        some = [min(k, count - 1) for k in range(begin, begin + 3)]
        program.times("n", tuple((f"last{k}", "begins") for k in some))
        terms = [(f"_{axis}(n)", *names.last(k)) for axis, k in zip("xyz", dict.fromkeys(some), strict=False)]
        program.let("P", "+".join(["P", *(f"{weight}*{force}" for weight, force, _ in terms)]))
        torque = "+".join(f"{weight}*{torque}" for weight, _, torque in terms)
        program.let("L", f"L+{AXES}*({torque})")


def take_sum(program: Program, name: str, scale: float) -> None:
    """Write a sum over the particles of each body, of what was written to x times a scale.

    It is infinite, or no number, for a particle whose part is too large for sums. The Reference platform knows the
    force of a group in statements without vectors only.
    """
    largest = f"{MOST / STRENGTH!r}*_z(inverse)"
    program.let(name, f"{-1.0 / (scale * STRENGTH)!r}*f{program.group}")
    program.let(name, f"{name}/step({largest}*{largest}-(1-{ALONE})*dot(x,x))")


def sum_over_bodies(program: Program, name: str, of: str, scale: float) -> None:
    """Write a sum over the particles of each body, in space; x loses the positions."""
    program.let("x", f"{scale!r}*{of}")
    take_sum(program, name, scale)
    program.let(name, f"{name}+{ALONE}*{of}")


def take_up_images(program: Program) -> None:
    """Write the vectors of the lattice by which OpenMM wrapped molecules since they were placed.

    The particles of a body may be in several molecules, so each has its own. Before bodies are loaded, 1/M is zero.
    """
    program.let("p", f"x-R-d-image-{names.LAG}" if program.table.continues else "x-R-d-image")
    program.let("image", f"image+p*step(abs(p)-{STILL})+(1-loaded)/loaded;loaded=min(1,1e30*_y(inverse))")


def show(program: Program, constrained: bool = False) -> None:
    """Write the velocities of the particles, and in y too, to see what OpenMM makes of them.

    Those of clusters stay what they are where they are `constrained`.
    """
    program.let("p", f"L*{INVERSE_INERTIA}")
    show_bodies(program, constrained)


def show_bodies(program: Program, constrained: bool) -> None:
    """Write velocities again, for the angular velocities that are in p."""
    v = f"P*_y(inverse)+{turned('q', 'w', 'cross(p,s)')}"
    program.let("v", f"select({names.CLUSTERED},v,{v})" if constrained else v)
    program.let("y", "v")
