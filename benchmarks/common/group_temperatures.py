"""Temperatures of water and of the groups of a solute, from the positions and velocities of any integrator.

Temperatures are computed from the linear and angular momenta of each water molecule, and from the velocities of the
solute after projection onto its constraints. "Reported" temperatures are computed from the velocities of a State, which
may have components along constraints.
"""

from __future__ import annotations

import math

import numpy as np
import openmm
from openmm import app

from benchmarks.common.starts import R, masses_of


def of_rigid(masses: np.ndarray, x: np.ndarray, v: np.ndarray) -> tuple[float, float, float]:
    """Return kinetic energies of molecules: of translation, of rotation as rigid bodies, and of all but translation.

    Masses (k,) are those of a molecule, positions and velocities (n, k, 3) those of all.
    """
    m = masses[:, None]
    V = (m * v).sum(axis=1) / m.sum()
    r = x - (m * x).sum(axis=1, keepdims=True) / m.sum()
    L = (m * np.cross(r, v)).sum(axis=1)
    squares = np.einsum("kx,nki,nki->n", m, r, r)
    inertia = squares[:, None, None] * np.eye(3) - np.einsum("kx,nki,nkj->nij", m, r, r)
    translation = 0.5 * m.sum() * float((V * V).sum())
    rotation = 0.5 * float((L * np.linalg.solve(inertia, L[..., None])[..., 0]).sum())
    return translation, rotation, 0.5 * float((m * v * v).sum()) - translation


class Groups:
    """Temperatures in K from positions (nm) and velocities (nm/ps) of all particles.

    A group of the solute is an atom with the hydrogens that constraints hold at it, and no other constraints. Centres
    of groups and what turns about them have temperatures of their own.

    Parameters
    ----------
    topology, system
        Of a solute, followed by molecules of water of three particles each.
    """

    def __init__(self, topology: app.Topology, system: openmm.System) -> None:
        self.mass = masses_of(system)
        water = [atom.index for atom in topology.atoms() if atom.residue.name == "HOH"]
        self.water = np.array(water).reshape(-1, 3)
        self.solute = np.setdiff1d(np.arange(len(self.mass)), water)
        pairs = (system.getConstraintParameters(i)[:2] for i in range(system.getNumConstraints()))
        self.constraints = np.array([pair for pair in pairs if pair[0] in self.solute]).T
        self.freedom = 3 * len(self.solute) - self.constraints.shape[1]
        light = {atom.index for atom in topology.atoms() if atom.element is app.element.hydrogen}
        pairs = [(i, j) if j in light else (j, i) for i, j in self.constraints.T.tolist()]
        self.separate = all(j in light and i not in light for i, j in pairs)  # not with AllBonds
        bearer = np.arange(len(self.mass))
        for i, j in pairs:
            bearer[j] = i
        _, self.group = np.unique(bearer[self.solute], return_inverse=True)
        self.centres = 3 * (1 + int(self.group.max()))

    def __call__(self, x: np.ndarray, v: np.ndarray) -> dict[str, float]:
        """Return the temperatures by name."""
        translation, rotation, reported = of_rigid(self.mass[self.water[0]], x[self.water], v[self.water])
        m, n, after = self.mass[self.solute], 3 * len(self.water), self.projected(x, v)
        inner, raw = (0.5 * float((m[:, None] * u * u).sum()) for u in (after, v[self.solute]))
        kinetic = {
            "T_tr": translation / n,
            "T_rot": rotation / n,
            "T_solute": inner / self.freedom,
            "T_centres": math.nan,
            "T_XH": math.nan,
            "T_rot reported": reported / n,
            "T_solute reported": raw / self.freedom,
        }
        if self.separate:
            momenta = [np.bincount(self.group, m * part) for part in after.T]
            centres = 0.5 * float((np.square(momenta) / np.bincount(self.group, m)).sum())
            kinetic["T_centres"] = centres / self.centres
            kinetic["T_XH"] = (inner - centres) / (self.freedom - self.centres)
        return {name: 2.0 * energy / R for name, energy in kinetic.items()}

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
