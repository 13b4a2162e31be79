"""Functions that build Systems and return (topology, system, positions)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from numpy.typing import ArrayLike
from openmm import app, unit

from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.openmm_access.units import stripped
from openmm_exactrb.potentials import Ewald, dipole_rod_forces, dipole_strength, rod_length, soft_dipole_force
from openmm_exactrb.potentials.boundaries import OPEN, Boundary, checked
from openmm_exactrb.potentials.spheres import cutoff_in
from openmm_exactrb.potentials.spheres import long_range_correction as correction_of
from openmm_exactrb.support import checks
from openmm_exactrb.support.messages import shown
from openmm_exactrb.support.types import Array
from openmm_exactrb.systems.lattices import cubic_lattice, filling, places_a_side

_MOMENT = unit.dalton * unit.nanometer**2
_STIFFNESS = unit.kilojoule_per_mole / unit.nanometer**2
# Smallest ratio of the least to the largest moment of inertia: thinner bodies have inaccurate distances between sites.
_THINNEST = 1e-6
#: Equilibrium distance in nm of two head-to-tail dipoles of Celledoni et al. (doi:10.1137/070704393): r^9 = 4.
BINDING_DISTANCE = 4.0 ** (1.0 / 9.0)

_TRIANGLE = np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]]) * 2.0**0.5
_TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])


def rigid_sites(mass: float | unit.Quantity, inertia: ArrayLike | unit.Quantity) -> Array:
    """Return the positions of equal masses with exactly these principal moments of inertia.

    Parameters
    ----------
    mass : float or Quantity
        Total mass, in amu if it has no unit.
    inertia : (3,) array_like or Quantity
        Principal moments, in amu nm² if they have no unit. Each is at most the sum of the other two.

    Returns
    -------
    (3, 3) or (4, 3) array
        Positions in nm: a triangle for a planar body, whose largest moment is the sum of the other two, otherwise a
        tetrahedron. The masses are mass/3 or mass/4, the centre of mass is the origin, and the principal axes are the
        coordinate axes.

    Raises
    ------
    ValueError
        If no body has these moments, or the body is linear or nearly linear.
    """
    each = stripped(inertia, _MOMENT)
    each = [stripped(moment, _MOMENT) for moment in each] if np.iterable(each) else each
    moments = checks.array(each, "inertia", "three positive moments in amu nm²")
    if moments.shape != (3,) or not (np.isfinite(moments).all() and (moments > 0.0).all()):
        raise ValueError(
            f"inertia must be three positive moments in amu nm² (linear bodies are not supported), not {shown(inertia)}"
        )
    mass = checks.positive(stripped(mass, unit.dalton), "mass", "amu")
    if moments.min() < _THINNEST * moments.max():
        raise ValueError(
            f"a body with the moments of inertia {moments.tolist()} is nearly linear: make the smallest at least "
            f"{_THINNEST:g} of the largest"
        )
    spread = 0.5 * moments.sum() - moments
    flat = np.abs(spread) < 1e-12 * moments.max()
    if (spread[~flat] < 0.0).any():
        raise ValueError(
            f"no body has the moments of inertia {moments.tolist()}: make each at most the sum of the other two"
        )
    if not flat.any():
        return np.asarray(_TETRAHEDRON * np.sqrt(spread / mass))
    sites = np.zeros((3, 3))
    sites[:, ~flat] = _TRIANGLE * np.sqrt(spread[~flat] / mass)
    return sites


def dipole_fluid(
    n: int = 125,
    seed: int = 0,
    *,
    mass: float | unit.Quantity = 1.0,
    inertia: ArrayLike | unit.Quantity = (1.0, 1.88, 2.88),
    dipole: ArrayLike = (0.0, 1.0, 1.0),
    sigma: float | unit.Quantity = 1.0,
    epsilon: float | unit.Quantity = 1.0,
    attraction: float = 0.0,
    wca: bool = False,
    spacing: float | unit.Quantity = BINDING_DISTANCE,
    perturbation: float = 0.01,
    trap: float | unit.Quantity = 0.0,
    boundary: Boundary = OPEN,
    density: float | unit.Quantity | None = None,
    sphere_cutoff: float | unit.Quantity | None = None,
    sphere_switch: float | unit.Quantity | None = None,
    shifted: bool = False,
    long_range_correction: bool | None = None,
    kernel: str = "auto",
) -> tuple[app.Topology, openmm.System, unit.Quantity]:
    """Build soft dipolar spheres: a droplet, as in section 3.4 of Celledoni et al., or a liquid in a periodic box.

    Arguments are numbers in the units stated below, or Quantities.

    Parameters
    ----------
    n : int
        Number of spheres, on the first sites of a cubic lattice about the origin, with random orientations.
    seed : int
        Seed of the displacements from the lattice and of the orientations.
    mass : float
        Mass of a sphere in amu.
    inertia : (3,) array_like
        Principal moments in amu nm², the smallest at least 1e-6 of the largest.
    dipole : (3,) array_like or Quantity
        Dipole moment along the principal axes, in sqrt(kJ/mol nm³), or with a unit (e nm, debye).
    sigma, epsilon : float
        Size (nm) and strength (kJ/mol) of the soft sphere.
    attraction : float
        Factor of the Lennard-Jones attraction: 0 for soft spheres, 1 for the Stockmayer fluid.
    wca : bool
        Whether the Lennard-Jones potential of spheres with an attraction is truncated at its minimum, so that they only
        repel each other. No scheme keeps an order above 2 in this case.
    spacing : float
        Lattice constant in nm.
    perturbation : float
        Standard deviation of the positions about the lattice, relative to the lattice constant.
    trap : float
        Strength k in kJ/mol/nm² of a harmonic trap k r²/2 about the origin, which acts on the centres. Without a trap,
        a droplet of soft dipoles dissolves into chains, which drift apart.
    boundary : Open, ReactionField or Ewald
        With `ReactionField` or `Ewald` the spheres fill a cubic box, on a lattice given by `density` instead of
        `spacing`.
    density : float, optional
        Spheres per nm³ in the box; by default 0.8/sigma³, a liquid.
    sphere_cutoff, sphere_switch : float, optional
        Cutoff of the energy of two spheres in the box and start of its switch, in nm. The default cutoff is 3 sigma, or
        half the edge of the box if that is less. The switch begins at three quarters of the cutoff. Both are
        independent of the cutoff of the dipoles, which the boundary defines.
    shifted : bool
        Whether to subtract the energy of two spheres at the cutoff from their energy.
    long_range_correction : bool, optional
        Whether a second force adds the long-range correction of energy and pressure. By default this force is added in
        a periodic box, unless the potential is shifted or truncated at its minimum (`wca`), or the cutoff of the
        spheres is within their diameter `sigma`, where the correction is not defined.
    kernel : {"auto", "openmm", "bonds", "compiled"}
        Type of the force; see `soft_dipole_force`. With `Ewald`, "openmm" uses the two forces of
        `openmm_exactrb.potentials.dipole_rod_forces`, which OpenMM evaluates on the device, and which reach a tolerance
        of 1e-4.

    Returns
    -------
    topology : openmm.app.Topology
        One residue per sphere: its sites with mass, and the virtual sites C (centre) and D (tip of the dipole) with a
        bond between them. With `Ewald` and kernel="openmm", the charged ends of a rod, P and N, precede C.
    system : openmm.System
        Constraints hold the sites together, and the potential acts on the virtual sites.
    positions : Quantity
        Positions (n_particles, 3) in nm.

    Raises
    ------
    ValueError
        If a number is out of range, a unit is incompatible, or an option does not apply to the boundary.
    """
    sigma, spacing = stripped(sigma, unit.nanometer), stripped(spacing, unit.nanometer)
    mass, epsilon = stripped(mass, unit.dalton), stripped(epsilon, unit.kilojoule_per_mole)
    trap, density = stripped(trap, _STIFFNESS), stripped(density, unit.nanometer**-3)
    direction, strength = _direction_and_strength(dipole)
    n, sigma = checks.whole(n, "n"), checks.positive(sigma, "sigma", "nm")
    epsilon, spacing = checks.positive(epsilon, "epsilon", "kJ/mol"), checks.positive(spacing, "spacing", "nm")
    perturbation = checks.not_negative(perturbation, "perturbation")
    trap = checks.not_negative(trap, "trap")
    box = _box(n, sigma, density, trap, boundary)
    sites = rigid_sites(mass, inertia)

    system, topology = openmm.System(), app.Topology()
    chain = topology.addChain()
    cutoff, switch = stripped(sphere_cutoff, unit.nanometer), stripped(sphere_switch, unit.nanometer)
    law: dict[str, Any] = {"sigma": sigma, "epsilon": epsilon, "attraction": attraction, "wca": wca}
    law |= {"sphere_cutoff": cutoff, "sphere_switch": switch, "shifted": shifted}
    edges = None if box is None else (box, box, box)
    field: dict[str, Any] = {"strength": strength, "boundary": boundary, "box": edges}
    places = {"C": np.zeros(3), "D": 0.5 * sigma * direction}
    rod = rod_length(n, field["box"], boundary) if isinstance(boundary, Ewald) and kernel == "openmm" else 0.0
    if rod:
        places = {"P": 0.5 * rod * direction, "N": -0.5 * rod * direction} | places
    added = [add_molecule(system, topology, chain, "DIP", mass, sites, places) for _ in range(n)]
    for part in _sphere_forces(added, system.getNumParticles(), rod, kernel, law | field):
        system.addForce(part)
    if _is_corrected(edges, law) if long_range_correction is None else long_range_correction:
        system.addForce(correction_of(n, edges, **law))
    if box is not None:
        spacing = box / places_a_side(n)
        system.setDefaultPeriodicBoxVectors(*(box * np.eye(3)))
        topology.setPeriodicBoxVectors(box * np.eye(3) * unit.nanometer)
    if trap > 0.0:
        system.addForce(_harmonic_trap([centre for *_, centre, _ in added], trap))

    rng = np.random.default_rng(checks.whole(seed, "the seed", 0))
    lattice = spacing * (cubic_lattice(n) - 0.5 * (places_a_side(n) - 1))
    centres = lattice + perturbation * spacing * rng.standard_normal((n, 3))
    return topology, system, _turned(rng, centres, np.vstack([sites, *places.values()]))


def _direction_and_strength(dipole: ArrayLike) -> tuple[Array, float]:
    try:
        parts = [*dipole]  # type: ignore[misc]
    except TypeError:  # also for a Quantity of one number, which has __iter__
        parts = []
    vector = np.asarray([dipole_strength(part) for part in parts], dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise ValueError(f"dipole must be a non-zero vector of three finite numbers, not {shown(dipole)}")
    strength = float(np.linalg.norm(vector))
    return vector / strength, strength


def _sphere_forces(
    added: Sequence[Sequence[int]], particles: int, rod: float, kernel: str, spheres: dict[str, Any]
) -> Iterable[openmm.Force]:
    """Return the forces on molecules with given virtual sites: C, D and, with a rod, its two ends."""
    if not rod:
        arrows = [(centre, tip) for centre, tip in added]
        return [soft_dipole_force(arrows, length=0.5 * spheres["sigma"], kernel=kernel, **spheres)]
    ends, centres = [(plus, minus) for plus, minus, *_ in added], [centre for *_, centre, _ in added]
    return dipole_rod_forces(ends, particles, length=rod, centres=centres, **spheres)


def _is_corrected(edges: Sequence[float] | None, law: Mapping[str, Any]) -> bool:
    """Return whether spheres have a long-range correction by default."""
    sigma, shifted = law["sigma"], law["shifted"]
    spheres = cutoff_in(edges, sigma, law["sphere_cutoff"], law["sphere_switch"], shifted=shifted)
    return spheres is not None and spheres.cutoff > sigma and not (shifted or law["wca"])


def _turned(rng: np.random.Generator, centres: Array, shape: Array) -> unit.Quantity:
    """Return the positions of molecules of a given shape (k, 3) at given centres, with random orientations."""
    Q = quaternions.rotation_matrix(quaternions.random(rng, len(centres)))
    positions = centres[:, None] + np.einsum("nij,sj->nsi", Q, shape)
    return unit.Quantity(positions.reshape(-1, 3), unit.nanometer)


def _box(n: int, sigma: float, density: float | None, trap: float, boundary: Boundary) -> float | None:
    """Return the edge of the cubic box of a liquid (nm), or None for a droplet."""
    if not checked(boundary).periodic:
        if density is not None:
            raise ValueError("density needs a periodic box: add boundary=ReactionField() or boundary=Ewald()")
        return None
    density = 0.8 / sigma**3 if density is None else checks.positive(density, "density", "spheres per nm³")
    if trap > 0.0:
        raise ValueError("trap= applies only to a droplet, not to a periodic liquid: omit trap=")
    return float((n / density) ** (1.0 / 3.0))


def _harmonic_trap(centres: list[int], strength: float) -> openmm.CustomExternalForce:
    force = openmm.CustomExternalForce("0.5*trap*(x*x + y*y + z*z)")
    force.setName("HarmonicTrap")
    force.addGlobalParameter("trap", strength)
    for centre in centres:
        force.addParticle(centre, [])
    return force


def add_molecule(
    system: openmm.System,
    topology: app.Topology,
    chain: app.topology.Chain,
    name: str,
    mass: float,
    sites: Array,
    places: Mapping[str, Array],
) -> tuple[int, ...]:
    """Add a rigid molecule with virtual sites at given positions and a bond between the last two; return the sites."""
    first, k = system.getNumParticles(), len(sites)
    particles = list(range(first, first + k))
    residue = topology.addResidue(name, chain)
    for i, particle in enumerate(particles):
        system.addParticle(mass / k)
        topology.addAtom(f"M{i + 1}", None, residue)
        for j in range(i):
            system.addConstraint(first + j, particle, float(np.linalg.norm(sites[i] - sites[j])))
    for label, place in places.items():
        site = system.addParticle(0.0)
        system.setVirtualSite(site, _body_fixed_site(particles, sites, place))
        topology.addAtom(label, None, residue)
    topology.addBond(*list(residue.atoms())[-2:])
    return tuple(range(first + k, first + k + len(places)))


def _body_fixed_site(particles: list[int], sites: Array, place: Array) -> openmm.OutOfPlaneSite:
    """Return a virtual site at a position given in the principal axes of the body.

    OpenMM computes this type of site in a third of the time of a LocalCoordinatesSite.
    """
    to_second, to_third = sites[1] - sites[0], sites[2] - sites[0]
    normal, place = np.cross(to_second, to_third), place - sites[0]
    # Cramer's rule, unlike LAPACK, gives the same bits on every machine. This is required because the text of a System
    # identifies a run.
    columns = np.cross(place, to_third), np.cross(to_second, place), place
    weights = (np.array(columns) * normal).sum(axis=1) / (normal * normal).sum() + _OFF_FRACTIONS
    return openmm.OutOfPlaneSite(*particles[:3], *map(float, weights))


# Products with a weight of exactly 1/3 are rounded with a bias. The forces that OpenMM distributes from a site would
# then have a torque error of 1e-14 with a nonzero mean. With other weights the rounding errors average out.
_OFF_FRACTIONS = np.array([3e-14, -5e-14, 0.0])


# Force field file, O-H distance in nm and H-O-H angle in degrees.
_WATER_MODELS: dict[str, tuple[str, float, float]] = {
    "tip3p": ("tip3p.xml", 0.09572, 104.52),
    "spce": ("spce.xml", 0.1, 109.47),
    "tip4pew": ("tip4pew.xml", 0.09572, 104.52),
    "tip5p": ("tip5p.xml", 0.09572, 104.52),
    "tip4p2005": (str(Path(__file__).with_name("tip4p2005.xml")), 0.09572, 104.52),
}


def rigid_water(
    n: int = 64, seed: int = 0, *, model: str = "tip3p", spacing: float | unit.Quantity = 0.3104, **options: Any
) -> tuple[app.Topology, openmm.System, unit.Quantity]:
    """Build rigid water on a lattice with random orientations.

    Parameters
    ----------
    n : int
        Number of molecules. A droplet occupies the first sites of a cubic lattice; in a periodic cube there are no
        vacancies.
    seed : int
        Seed of the orientations.
    model : {"tip3p", "spce", "tip4pew", "tip5p", "tip4p2005"}
        Water model, from a force field file of OpenMM or of this package (TIP4P/2005, doi:10.1063/1.2121687).
    spacing : float or Quantity
        Lattice constant in nm, the cube root of the volume per molecule. By default the density is that of water, 1.000
        g/cm³, for any number of molecules in a periodic box.
    **options
        Arguments of `openmm.app.ForceField.createSystem`, with the defaults rigidWater=True and removeCMMotion=False. A
        periodic nonbondedMethod creates a periodic cube.

    Returns
    -------
    topology : openmm.app.Topology
    system : openmm.System
    positions : Quantity
        Positions (n_particles, 3) in nm. Minimise the energy before a run.

    Raises
    ------
    ValueError
        If the model is unknown, a number is out of range, or TIP4P/2005 is requested with ``rigidWater=False``,
        since it has no force constants of bonds and angles.
    """
    if model not in _WATER_MODELS:
        raise ValueError(f"the water model {model!r} is unknown: choose one of {', '.join(_WATER_MODELS)}")
    n, spacing = checks.whole(n, "n"), checks.positive(stripped(spacing, unit.nanometer), "spacing", "nm")
    file, distance, angle = _WATER_MODELS[model]
    topology = app.Topology()
    chain = topology.addChain()
    for _ in range(n):
        residue = topology.addResidue("HOH", chain)
        oxygen = topology.addAtom("O", app.element.oxygen, residue)
        for name in ("H1", "H2"):
            topology.addBond(oxygen, topology.addAtom(name, app.element.hydrogen, residue))
    places = cubic_lattice(n)
    if options.get("nonbondedMethod", app.NoCutoff) not in (app.NoCutoff, app.CutoffNonPeriodic):
        places, edge = filling(n)
        topology.setUnitCellDimensions(openmm.Vec3(*3 * [edge * spacing]) * unit.nanometer)
    half = np.radians(angle) / 2.0
    x, z = distance * np.sin(half), distance * np.cos(half)
    shape = np.array([[0.0, 0.0, 0.0], [x, 0.0, z], [-x, 0.0, z]])
    positions = _turned(np.random.default_rng(checks.whole(seed, "the seed", 0)), spacing * (places + 0.5), shape)
    force_field = app.ForceField(file)
    modeller = app.Modeller(topology, positions)
    modeller.addExtraParticles(force_field)
    system = force_field.createSystem(modeller.topology, **({"rigidWater": True, "removeCMMotion": False} | options))
    if model == "tip4p2005" and system.getNumConstraints() < 3 * n:
        raise ValueError(
            "tip4p2005 has no force constants for bonds and angles: omit rigidWater=False, or use model='tip4pew'"
        )
    placed = np.array(modeller.positions.value_in_unit(unit.nanometer))
    return modeller.topology, system, unit.Quantity(placed, unit.nanometer)
