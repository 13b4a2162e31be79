"""The program of a scheme: a loop over the stages of its word, and a table from letters to what they emit.

A stage is a kick and the drift behind it. The word itself is data, two tables of their parts that the loop reads: every
scheme has the same kernels, and their compilation does not take longer the longer the word is.

Two things of OpenMM decide the order of statements. Where the System has constraints, positions that are written before
the last ``addConstrainPositions`` of a program are kept as differences, which forces do not see; so the one that makes
virtual sites stands at the begin of the loop, and nothing writes positions before it. And OpenMM goes through all paths
through two rounds of a program, two rounds of its loop in each: with a block more there are several times as many, so
numbers are multiplied by conditions where that will do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from types import MappingProxyType

import openmm

from openmm_exactrb.device import names
from openmm_exactrb.device.gather import STRENGTH
from openmm_exactrb.device.program import Program
from openmm_exactrb.device.rotor import rotate, turned, turned_back
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import DRIFT, KICK, Word

#: The parts of a kick and of the drift behind it.
Stage = tuple[float, float]

_SUM = f"f{names.GROUP}"
# By what numbers are multiplied that are to be summed: forces up to 2^33 kJ/mol/nm, moves up to 1000 nm, and changes of
# momentum up to 1e6 amu nm/ps then are within the reach of the sums.
_FORCE, _MOVE, _MOMENTUM = 1.0 / STRENGTH, 2.0**-24, 2.0**-34
# x that differs from that of the body by less than this, in nm, was not moved.
_STILL = 1e-9


def stages(word: Word) -> list[Stage]:
    """Return the kicks of a word with the drifts behind them; a drift without a kick has one of no length before it."""
    pairs: list[Stage] = []
    for letter, part in word:
        if letter == KICK or not pairs or pairs[-1][1]:
            pairs.append((0.0, 0.0))
        kick, drift = pairs.pop()
        pairs.append((part, drift) if letter == KICK else (kick, part))
    return pairs


def foreign(scheme: Scheme) -> list[str]:
    """Return the letters of a scheme that have no emitter."""
    return sorted({letter for letter, _ in scheme.word + scheme.processor} - EMITTERS.keys())


def _kick(program: Program) -> None:
    """Write a kick, with forces anew where they are not known."""
    with program.when(f"{names.NEEDED} > 0"):
        program.let("p", "cross(d,f)")
        _sum(program, "F", "f", "u", _FORCE)
        _sum(program, "N", "p", "u", _FORCE)
    program.let("P", f"P+{names.KICK_TIME}*F")
    program.let("L", f"L+{names.KICK_TIME}*axes*{turned_back('q', 'w', 'N')}")


def _drift(program: Program) -> None:
    """Write the flow of the kinetic energy, and bring particles to their places."""
    rotate(program, names.TIME)
    program.let("R", f"R+{names.TIME}*P*_y(inverse)")
    _place(program)


#: What letters emit: emitter(program).
EMITTERS: Mapping[str, Callable[[Program], None]] = MappingProxyType({KICK: _kick, DRIFT: _drift})


def declare(integrator: openmm.CustomIntegrator, scheme: Scheme, optional: bool) -> None:
    """Give an integrator without a Context the variables and the program of a scheme.

    Until bodies are loaded, steps make positions nan; or, where the program is optional, nothing happens.
    """
    program = Program(integrator)
    _declare_variables(program)
    with program.when(f"{names.LOADED} > 0") if optional else nullcontext():
        _step(program, scheme)


def _declare_variables(program: Program) -> None:
    program.vectors(*names.STATE, *names.CONSTANTS, *names.FORCES, *names.TEMPORARY)
    program.numbers(0.0, names.LOADED, names.SITES, names.BAROSTAT, names.PUSHED, names.ASKED)
    program.numbers(0.0, names.INDEX, names.STAGE, names.KICK_TIME, names.TIME, names.NEEDED)
    program.numbers(0.0, names.KNOWN, names.MOVED, names.FASTEST)
    program.numbers(1.0, names.ENTER, names.LEAVE, names.TURNS)


def _step(program: Program, scheme: Scheme) -> None:
    """Write a step."""
    parts = [stages(word) for word in (scheme.processor, scheme.word, scheme.postprocessor)]
    word = [stage for part in parts for stage in part]
    program.table(names.KICKS, [*(kick for kick, _ in word), 0.0])
    program.table(names.DRIFTS, [*(drift for _, drift in word), 0.0])
    _take_up_images(program)
    _skip(program, 0, parts[0], names.ENTER, "0")
    # One turn more of the loop makes the virtual sites of the last places.
    with program.loop(f"{names.INDEX} < {len(word)}*{names.TURNS}+{names.SITES}"):
        _stage(program)
        if scheme.processor:
            _skip(program, len(parts[0] + parts[1]), parts[2], names.LEAVE, f"{names.INDEX}+1")
        else:
            program.number(names.INDEX, f"{names.INDEX}+1")
    _show(program)
    _openmm(program)
    with program.when(f"{names.ASKED} > 0"):
        program.total(names.FASTEST, f"(_x(abc)*sqrt(dot(L,L)))^{names.POWER}")


def _stage(program: Program) -> None:
    """Write a turn of the loop: sites, what the tables say, a kick and a rotation."""
    with program.when(f"{names.SITES} > 0"):
        program.integrator.addConstrainPositions()
        _place(program)  # OpenMM's constraints have lengths in single precision
    program.number(names.STAGE, f"floor(({names.INDEX}+0.5)/{names.TURNS})")
    program.number(names.KICK_TIME, f"dt*{names.KICKS}({names.STAGE})*delta({names.INDEX}-{names.STAGE}*{names.TURNS})")
    program.number(names.TIME, f"dt*{names.DRIFTS}({names.STAGE})/{names.TURNS}")
    program.number(names.NEEDED, f"(1-{names.KNOWN})*(1-delta({names.KICK_TIME}))")
    for letter in (KICK, DRIFT):
        EMITTERS[letter](program)
    program.number(names.KNOWN, f"max({names.KNOWN},{names.NEEDED})*delta({names.TIME})")


def _skip(program: Program, stage: int, stages: list[Stage], unless: str, index: str) -> None:
    """Write the next index: behind some stages, where it would be the first of them and a number is not above zero."""
    here = f"delta({index}-{stage}*{names.TURNS})*step(0.5-{unless})"
    program.number(names.INDEX, f"{index}+{len(stages)}*{names.TURNS}*{here}" if stages else index)


def _sum(program: Program, name: str, of: str, own: str, scale: float) -> None:
    """Write a sum over the particles of each body, in space; x loses the places, and `own` holds what was summed."""
    program.let(own, of)
    program.let("x", f"{scale!r}*{own}")
    program.let(name, f"{-1.0 / (scale * STRENGTH)!r}*{_SUM}+alone*{own}")


def _place(program: Program) -> None:
    program.let("x", "R+d+image")


def _take_up_images(program: Program) -> None:
    """Write the vectors of the lattice by which OpenMM wrapped molecules since they were placed.

    The particles of a body may be in several molecules, so each has its own.
    """
    program.let("p", "x-R-d-image")
    program.let("image", f"image+p*step(abs(p)-{_STILL})+log({names.LOADED})")


def _show(program: Program) -> None:
    """Write the velocities of the particles."""
    program.let("p", "L*vector(_x(inverse)+_x(abc),_x(inverse)+_x(abc)*_z(abc),_x(inverse))")
    program.let("v", f"P*_y(inverse)+{turned('q', 'w', 'cross(p,s)')}")


def _openmm(program: Program) -> None:
    """Write what OpenMM does between steps, and take it up."""
    program.let("y", "v")
    program.integrator.addUpdateContextState()
    with program.when(f"{names.BAROSTAT} > 0"):
        program.total(names.MOVED, f"step(abs(x-R-d-image)-{_STILL})")
        with program.when(f"{names.MOVED} > 0"):
            _take_up_moves(program)
    with program.when(f"{names.PUSHED} > 0"):
        _take_up_velocities(program)
        _show(program)


def _take_up_moves(program: Program) -> None:
    """Move all particles of a body by the mean of what they were moved, twice, since sums may have 24 bits only."""
    program.let("p", "x-R-d-image")
    for _ in range(2):
        _sum(program, "n", "p", "u", _MOVE)
        program.let("n", "n*vector(_z(inverse),_z(inverse),_z(inverse))")
        program.let("image", "image+n")
        program.let("p", "p-n")
    _place(program)
    program.number(names.KNOWN, 0.0)


def _take_up_velocities(program: Program) -> None:
    """Add up what a thermostat, or the remover of the motion of the centre of mass, changed of the momenta."""
    program.let("p", "m*(v-y)")
    program.let("c", "cross(d,p)")
    _sum(program, "n", "p", "u", _MOMENTUM)
    program.let("P", "P+n")
    _sum(program, "n", "c", "u", _MOMENTUM)
    program.let("L", f"L+axes*{turned_back('q', 'w', 'n')}")
    _place(program)
