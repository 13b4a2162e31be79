"""Who moves it: an integrator and a barostat for each ensemble."""

from __future__ import annotations

import argparse
from typing import Any

import openmm
from openmm import unit

from openmm_exactrb.baths import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.context.couplings import COUPLINGS
from openmm_exactrb.integrator import ExactRigidBodyIntegrator

#: Constant energy, temperature, or temperature and pressure.
ENSEMBLES = ("nve", "nvt", "npt")
_REMOVER = "CMMotionRemover"
_MOVE = 0.05  # ps between two moves of the barostat: OpenMM's 25 steps at 2 fs, where they would be 450 fs at 18 fs


def couple(system: openmm.System, args: argparse.Namespace) -> None:
    """Add the barostat of the ensemble to a System.

    Raises
    ------
    ValueError
        If the System has a thermostat or barostat of its own, or no box whose volume could change.
    """
    own = [name for force in system.getForces() if (name := type(force).__name__) in COUPLINGS and name != _REMOVER]
    if own:
        raise ValueError(f"take the {', '.join(own)} out of the System: --ensemble nvt or npt has its own")
    if args.ensemble != "npt":
        return
    if not system.usesPeriodicBoundaryConditions():
        raise ValueError("--ensemble npt needs a periodic box: give a file with one, or --solvate")
    barostat = openmm.MonteCarloBarostat(args.pressure * unit.bar, args.temperature * unit.kelvin)
    barostat.setRandomNumberSeed(args.seed)
    system.addForce(barostat)


def pace(system: openmm.System, step: float) -> None:
    """Have a barostat act every 50 fs, or as often as steps (ps) allow."""
    for force in system.getForces():
        if isinstance(force, openmm.MonteCarloBarostat):
            force.setFrequency(max(1, round(_MOVE / step)))


def integrator_of(args: argparse.Namespace, own: dict[str, Any], step: float) -> ExactRigidBodyIntegrator:
    """Return the integrator of the ensemble.

    Parameters
    ----------
    args : argparse.Namespace
    own : dict
        Options of the integrator, such as its scheme.
    step : float
        In ps.
    """
    options = {"rotor": args.rotor, **own}
    if args.ensemble == "nve":
        return ExactRigidBodyIntegrator(step, **options)
    integrator = ExactRigidBodyLangevinIntegrator(args.temperature, args.friction, step, **options)
    integrator.setRandomNumberSeed(args.seed)
    return integrator
