"""By how much the potential energy of W2_3m is lower where its steps end than where its next kick is.

Both are places of one trajectory, so that a few picoseconds are enough: 216 molecules with PME, 298.15 K, friction
5/ps. Errors are from the scatter of ten blocks.

    python benchmarks/reading_point.py --model spce
"""

from __future__ import annotations

import argparse

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.schemes import WITH_THERMOSTAT, Scheme
from openmm_exactrb.substeps import DRIFT

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
        state = context.getState(positions=True, velocities=True)
        further.setPositions(state.getPositions())
        further.setVelocities(state.getVelocities())
        further.getIntegrator().step(1)
        found.append(energy(context) - energy(further))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="spce", help="as rigid_water takes it (%(default)s)")
    parser.add_argument("--intervals", nargs="+", type=float, default=[2.0, 4.0, 6.0], metavar="FS", help="a force")
    parser.add_argument("--duration", type=float, default=5.0, metavar="PS", help="of each (%(default)s)")
    args = parser.parse_args()
    options = {"nonbondedMethod": app.PME, "nonbondedCutoff": 0.85, "ewaldErrorTolerance": 1e-4}
    _, system, positions = rb.rigid_water(MOLECULES, model=args.model, **options)
    integrator = rb.ExactRigidBodyLangevinIntegrator(TEMPERATURE, FRICTION, 0.006, scheme="W2_3m")
    integrator.setRandomNumberSeed(1)
    platform = openmm.Platform.getPlatform("CPU")
    context = openmm.Context(system, integrator, platform)
    further = openmm.Context(system, rb.ExactRigidBodyIntegrator(0.001, scheme=FREE), platform)
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0, 100)
    integrator.setVelocitiesToTemperature(TEMPERATURE, 1)
    integrator.step(700)
    for fs in args.intervals:
        found = differences(context, further, integrator, 0.003 * fs, args.duration)
        means = [block.mean() for block in np.array_split(found, 10)]
        error = np.std(means, ddof=1) / np.sqrt(len(means))
        print(
            f"{args.model}, {fs:g} fs per force: {np.mean(found):+.4f} +- {error:.4f} kJ/mol per molecule", flush=True
        )


if __name__ == "__main__":
    main()
