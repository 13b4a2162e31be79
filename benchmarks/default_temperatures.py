"""Temperatures and potential energy of a peptide in water: the default with a thermostat beside LangevinMiddle.

Alanine dipeptide (amber14) in 212 molecules of TIP3P, 658 atoms, PME with a switch, bonds to hydrogen constrained, on
the CPU platform with one thread. The box is what a barostat makes of it. Both integrators evaluate forces once a step
and are judged by one estimator: the linear and angular momenta of each molecule of water, and the velocities of the
peptide after projection on its constraints. "As reported" are the temperatures of the velocities as a State has them.

Each run is a job of an ensemble, so that the command continues where it stopped; a run that diverged has nan. Means of
runs go to docs/default_temperatures.csv, from which the documentation makes its table.

    python benchmarks/default_temperatures.py
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
from functools import cache
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from one_line import simulation_of
from openmm_exactrb import ensemble
from openmm_exactrb.files import written_whole
from peptide import PEPTIDE
from protein import FORCE_FIELD

TABLE = Path(__file__).resolve().parents[1] / "docs" / "default_temperatures.csv"
TEMPERATURE, FRICTION, BOX = 300.0, 5.0, 1.95  # K, 1/ps, nm before the barostat
BURN, LOOKED = 4.0, 0.05  # ps that are not counted, and ps at least between two looks
R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
MAKERS = {"LangevinMiddle": openmm.LangevinMiddleIntegrator, "default": rb.ExactRigidBodyLangevinIntegrator}
MEASURED = ("T_tr", "T_rot", "T_solute", "T_rot reported", "T_solute reported", "U")
COLUMNS = ("method", "fs", "seed", "picoseconds", *MEASURED)
#: How createSystem makes the forces.
FORCES = {
    "nonbondedMethod": app.PME,
    "nonbondedCutoff": 0.8 * unit.nanometer,
    "switchDistance": 0.7 * unit.nanometer,
    "ewaldErrorTolerance": 1e-4,
    "removeCMMotion": False,
}


def pressed(system: openmm.System, frequency: int, seed: int) -> openmm.System:
    """Return a System with a barostat of 1 bar."""
    system = openmm.XmlSerializer.clone(system)
    barostat = openmm.MonteCarloBarostat(1.0, TEMPERATURE, frequency)
    barostat.setRandomNumberSeed(seed)
    system.addForce(barostat)
    return system


@cache
def prepared() -> tuple[app.Topology, openmm.System, openmm.State]:
    """Return the System and a start in the box that a barostat has made."""
    pdb, force_field = app.PDBFile(str(PEPTIDE)), app.ForceField(*FORCE_FIELD)
    modeller = app.Modeller(pdb.topology, pdb.positions)
    modeller.addSolvent(force_field, boxSize=openmm.Vec3(BOX, BOX, BOX) * unit.nanometer)
    system = force_field.createSystem(modeller.topology, constraints=app.HBonds, **FORCES)
    integrator = openmm.LangevinMiddleIntegrator(TEMPERATURE, FRICTION, 0.002)
    integrator.setRandomNumberSeed(1)
    run = simulation_of(modeller.topology, pressed(system, 10, 1), integrator)
    run.context.setPositions(modeller.positions)
    run.minimizeEnergy(maxIterations=200)
    run.context.setVelocitiesToTemperature(TEMPERATURE, 1)
    run.step(15_000)
    return modeller.topology, system, run.context.getState(positions=True, velocities=True)


class Estimator:
    """Temperatures in K from positions (nm) and velocities (nm/ps) of all particles.

    Parameters
    ----------
    topology, system
        Of a solute, followed by molecules of water of three particles each.
    """

    def __init__(self, topology: app.Topology, system: openmm.System) -> None:
        self.mass = np.array([system.getParticleMass(i)._value for i in range(system.getNumParticles())])
        water = [atom.index for atom in topology.atoms() if atom.residue.name == "HOH"]
        self.water = np.array(water).reshape(-1, 3)
        self.solute = np.setdiff1d(np.arange(len(self.mass)), water)
        pairs = (system.getConstraintParameters(i)[:2] for i in range(system.getNumConstraints()))
        self.constraints = np.array([pair for pair in pairs if pair[0] in self.solute]).T
        self.freedom = 3 * len(self.solute) - self.constraints.shape[1]

    def __call__(self, x: np.ndarray, v: np.ndarray) -> dict[str, float]:
        """Return the temperatures by name."""
        translation, rotation, reported = self._of_water(x[self.water], v[self.water])
        inner, raw = self._of_solute(x, v)
        n = 3 * len(self.water)
        energies = (translation / n, rotation / n, inner / self.freedom, reported / n, raw / self.freedom)
        return {name: 2.0 * energy / R for name, energy in zip(MEASURED, energies, strict=False)}

    def _of_water(self, x: np.ndarray, v: np.ndarray) -> tuple[float, float, float]:
        """Return kinetic energies of translation, of rotation as a rigid body, and of all that is no translation."""
        m = self.mass[self.water[0]][:, None]
        V = (m * v).sum(axis=1) / m.sum()
        r = x - (m * x).sum(axis=1, keepdims=True) / m.sum()
        L = (m * np.cross(r, v)).sum(axis=1)
        squares = np.einsum("kx,nki,nki->n", m, r, r)
        inertia = squares[:, None, None] * np.eye(3) - np.einsum("kx,nki,nkj->nij", m, r, r)
        translation = 0.5 * m.sum() * float((V * V).sum())
        rotation = 0.5 * float((L * np.linalg.solve(inertia, L[..., None])[..., 0]).sum())
        return translation, rotation, 0.5 * float((m * v * v).sum()) - translation

    def _of_solute(self, x: np.ndarray, v: np.ndarray) -> tuple[float, float]:
        """Return the kinetic energies of velocities without their parts along constraints, and of all of them."""
        m, before, after = self.mass[self.solute][:, None], v[self.solute], self.projected(x, v)
        return 0.5 * float((m * after * after).sum()), 0.5 * float((m * before * before).sum())

    def projected(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the velocities of the solute without their parts along constraints."""
        first, second = self.constraints
        m = np.repeat(self.mass[self.solute], 3)
        gradient = np.zeros((len(first), len(self.solute), 3))
        rows, bonds = np.arange(len(first)), x[first] - x[second]
        gradient[rows, np.searchsorted(self.solute, first)] = bonds
        gradient[rows, np.searchsorted(self.solute, second)] = -bonds
        gradient = gradient.reshape(len(first), -1)
        before = v[self.solute].ravel()
        along = np.linalg.solve((gradient / m) @ gradient.T, gradient @ before)
        return (before - gradient.T @ along / m).reshape(-1, 3)


def means_of(method: str, step: float, seed: int, picoseconds: float) -> dict[str, float]:
    """Return the means over a run: temperatures in K, potential energy in kJ/mol per molecule of water."""
    topology, system, start = prepared()
    integrator = MAKERS[method](TEMPERATURE, FRICTION, step)
    integrator.setRandomNumberSeed(seed)
    run = simulation_of(topology, system, integrator, start)
    run.context.setVelocitiesToTemperature(TEMPERATURE, seed)
    estimator, every, samples = Estimator(topology, system), math.ceil(LOOKED / step - 1e-9), []
    try:
        run.step(round(BURN / step))
        for _ in range(round(picoseconds / (every * step))):
            run.step(every)
            state = run.context.getState(positions=True, velocities=True, energy=True)
            arrays = (get(asNumpy=True)._value for get in (state.getPositions, state.getVelocities))
            samples.append(estimator(*arrays) | {"U": state.getPotentialEnergy()._value / len(estimator.water)})
            if not np.isfinite([*samples[-1].values()]).all():
                raise rb.NonFiniteError("a temperature or the energy is not finite")
    except (openmm.OpenMMException, rb.IntegrationError, np.linalg.LinAlgError):
        return dict.fromkeys(MEASURED, math.nan)
    return {name: float(np.mean([sample[name] for sample in samples])) for name in MEASURED}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--steps", type=float, nargs="+", default=[4.0, 6.0, 2.0], metavar="FS")
    add("--seeds", type=int, default=5, help="runs a point (%(default)s)")
    add("--picoseconds", type=float, default=100.0, help="length of a run (%(default)s)")
    add("--out", type=Path, default=Path("out/default_temperatures"), metavar="FOLDER")
    args = parser.parse_args()
    points = itertools.product(args.steps, range(1, args.seeds + 1), MAKERS)
    jobs = [
        ensemble.Job(means_of, method=method, step=fs / 1000.0, seed=seed, picoseconds=args.picoseconds)
        for fs, seed, method in points
    ]
    rows = []
    for result in ensemble.as_completed(jobs, args.out, workers=1):
        if result.error is not None:
            raise SystemExit(result.error)
        method, step, seed, picoseconds = result.job.arguments.values()
        values = (f"{result.value[name]:.7g}" for name in MEASURED)
        rows.append([method, f"{1000.0 * step:g}", seed, picoseconds, *values])
        print(*rows[-1], flush=True)
        with written_whole(TABLE) as out:
            table = csv.writer(out, lineterminator="\n")
            table.writerow(COLUMNS)
            table.writerows(sorted(rows))


if __name__ == "__main__":
    main()
