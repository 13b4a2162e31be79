"""Terms of OpenMM's custom forces, whose energies are expressions, for the kernels.

The library differentiates an energy with OpenMM's parser, and returns the steps that compute the derivative. On
processors, kernels perform these steps; for devices, they are written as functions in the text of the kernels.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import openmm

from openmm_exactrb.engines.native.constants import CONSTANT, COORDINATE, FIRST_OPERATION, NUMBER_OF_TERM, PARAMETER
from openmm_exactrb.library.library import library
from openmm_exactrb.multiple_time_steps.bonded import Bonded
from openmm_exactrb.support.types import Array, Indices

# The kinds of terms, and the variables in their energies.
_KINDS = {
    openmm.CustomBondForce: ("Bond", "r"),
    openmm.CustomAngleForce: ("Angle", "theta"),
    openmm.CustomTorsionForce: ("Torsion", "theta"),
}
# The kinds of steps that are no operations, as in kernels/layout.cl.
# The operations as functions on devices.
_FUNCTIONS = (
    "#define OPERATION(name, value) DEVICE inline double of_##name(double a, double b, double c) { return value; }"
)


class Custom(NamedTuple):
    """The T terms of a custom force.

    Attributes
    ----------
    kind : str
        "Bond", "Angle" or "Torsion".
    particles : (T, k) array
    numbers : (p, T) array
        The parameters of each term.
    steps : tuple of str
        The steps of the derivative of the energy, as in source/expressions.h, in which numbers, the parameters of the
        Context and the coordinate are called "number i", "parameter NAME" and "coordinate".
    parameters : dict
        The parameters of the Context on which the forces depend, with their default values.
    """

    kind: str
    particles: Indices
    numbers: Array
    steps: tuple[str, ...]
    parameters: dict[str, float]

    @classmethod
    def of(cls, bonded: Bonded) -> Custom:
        """Return the terms of a custom force without periodic boundary conditions."""
        force, (kind, variable) = bonded.force, _KINDS[type(bonded.force)]
        count, name = (
            getattr(force, f"{what}Per{kind}Parameter{end}") for what, end in (("getNum", "s"), ("get", "Name"))
        )
        places = {variable: "coordinate"} | {name(i): f"number {i}" for i in range(count())}
        steps = []
        for step in library().derivative(force.getEnergyFunction(), variable):
            what, argument = step.split(" ", 1)
            steps.append(places.get(argument, f"parameter {argument}") if what == "variable" else step)
        every = {
            force.getGlobalParameterName(i): force.getGlobalParameterDefaultValue(i)
            for i in range(force.getNumGlobalParameters())
        }
        used = {name: value for name, value in every.items() if f"parameter {name}" in steps}
        return cls(kind, bonded.particles, bonded.numbers.T, tuple(steps), used)


def parameters_of(customs: Iterable[Custom]) -> dict[str, float]:
    """Return the parameters of the Context on which forces depend, with default values, in the order of their array."""
    return dict(sorted(item for custom in customs for item in custom.parameters.items()))


def rows(custom: Custom, names: list[str], first_constant: int) -> tuple[Indices, Array]:
    """Return the steps (n, 4) for processors, and the constants in these steps, which begin at an index of an array."""
    constants, made = list[float](), []
    for step in custom.steps:
        what, *arguments = step.split()
        if what == "coordinate":
            row = [COORDINATE]
        elif what == "number":
            row = [NUMBER_OF_TERM, int(arguments[0])]
        elif what == "parameter":
            row = [PARAMETER, names.index(arguments[0])]
        elif what == "constant":
            row = [CONSTANT, first_constant + len(constants)]
            constants.append(float(arguments[0]))
        else:
            number, *of = map(int, arguments)
            row = [FIRST_OPERATION + number, *of]
        made.append([*row, 0, 0, 0][:4])
    return np.array(made), np.array(constants)


def pieces(customs: Sequence[Custom]) -> tuple[str, ...]:
    """Return the texts of the functions that compute the derivatives on devices, one for each kind of forces."""
    functions = "".join(_function(kind.lower(), customs) for kind, _ in _KINDS.values())
    return (_FUNCTIONS, "operations.cl", functions) if customs else (functions,)


def _function(kind: str, customs: Sequence[Custom]) -> str:
    names = list(parameters_of(customs))
    cases = (
        f"    case {i}: {{\n{_body(custom, names)}    }}\n"
        for i, custom in enumerate(customs)
        if custom.kind.lower() == kind
    )
    return (
        f"DEVICE inline double derivative_of_{kind}(int force, double v, GLOBAL const double* numbers, int count, "
        f"GLOBAL const double* parameters) {{\n    switch (force) {{\n{''.join(cases)}    }}\n    return 0.0;\n}}\n"
    )


def _body(custom: Custom, names: Sequence[str]) -> str:
    lines = [f"        const double s{k} = {_value(step, names)};\n" for k, step in enumerate(custom.steps)]
    return f"{''.join(lines)}        return s{len(lines) - 1};\n"


def _value(step: str, names: Sequence[str]) -> str:
    """Return the value of a step in the dialect of devices."""
    what, *arguments = step.split()
    if what == "coordinate":
        return "v"
    if what == "number":
        return f"numbers[{arguments[0]}*count]"
    if what == "parameter":
        return f"parameters[{names.index(arguments[0])}]"
    if what == "constant":
        value = float(arguments[0])
        return repr(value) if np.isfinite(value) else f"({np.nan_to_num(np.sign(value))}/0.0)"
    return f"of_{what}({', '.join(f's{i}' for i in arguments[1:])})"
