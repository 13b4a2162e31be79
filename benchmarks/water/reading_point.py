"""The effect of the drift of W2_3m after its heat exchange on potential and kinetic energies at the end of a step.

The script measures by how much the potential energy of water at the end of a step is below that at the next kick. Both
positions belong to one trajectory, so that a few picoseconds are sufficient; the system is 216 molecules with PME at
298.15 K, friction 5/ps. With --solute, the script estimates by how much a drift with inner steps would heat alanine
dipeptide in water, or a solvated PDB file, from the correlation of bonded and other forces along a run of
LangevinMiddleIntegrator. Errors are from the scatter of ten blocks.

    python benchmarks/water/reading_point.py --model spce
    python benchmarks/water/reading_point.py --solute --duration 20
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.group_temperatures import Groups
from benchmarks.common.provenance import OF_RUN, of_run
from benchmarks.common.records import RECORDS, Record
from benchmarks.common.starts import R, context_of, put, simulation_of, thermostat
from benchmarks.proteins.protein_steps import KINDS, molecules, start_of
from benchmarks.proteins.protein_steps import TEMPERATURE as OF_SOLUTE
from openmm_exactrb.schemes import WITH_THERMOSTAT, Scheme
from openmm_exactrb.steps.substeps import DRIFT

MOLECULES, TEMPERATURE, FRICTION = 216, 298.15, 5.0
FREE = Scheme("free motion", 2, ((DRIFT, 1.0),))


def energy(context: openmm.Context) -> float:
    return context.getState(energy=True).getPotentialEnergy()._value / MOLECULES


def differences(
    context: openmm.Context, further: openmm.Context, integrator: openmm.Integrator, step: float, duration: float
) -> list[float]:
    """Return energies at the ends of steps less those at the next kick, in kJ/mol per molecule; times in ps."""
    integrator.setStepSize(step)
    further.getIntegrator().setStepSize(WITH_THERMOSTAT["W2_3m"].sequence[0][1] * step)
    integrator.step(round(0.5 / step))
    every, found = max(1, round(0.05 / step)), []
    for _ in range(round(duration / (every * step))):
        integrator.step(every)
        put(further, context.getState(positions=True, velocities=True))
        further.getIntegrator().step(1)
        found.append(energy(context) - energy(further))
    return found


def balances(pdb: Path | None, duration: float) -> list[float]:
    """Return samples of -f_fast M^-1 f_slow of the solute over kT, in 1/ps² per degree of freedom."""
    topology, system, _ = molecules(pdb, "all", "HBonds")
    run = simulation_of(topology, system, thermostat(OF_SOLUTE), start_of(pdb))
    run.context.setVelocitiesToTemperature(OF_SOLUTE, 1)
    groups, bonded, found = Groups(topology, system), sum(2 << k for k in range(len(KINDS))), []
    moving = groups.mass[:, None]
    for _ in range(round(duration / 0.2)):
        run.step(100)
        x = run.context.getState(positions=True).getPositions(asNumpy=True)._value
        fast, slow = (
            groups.projected(x, run.context.getState(forces=True, groups=some).getForces(asNumpy=True)._value / moving)
            for some in (bonded, ~bonded & 0xFFFFFFFF)
        )
        found.append(-float((moving[groups.solute] * fast * slow).sum()) / (groups.freedom * R * OF_SOLUTE))
    return found


def mean_of(samples: list[float]) -> tuple[float, float]:
    """Return mean and error."""
    means = [block.mean() for block in np.array_split(samples, 10)]
    return float(np.mean(samples)), float(np.std(means, ddof=1) / np.sqrt(len(means)))


def heating(args: argparse.Namespace) -> None:
    """Print what a drift to the end of a step would add to the temperature of the solute."""
    mean, error = mean_of(balances(args.pdb, args.duration))
    print(f"-<f_fast M^-1 f_slow> = {mean:.1f} +- {error:.1f} kT/ps² per degree of freedom, ({np.sqrt(mean):.1f}/ps)²")
    late = WITH_THERMOSTAT["W2_3m"].sequence[-1][1]
    for fs in args.intervals:
        kelvin = OF_SOLUTE * (late * 0.003 * fs) ** 2
        print(f"W2_3m, {fs:g} fs per force: {kelvin * mean:+.2f} +- {kelvin * error:.2f} K")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="spce", help="as rigid_water takes it (%(default)s)")
    parser.add_argument("--intervals", nargs="+", type=float, default=[2.0, 4.0, 6.0], metavar="FS", help="a force")
    parser.add_argument("--duration", type=float, default=5.0, metavar="PS", help="of each (%(default)s)")
    parser.add_argument("--solute", action="store_true", help="how a drift with inner steps would heat a solute")
    parser.add_argument("--pdb", type=Path, help="a solvated protein, instead of alanine dipeptide")
    parser.add_argument("--record", type=Path, default=RECORDS / "reading_point.csv", metavar="CSV", help="%(default)s")
    args = parser.parse_args()
    if args.solute:
        heating(args)
        return
    options = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.85, "ewaldErrorTolerance": 1e-4}
    _, system, positions = rb.rigid_water(MOLECULES, model=args.model, **options)
    integrator = rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, FRICTION, 0.006, scheme="W2_3m")
    integrator.setRandomNumberSeed(1)
    context = context_of(system, integrator, positions)
    further = context_of(system, rb.ExactRigidBodyIntegrator(0.001, scheme=FREE))
    openmm.LocalEnergyMinimizer.minimize(context, 10.0, 100)
    integrator.setVelocitiesToTemperature(TEMPERATURE, 1)
    integrator.step(700)
    record = Record(args.record, ("model", "fs"), ("U_less", "error", *OF_RUN))
    for fs in args.intervals:
        found = differences(context, further, integrator, 0.003 * fs, args.duration)
        mean, error = mean_of(found)
        point = {"model": args.model, "fs": fs, "U_less": f"{mean:.4f}", "error": f"{error:.4f}"}
        record.add(point | of_run(context))


if __name__ == "__main__":
    main()
