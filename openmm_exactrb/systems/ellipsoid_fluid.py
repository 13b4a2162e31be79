"""Liquids of uniaxial ellipsoids with the potential of Gay and Berne."""

from __future__ import annotations

import itertools

import numpy as np
import openmm
from openmm import app, unit

from openmm_exactrb.openmm_access.units import stripped
from openmm_exactrb.potentials import GayBerne, gay_berne_force
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array
from openmm_exactrb.systems.fluids import add_molecule, rigid_sites

# Smallest distance of neighbours on the lattice, relative to that at which they touch: closer neighbours overlap.
_CLOSEST = 0.9
# Distance from the centre to the point that defines the axis, in diameters.
_ARROW = 0.25
# Sites of the close-packed cubic cell, in units of its edges.
_CELL = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]])


def ellipsoids(
    n: int = 288,
    seed: int = 0,
    *,
    kappa: float = 3.0,
    kappa_prime: float = 5.0,
    mass: float | unit.Quantity = 1.0,
    sigma: float | unit.Quantity = 1.0,
    epsilon: float | unit.Quantity = 1.0,
    density: float | unit.Quantity | None = None,
    cutoff: float | unit.Quantity | None = None,
    switch: float | unit.Quantity | None = None,
) -> tuple[app.Topology, openmm.System, unit.Quantity]:
    """Build uniaxial ellipsoids in a cubic box, with the potential GB(kappa, kappa_prime, 2, 1) of Gay and Berne.

    See `openmm_exactrb.potentials.GayBerne` for the formula (doi:10.1063/1.441483). OpenMM's GayBerneForce multiplies
    these energies by a factor that depends on kappa if x is the axis of symmetry, and its torques are inconsistent with
    its energies if well depths depend on the direction (OpenMM 8.6). Arguments are numbers in the units stated below,
    or Quantities.

    Parameters
    ----------
    n : int
        Number of ellipsoids. They are parallel to z, on a close-packed lattice stretched along z. The lattice has no
        vacancies for 4 k² l ellipsoids, with k about kappa times l: 36, 288 or 972 for kappa = 3.
    seed : int
        Seed of the positions of vacancies in the lattice, and of the angles about the axes.
    kappa : float
        Length along the axis as a multiple of the diameter; below 1 for a disc.
    kappa_prime : float
        Well depth side by side as a multiple of the depth end to end; below 1 for a disc.
    mass : float
        Mass of an ellipsoid in amu. The moments of inertia are those of a uniform ellipsoid, mass sigma² (1 +
        kappa²)/20 across the axis and mass sigma²/10 about it.
    sigma, epsilon : float
        Diameter across the axis (nm), and well depth of two crossed ellipsoids (kJ/mol). The potential is shifted by
        sigma, or by the thickness kappa sigma of a disc.
    density : float, optional
        Ellipsoids per nm³; by default 0.9/(kappa sigma³).
    cutoff, switch : float, optional
        Cutoff of the energy of a pair and start of its switch, as distances between centres in nm; by default the
        longest diameter plus sigma, and 0.9 of the cutoff.

    Returns
    -------
    topology : openmm.app.Topology
        One residue ELL per ellipsoid: its sites with mass, and the virtual sites C (centre) and D, a quarter of sigma
        from C along the axis, with a bond between them.
    system : openmm.System
        Constraints hold the sites together. There are four sites with mass, since three would form a flat body.
    positions : Quantity
        Positions (n_particles, 3) in nm.

    Raises
    ------
    ValueError
        If a number is out of range, a unit is incompatible, the cutoff exceeds half the box, or the ellipsoids do not
        fit on the lattice.

    Notes
    -----
    If ellipsoids overlap so deeply that the formula would be attractive, the energy is nan, and a run ends with a
    `NonFiniteError`.
    """
    n, kappa = checks.whole(n, "n"), checks.positive(kappa, "kappa")
    kappa_prime = checks.positive(kappa_prime, "kappa_prime")
    mass = checks.positive(stripped(mass, unit.dalton), "mass", "amu")
    sigma = checks.positive(stripped(sigma, unit.nanometer), "sigma", "nm")
    epsilon = checks.positive(stripped(epsilon, unit.kilojoule_per_mole), "epsilon", "kJ/mol")
    density = 0.9 / (kappa * sigma**3) if density is None else stripped(density, unit.nanometer**-3)
    box = float((n / checks.positive(density, "density", "ellipsoids per nm³")) ** (1.0 / 3.0))
    cutoff, switch = _truncation(stripped(cutoff, unit.nanometer), stripped(switch, unit.nanometer), kappa, sigma)
    if cutoff > 0.5 * box:
        raise ValueError(
            f"the cutoff must be at most half the edge of the box, {0.5 * box:.6g} nm, not {cutoff:g} nm: use more "
            "ellipsoids, or a shorter cutoff"
        )
    centres = box * _lattice(n, np.random.default_rng(checks.whole(seed, "the seed", 0)), box / sigma, kappa)

    across, along = mass * sigma**2 * (1.0 + kappa**2) / 20.0, mass * sigma**2 / 10.0
    sites = rigid_sites(mass, (across, across, along))
    system, topology = openmm.System(), app.Topology()
    chain, places = topology.addChain(), {"C": np.zeros(3), "D": np.array([0.0, 0.0, _ARROW * sigma])}
    added = [add_molecule(system, topology, chain, "ELL", mass, sites, places) for _ in range(n)]
    potential = GayBerne(kappa, kappa_prime, sigma, epsilon, cutoff, switch)
    system.addForce(gay_berne_force([(centre, point) for centre, point in added], potential))
    vectors = box * np.eye(3)
    system.setDefaultPeriodicBoxVectors(*vectors)
    topology.setPeriodicBoxVectors(vectors * unit.nanometer)
    turned = np.einsum("nij,sj->nsi", _about_z(n, np.random.default_rng([seed, 1])), [*sites, *places.values()])
    return topology, system, unit.Quantity((centres[:, None] + turned).reshape(-1, 3), unit.nanometer)


def _truncation(cutoff: float | None, switch: float | None, kappa: float, sigma: float) -> tuple[float, float]:
    """Return the cutoff and the start of the switch (nm)."""
    cutoff = (max(1.0, kappa) + 1.0) * sigma if cutoff is None else checks.positive(cutoff, "cutoff", "nm")
    switch = 0.9 * cutoff if switch is None else checks.not_negative(switch, "switch")
    if switch >= cutoff:
        raise ValueError(f"switch must be below the cutoff of {cutoff:g} nm, not {switch:g} nm")
    return cutoff, switch


def _lattice(n: int, rng: np.random.Generator, box: float, kappa: float) -> Array:
    """Return n sites (n, 3) in a unit cube, on the close-packed lattice with the largest distance of neighbours.

    Vacancies are at random sites. Distances of neighbours are in units of the diameter, and along z in units of the
    length, so that ellipsoids touch at a distance of 1.
    """
    layers = [(k, -(-n // (4 * k * k))) for k in range(1, n + 1)]
    room = [_closest(box / k, box / (kappa * m)) for k, m in layers]
    k, m = layers[int(np.argmax(room))]
    if max(room) < _CLOSEST:
        raise ValueError(
            f"{n} parallel ellipsoids do not fit on a lattice at this density, because nearest neighbours would be at "
            f"{max(room):.2f} of the distance at which they touch: use a lower density, or another n"
        )
    cells = np.array(list(itertools.product(range(k), range(k), range(m))), dtype=np.float64)
    places = ((cells[:, None] + _CELL) / (k, k, m)).reshape(-1, 3)
    return np.asarray(places[np.sort(rng.choice(len(places), n, replace=False))])


def _closest(x: float, z: float) -> float:
    """Return the shortest distance in a close-packed lattice with cell edges x, x and z."""
    return float(min(x / 2.0**0.5, np.hypot(x, z) / 2.0, x, z))


def _about_z(n: int, rng: np.random.Generator) -> Array:
    """Return rotations (n, 3, 3) about z by random angles."""
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    Q = np.zeros((n, 3, 3))
    Q[:, 0, 0] = Q[:, 1, 1] = np.cos(angle)
    Q[:, 1, 0] = np.sin(angle)
    Q[:, 0, 1] = -Q[:, 1, 0]
    Q[:, 2, 2] = 1.0
    return Q
