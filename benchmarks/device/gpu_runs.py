"""Runs of proteins and of water on a GPU, which stop when their time is over and continue with the same command.

A run stores its samples and a checkpoint in a folder, and writes a row to a CSV file whenever it stops.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mdtraj
import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.records import Record
from benchmarks.common.starts import R, masses_of
from benchmarks.device.device_drift import Energies, slopes

COLUMNS = ("system", "precision", "platform", "integrator", "fs"), ("ps", "of ps", "ns/day", "ended", "results")


@dataclass
class Run:
    """A run of a System from a State to a length in ps, with a sample of numbers every so many ps.

    Attributes
    ----------
    name, label : str
        The names of the system and of the integrator.
    make : callable
        make() -> an integrator.
    fs : float
        Time between two force evaluations.
    sample : callable
        sample(context) -> an array of numbers.
    summary : callable
        summary(times in ps, samples (n, k)) -> results by name.
    """

    name: str
    label: str
    system: openmm.System
    start: openmm.State
    make: Callable[[], Any]
    fs: float
    ps: float
    every: float
    sample: Callable[[Any], np.ndarray]
    summary: Callable[[np.ndarray, np.ndarray], dict[str, str]]

    def go_on(self, platform: openmm.Platform, precision: str, folder: Path, seconds: float) -> bool:
        """Continue for at most so many seconds, and write a row; return whether the run has ended."""
        end = time.perf_counter() + seconds
        integrator = self.make()
        properties = {"Precision": precision} if "Precision" in platform.getPropertyNames() else {}
        context = openmm.Context(openmm.XmlSerializer.clone(self.system), integrator, platform, properties)
        context.setState(self.start)
        if not isinstance(integrator, rb.ExactRigidBodyIntegrator):
            context.applyConstraints(1e-6)  # of bonds that the start does not constrain
        file, found, day, ended = folder / self._file(platform, precision), [], 0.0, ""
        if file.exists():
            kept = np.load(file)
            found, day = kept["found"].tolist(), float(kept["day"])
            context.loadCheckpoint(kept["checkpoint"].tobytes())
        steps = max(round(self.every / integrator.getStepSize()._value), 1)
        wanted, begin, made = round(self.ps / self.every), time.perf_counter(), 0
        while len(found) < wanted and not ended and (not made or time.perf_counter() < end):
            try:
                integrator.step(steps)
                values = self.sample(context)
                ended = "" if np.isfinite(values).all() else "not finite"
            except (openmm.OpenMMException, rb.IntegrationError) as error:
                ended = str(error).splitlines()[0]
            if not ended:
                made += 1
                found.append([context.getTime()._value, *values])
        if made:
            day = 86.4 * made * self.every / (time.perf_counter() - begin)
        if made and not ended:
            folder.mkdir(exist_ok=True)
            with rb.written_whole(file, "wb") as out:
                np.savez(out, found=found, day=day, checkpoint=np.frombuffer(context.createCheckpoint(), np.uint8))
        times, *samples = np.array(found).T if found else np.zeros((1, 0))
        row = (self.name, precision, platform.getName(), self.label, self.fs, len(found) * self.every, self.ps)
        results = (
            "; ".join(f"{name} {value}" for name, value in self.summary(times, np.array(samples).T).items())
            if found
            else ""
        )
        Record(folder.with_name(f"{folder.name}_runs.csv"), *COLUMNS).add(
            dict(zip(sum(COLUMNS, ()), (*row, f"{day:.0f}", ended or "no", results), strict=True))
        )
        return bool(ended) or len(found) >= wanted

    def _file(self, platform: openmm.Platform, precision: str) -> str:
        return f"{self.name}-{self.label}-{self.fs}-{platform.getName()}-{precision}.npz".replace(" ", "-")


def with_error(values: np.ndarray) -> str:
    """Return a mean and its standard error by ten blocks."""
    blocks = np.array([block.mean() for block in np.array_split(values, min(10, len(values)))])
    return f"{values.mean():.4g}({blocks.std() / max(len(blocks) - 1, 1) ** 0.5:.2g})"


# -- proteins ----------------------------------------------------------------------------------------------------------


class ProteinSamples:
    """Temperatures of solute and water, the potential energy, and the RMSD and the share of helix of a protein."""

    def __init__(self, topology: app.Topology, system: openmm.System, positions: np.ndarray) -> None:
        waters = (residue for residue in topology.residues() if residue.name in ("HOH", "WAT"))
        water = [atom.index for residue in waters for atom in residue.atoms()]
        self._mass = mass = masses_of(system)
        is_water = np.isin(np.arange(len(mass)), water)
        self._parts = [(mass > 0.0) & (is_water == wanted) for wanted in (False, True)]
        first = [system.getConstraintParameters(k)[0] for k in range(system.getNumConstraints())]
        self._freedom = [3 * part.sum() - part[first].sum() for part in self._parts]
        whole = mdtraj.Topology.from_openmm(topology)
        self._chosen = whole.select("protein")
        self._topology = whole.subset(self._chosen) if len(self._chosen) else None
        self._first = self._trajectory(positions)

    def _trajectory(self, positions: np.ndarray) -> mdtraj.Trajectory | None:
        return None if self._topology is None else mdtraj.Trajectory(positions[self._chosen][None], self._topology)

    def temperatures(self, context: Any) -> list[float]:
        """Return the temperatures of solute and water, of velocities without components along constraints."""
        before = context.getState(velocities=True).getVelocities(asNumpy=True)
        v = before._value
        if not isinstance(context.getIntegrator(), rb.ExactRigidBodyIntegrator):  # whose velocities have none
            context.applyVelocityConstraints(1e-6)
            v = context.getState(velocities=True).getVelocities(asNumpy=True)._value
            context.setVelocities(before)
        twice = self._mass * (v * v).sum(axis=1)
        of_parts = zip(self._parts, self._freedom, strict=True)
        return [twice[part].sum() / (R * n) if n else np.nan for part, n in of_parts]

    def __call__(self, context: Any) -> np.ndarray:
        """Return temperatures of solute and water (K), the energy (kJ/mol), the RMSD (nm) and the share of helix."""
        state = context.getState(positions=True, energy=True)
        frame = self._trajectory(state.getPositions(asNumpy=True)._value)
        structure = [0.0, 0.0]
        if frame is not None:
            alpha = self._topology.select("name CA")
            structure = [float(mdtraj.rmsd(frame, self._first, 0, alpha)[0]) if len(alpha) > 2 else 0.0]
            structure.append(float((mdtraj.compute_dssp(frame) == "H").mean()))
        return np.array([*self.temperatures(context), state.getPotentialEnergy()._value, *structure])

    @staticmethod
    def summary(times: np.ndarray, samples: np.ndarray) -> dict[str, str]:
        """Return means with errors, of the second half for the structure."""
        names = "solute K", "water K", "potential kJ/mol", "RMSD nm", "helix"
        half = len(samples) // 2
        return {name: with_error(samples[half * (k > 2) :, k]) for k, name in enumerate(names)}


# -- energies of water -------------------------------------------------------------------------------------------------


class EnergySamples:
    """The total energy of water per molecule, its potential part in double precision."""

    def __init__(self, system: openmm.System, platform: openmm.Platform) -> None:
        self._energies = Energies(system, platform)
        self._molecules = len(self._energies.double.getMolecules())

    def __call__(self, context: Any) -> np.ndarray:
        """Return the energy (kJ/mol)."""
        return np.array([self._energies.present(context) / self._molecules])

    @staticmethod
    def summary(times: np.ndarray, samples: np.ndarray) -> dict[str, str]:
        """Return the slope of the energy, and the deviation from the line."""
        if len(times) < 8:
            return {}
        slope, error, spread = slopes(1e-3 * times, samples[:, 0])
        return {"drift kJ/mol/ns": f"{slope:.2e}({error:.1e})", "deviation kJ/mol": f"{spread:.2e}"}


def in_turn(runs: list[Run], platform: openmm.Platform, precision: str, folder: Path, seconds: float) -> None:
    """Continue runs for so many seconds, each with an equal share of the time that is left."""
    end = time.perf_counter() + seconds
    for number, run in enumerate(runs):
        left = end - time.perf_counter()
        if left > 0.0:
            run.go_on(platform, precision, folder, left / (len(runs) - number))
