"""Where the engine on the device is right: what speaks against it, in one sentence each."""

from __future__ import annotations

from typing import Any, Literal

import openmm
from openmm import unit

from openmm_exactrb.context import arrays
from openmm_exactrb.context.find import find_bodies
from openmm_exactrb.context.nesting import Nesting, nested_in
from openmm_exactrb.device import gather, names
from openmm_exactrb.device.rows import foreign
from openmm_exactrb.rotors import ROTORS, Rotor
from openmm_exactrb.schemes.scheme import Scheme

#: Which engine carries the steps out.
Engine = Literal["host", "device", "auto"]
#: What carries words out.
ENGINES: tuple[Engine, ...] = ("host", "device", "auto")
#: The bath that a program can have.
LANGEVIN = "Langevin"
_EXACT = ("exact", "exact_numpy", "exact_compiled")
_DEVICES = ("CUDA", "HIP", "OpenCL")


def named(engine: str) -> Engine:
    """Return the engine of a name.

    Raises
    ------
    ValueError
        If there is none.
    """
    for known in ENGINES:
        if engine == known:
            return known
    raise ValueError(f"unknown engine {engine!r}: choose one of {', '.join(ENGINES)}")


def against_program(scheme: Scheme, rotor: Rotor, nested: bool, bath: str | None) -> str | None:
    """Say why a scheme, a rotor and a bath cannot be a program of the device, or return None."""
    if bath not in (None, LANGEVIN):
        return f"the device has Langevin's bath only, not {bath}"
    if nested:
        return "the device has no steps for forces within drifts (fast=)"
    if rotor not in map(ROTORS.get, _EXACT):
        own = "" if ROTORS.get(rotor.name) is rotor else "one of your own, "
        return f"the device turns bodies by the exact rotor only, not by {own}{rotor.name}"
    letters = foreign(scheme, bath is not None)
    if letters:
        return f"the device cannot carry out the letter {letters[0]!r} of scheme {scheme.name}"
    return None


def against_context(context: Any, named: list[list[int]] | None = None) -> str | None:
    """Say why a Context, where bodies may be named by hand, cannot run a program, or return None."""
    return _against_platform(context) or _against_system(context, named)


def against_parameters(context: Any, written: bool) -> str | None:
    """Say which parameter of a Context has the name of a variable of the program, or return None.

    OpenMM refuses names of variables that are declared, when it makes a Context; where the program is `written` it has
    done so. In the place of its own ones, such as v, it takes the parameter without a word.
    """
    for parameter in context.getParameters():
        if parameter in names.OPENMM or (names.has(parameter) and not written):
            return f"the parameter {parameter!r} of a force has the name of a variable of the program: rename it"
    return None


def against_steps(context: Any, integrator: Any, nesting: Nesting | None) -> str | None:
    """Say why the host's steps are better in a Context that the device could run, or return None."""
    system, x = context.getSystem(), arrays.positions(context.getState(positions=True))
    if nesting is None or not x.any():
        return None
    nested = nested_in(system, find_bodies(system, x, integrator.getNamedBodies()), nesting)
    h = integrator.getStepSize().value_in_unit(unit.picosecond)
    if nested is None or not nested.acts(integrator.getScheme(), h):
        return None
    return 'bonded forces are nested at this step (fast="auto"), for which the device has no steps'


def slower(context: Any) -> str | None:
    """Say why the host is faster in a Context whatever its System is, or return None."""
    name = context.getPlatform().getName()
    return None if name in _DEVICES else f"{name} is no device: there the host's compiled kernels are faster"


def _against_platform(context: Any) -> str | None:
    platform = context.getPlatform()
    name = platform.getName()
    if name == "CPU":
        return "on the CPU platform the program would cost 12 times a Verlet step"
    if name in _DEVICES:
        if platform.getPropertyValue(context, "Precision") == "single":
            return "in single precision the state of the bodies would be rounded: set Precision to mixed or double"
        return None
    if name != "Reference":
        return f"nobody has tried the program on the platform {name}"
    if _has_sites(context.getSystem()):
        return "the Reference platform of OpenMM moves virtual sites at the end of a step only, not within a program"
    return None


def _against_system(context: Any, named: list[list[int]] | None) -> str | None:
    x = arrays.positions(context.getState(positions=True))
    if not x.any():  # without positions nobody knows
        return None
    bodies = find_bodies(context.getSystem(), x, named)
    if len(bodies.clusters):
        return "constraints leave a molecule of the System a motion of its own, which the device does not follow"
    return gather.against(context.getSystem(), bodies)


def _has_sites(system: openmm.System) -> bool:
    return any(map(system.isVirtualSite, range(system.getNumParticles())))
