"""The integrator and the barostat of each ensemble."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.averages import PressureOffset
from openmm_exactrb.command import arguments
from openmm_exactrb.context.updates import UPDATES, frequency, names_of_updates
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.integrators.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.rotors import ROTORS

#: Ensembles: constant energy, constant temperature, and constant temperature and pressure.
ENSEMBLES = ("nve", "nvt", "npt")
#: Arguments of the integrator that are options of ``exactrb run``, each with its argparse arguments.
OPTIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    (
        "rotor",
        {**arguments.one_of(ROTORS), "default": "exact", "help": "method for the free rotation (default: %(default)s)"},
    ),
)
_REMOVER = "CMMotionRemover"
_MOVE = 0.05  # time in ps between two barostat moves for any step size, equal to OpenMM's default of 25 steps of 2 fs


def couple(system: openmm.System, args: argparse.Namespace) -> None:
    """Add the barostat of the ensemble; raise ValueError if the System has a thermostat, a barostat or no box.

    Thermostats and barostats of the System that never act are removed.
    """
    for k, force in reversed([*enumerate(system.getForces())]):
        if type(force).__name__ in UPDATES and not frequency(force):
            system.removeForce(k)
    if others := [name for name in names_of_updates(system) if name != _REMOVER]:
        raise ValueError(
            f"the System already contains {' and '.join(others)}, but --ensemble determines the thermostat and the "
            f"barostat of the run: remove {' and '.join(others)} from the System"
        )
    if args.ensemble != "npt":
        return
    if not system.usesPeriodicBoundaryConditions():
        raise ValueError("--ensemble npt needs a periodic box: pass a file with a box, or use --solvate")
    barostat = openmm.MonteCarloBarostat(args.pressure * unit.bar, args.temperature * unit.kelvin)
    barostat.setRandomNumberSeed(args.seed)
    system.addForce(barostat)


def pace(system: openmm.System, step: float) -> None:
    """Set the frequency of a barostat to about one move per 50 fs, given the step in ps."""
    for force in system.getForces():
        if isinstance(force, openmm.MonteCarloBarostat):
            force.setFrequency(max(1, round(_MOVE / step)))


def correct_pressure(
    system: openmm.System, offset: PressureOffset | None, integrator: ExactRigidBodyIntegrator, temperature: float
) -> None:
    """Add an offset to the pressure of the barostat; raise ValueError if the offset is for other settings."""
    if offset is None:
        return
    scheme, step = integrator.getScheme().name, integrator.getStepSize().value_in_unit(unit.picosecond)
    theirs, own = (offset.scheme, offset.step, offset.temperature), (scheme, step, temperature)
    if theirs[0] != scheme or not np.allclose(theirs[1:], own[1:], rtol=1e-9):
        raise ValueError(
            f"the file of --pressure-offset is for {theirs[0]} with a step of {theirs[1]:g} ps at {theirs[2]:g} K, but "
            f"this run has {own[0]} with a step of {own[1]:g} ps at {own[2]:g} K: pass the averages.csv of a run at "
            "constant volume with the same scheme, step and temperature as this run"
        )
    for force in system.getForces():
        if isinstance(force, openmm.MonteCarloBarostat):
            force.setDefaultPressure(force.getDefaultPressure() + offset.bar * unit.bar)


def integrator_of(args: argparse.Namespace, own: dict[str, Any], step: float) -> ExactRigidBodyIntegrator:
    """Return the integrator of the ensemble for given options, such as the scheme, and a step in ps."""
    given = {name: getattr(args, name) for name, _ in OPTIONS}
    options = {name: value for name, value in given.items() if value is not None} | own
    if args.ensemble == "nve":
        return ExactRigidBodyIntegrator(step, **options)
    integrator = ExactRigidBodyLangevinIntegrator(args.temperature, args.friction, step, **options)
    integrator.setRandomNumberSeed(args.seed)
    return integrator
