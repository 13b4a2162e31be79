"""Transfer of States between integrators of OpenMM and of this package."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import openmm
from openmm import app

from openmm_exactrb.openmm_access import arrays

# Parts of OpenMM's messages about complete files that it cannot read, and the remedies.
_REMEDIES = {
    "no serialization proxy": "install the OpenMM plugin that defines this type",
    "Unsupported version": "use the version of OpenMM that wrote the file, or a newer one",
}


def loadState(target: app.Simulation | openmm.Context, source: str | os.PathLike[str] | openmm.State) -> None:
    """Load a State that was saved with another integrator.

    A State from ``simulation.saveState`` contains data of its integrator. With an integrator of this package, OpenMM's
    ``simulation.loadState(file)`` and ``context.setState(state)`` ignore the data of OpenMM's integrators, but fail if
    the State contains a parameter that the target lacks, or is from another engine or from a thermostat with other
    variables, such as Nosé-Hoover chains of another length. This function ignores such data.

    Parameters
    ----------
    target : openmm.app.Simulation or openmm.Context
    source : str, path or openmm.State
        A file that ``simulation.saveState`` wrote, or a State. The function loads its positions, velocities, box, time
        and step count, and those parameters that the target also has.

    Raises
    ------
    ValueError
        If the source is neither a State nor a file that contains one, has no positions, or has a different number of
        particles from the target.

    Examples
    --------
    >>> loadState(simulation, "equilibrated.xml")  # doctest: +SKIP
    """
    context = target.context if isinstance(target, app.Simulation) else target
    if not isinstance(context, openmm.Context):
        raise ValueError(f"a State can be loaded into a Simulation or a Context, but not into {type(target).__name__}")
    if not isinstance(source, (str, os.PathLike, openmm.State)):
        raise ValueError(
            f"the source must be a State, or a file that simulation.saveState wrote, not {type(source).__name__}"
        )
    state = source if isinstance(source, openmm.State) else read_xml(source, openmm.State, "simulation.saveState")
    kinds = state.getDataTypes()
    if not kinds & openmm.State.Positions:
        raise ValueError(
            "the State contains no positions: save it with simulation.saveState, or create it with "
            "getState(positions=True)"
        )
    x = state.getPositions(asNumpy=True)
    if len(x) != context.getSystem().getNumParticles():
        raise ValueError(
            f"the numbers of particles in the State ({len(x)}) and in the System "
            f"({context.getSystem().getNumParticles()}) differ: load a State of the same System"
        )
    context.setTime(state.getTime())
    context.setStepCount(state.getStepCount())
    if context.getSystem().usesPeriodicBoundaryConditions():
        context.setPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    if kinds & openmm.State.Parameters:
        arrays.take_parameters(context, state)
    context.setPositions(x)
    if kinds & openmm.State.Velocities:
        context.setVelocities(state.getVelocities(asNumpy=True))
    if isinstance(target, app.Simulation):
        target.currentStep = state.getStepCount()


def read_xml(file: str | os.PathLike[str], kind: type[Any], writer: str = "openmm.XmlSerializer") -> Any:
    """Read an object of a given class, such as openmm.System, from an XML file; error messages name `writer`.

    Raises
    ------
    ValueError
        If the file has another format, or contains an object of another class.
    OSError
        If the file cannot be read.
    """
    try:
        content: Any = openmm.XmlSerializer.deserialize(Path(file).read_text(encoding="utf-8"))
    except (openmm.OpenMMException, ValueError) as error:
        text = " ".join(str(error).split())
        for part, remedy in _REMEDIES.items():
            if part in text:
                raise ValueError(f"{file} cannot be read by OpenMM {openmm.__version__} ({text}): {remedy}") from None
        raise ValueError(
            f"{file} is not a valid file of {writer} ({text}): pass a complete file that {writer} wrote"
        ) from None
    if not isinstance(content, kind):
        raise ValueError(
            f"{file} contains an object of type {type(content).__name__}, not {kind.__name__}: pass a file that "
            f"contains a {kind.__name__}"
        )
    return content
