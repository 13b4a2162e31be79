"""Structure and diffusion of a solute in water: torsions of a peptide, and distances between oxygens."""

from __future__ import annotations

import itertools
import math

import numpy as np
from openmm import app

# Of the torsions: parts of the time in the helix, with phi > 0 and, the rest, stretched; and how often psi went.
CONFORMATIONS = ("helical", "left", "psi crossings")
EDGES = np.arange(0.22, 0.5, 0.005)  # nm, of the histogram of O-O distances


def dihedrals(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return torsions in degrees, IUPAC's sign, of positions (..., 3)."""
    axis = c - b
    normal, other = np.cross(a - b, axis), np.cross(axis, d - c)
    along = (np.cross(normal, other) * axis).sum(axis=-1) / np.linalg.norm(axis, axis=-1)
    return -np.degrees(np.arctan2(along, -(normal * other).sum(axis=-1)))


def regions(phi: np.ndarray, psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which torsions (degrees) are helical, and which have phi > 0."""
    left = phi > 0.0
    return ~left & (psi > -120.0) & (psi < 50.0), left


def backbone(topology: app.Topology) -> dict[str, list[int]] | None:
    """Return the atoms of phi and psi of the peptide's one residue between two caps; None for other solutes."""
    chain = next(topology.chains())
    residues = [{atom.name: atom.index for atom in residue.atoms()} for residue in chain.residues()]
    if [residue.name for residue in chain.residues()] != ["ACE", "ALA", "NME"]:
        return None
    before, alanine, after = residues
    return {
        "phi": [before["C"], *(alanine[name] for name in ("N", "CA", "C"))],
        "psi": [*(alanine[name] for name in ("N", "CA", "C")), after["N"]],
    }


def conformations(torsions: list[tuple[float, float]]) -> dict[str, float]:
    """Return the parts of samples of (phi, psi) in two regions, and the crossings of the helix's border."""
    if not torsions:
        return dict.fromkeys(CONFORMATIONS, math.nan)
    phi, psi = np.array(torsions).T
    helical, left = regions(phi, psi)
    # A crossing is from within one region to within the other, 20 degrees behind the border.
    inside, outside = helical & (psi > -100.0) & (psi < 30.0), ~helical & (np.abs(psi - 150.0) % 360.0 < 80.0)
    visits = [bool(a) for a, b in zip(inside, outside, strict=True) if a or b]
    crossings = sum(a != b for a, b in itertools.pairwise(visits))
    return dict(zip(CONFORMATIONS, (helical.mean(), left.mean(), crossings), strict=True))


def distances(x: np.ndarray, edge: float) -> np.ndarray:
    """Return the histogram of the distances between places in a cube."""
    counts = np.zeros(len(EDGES) - 1)
    for i in range(len(x) - 1):
        apart = x[i + 1 :] - x[i]
        apart -= edge * np.round(apart / edge)
        counts += np.histogram(np.sqrt((apart * apart).sum(axis=1)), EDGES)[0]
    return counts


def peak_of(counts: np.ndarray, frames: int, n: int, volume: float) -> float:
    """Return the first maximum of g(r), from the counts of so many frames of n oxygens."""
    shells = 4.0 / 3.0 * np.pi * np.diff(EDGES**3)
    return float((counts / (frames * 0.5 * n * (n - 1) / volume * shells)).max())


def diffusion(centres: list[np.ndarray], lag: float) -> float:
    """Return the coefficient (1e-5 cm²/s) of places a lag (ps) apart, by displacements of about 2 ps and of 8 ps."""
    short, long = max(1, round(2.0 / lag)), max(2, round(8.0 / lag))
    if len(centres) < 3 * long:
        return math.nan
    x = np.array(centres)
    x -= x.mean(axis=1, keepdims=True)
    squares = [((x[k:] - x[:-k]) ** 2).sum(axis=2).mean() for k in (short, long)]
    return float((squares[1] - squares[0]) / (6.0 * (long - short) * lag) * 1e3)
