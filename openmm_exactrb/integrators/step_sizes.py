"""The step of an integrator: its size, the time between its force evaluations, and what counts steps."""

from __future__ import annotations

import math
from typing import Any

import openmm
from openmm import unit

from openmm_exactrb.context.updates import acting_updates, frequency
from openmm_exactrb.openmm_access.units import not_negative, picoseconds
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.support.warn import warn

# OpenMM's default number of steps between two actions of a barostat, and the longest time (ps) for which it is meant.
_DEFAULT, _LONGEST = 25, 0.2
# Relative error of a number of steps that is due to rounding.
_ROUNDING = 1e-9


def step_size(size: float | unit.Quantity | None, interval: float | unit.Quantity | None, scheme: Scheme) -> float:
    """Return the step size in ps, from the step size or from the interval between force evaluations.

    Raises
    ------
    ValueError
        If both or none are given, or a scheme without force evaluations has an interval.
    """
    if size is not None and interval is not None:
        raise ValueError("stepSize= and forceInterval= are mutually exclusive: omit one of these arguments")
    if size is None and interval is None:
        raise ValueError("stepSize= is missing: pass it, or forceInterval=, the time between force evaluations")
    if interval is None:
        return picoseconds(size)
    if not scheme.forces:
        raise ValueError(f"scheme {scheme.name} evaluates no forces: pass stepSize= instead of forceInterval=")
    return picoseconds(interval) * scheme.forces


def steps_for(time: float | unit.Quantity, h: float) -> int:
    """Return the smallest number of steps of h (ps) that take at least a time, in ps if given without a unit."""
    duration = not_negative(time, unit.picosecond, "a time")
    if not h:
        raise ValueError("the step size is 0: set a positive one")
    if not math.isfinite(steps := duration / h * (1.0 - _ROUNDING)):
        raise ValueError(f"a step of {femtoseconds(h)} is too short for {duration:g} ps: set a longer one")
    return math.ceil(steps)


def described(h: float, forces: int) -> str:
    """Return what a step of h (ps) is, in words."""
    if forces == 1:
        return f"a step is {femtoseconds(h)} with one force evaluation"
    return f"a step is {femtoseconds(h)} with {forces} force evaluations" + (
        f", one every {femtoseconds(h / forces)}" if forces else ""
    )


def femtoseconds(time: float) -> str:
    """Return a time in ps as text in fs."""
    return f"{1e3 * time:.6g} fs"


def warn_of_barostats(context: openmm.Context, h: float, forces: int) -> None:
    """Warn if the interval of a barostat was meant for steps with one force evaluation."""
    for force in acting_updates(context) if forces > 1 else ():
        every: Any = frequency(force, context)
        if "Barostat" in type(force).__name__ and every == _DEFAULT and every * h > _LONGEST:
            warn(
                f"the {type(force).__name__} acts every {every} steps, which are {femtoseconds(every * h)}, because "
                f"{described(h, forces)}: set its frequency to {max(1, round(every / forces))} for as many force "
                "evaluations as with OpenMM's integrators"
            )
