"""Dipoles as rods of two charges, for an Ewald sum that OpenMM computes on the device."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import openmm

from openmm_exactrb.context.dipole_boxes import NAME, SHORTEST
from openmm_exactrb.openmm_access.units import COULOMB
from openmm_exactrb.potentials.boundaries import Edges, Ewald, edges_of
from openmm_exactrb.potentials.dipoles import checked_pairs, context_parameters, spheres_of
from openmm_exactrb.potentials.ewald import mean_distance
from openmm_exactrb.potentials.formula import add_hbonds, soft_rod_energy
from openmm_exactrb.support import checks

#: Smallest tolerance. Below this tolerance, OpenMM's mesh of order 5 needs more than ten points per dipole along an
#: edge.
LEAST_TOLERANCE = 1e-4


def dipole_rod_forces(
    rods: Sequence[tuple[int, int]],
    particles: int,
    *,
    strength: float,
    length: float,
    sigma: float = 1.0,
    epsilon: float = 1.0,
    attraction: float = 0.0,
    wca: bool = False,
    box: Sequence[float],
    boundary: Ewald,
    centres: Sequence[int],
    sphere_cutoff: float | None = None,
    sphere_switch: float | None = None,
    shifted: bool = False,
) -> tuple[openmm.NonbondedForce, openmm.CustomHbondForce]:
    """Return OpenMM's own forces for soft spheres with point dipoles and all periodic images.

    Two charges at the ends of a rod represent each dipole in the particle mesh Ewald sum of a `NonbondedForce`. Within
    the cutoff a `CustomHbondForce` adds the energy of the spheres, and the energy of point dipoles minus the Coulomb
    energy of the rods, with the switch of `soft_dipole_force`. Beyond the cutoff the octupoles of the rods remain,
    which cause relative errors of 0.2 to 0.4 (length/cutoff)² in the torques.

    Parameters
    ----------
    rods : sequence of (plus, minus)
        Particles or virtual sites at the ends of the rod of each body, `length` apart and centred about its dipole.
    particles : int
        Number of particles of the System.
    strength, sigma, epsilon, attraction, wca, box, sphere_cutoff, sphere_switch, shifted
        As in `soft_dipole_force`.
    length : float
        Distance between the ends in nm; `rod_length` returns a suitable value.
    boundary : Ewald
        An Ewald sum with an infinite dielectric constant. The tolerance, at least 1e-4, determines the splitting and
        the mesh. Errors are within the tolerance in double precision, and at least 2e-4 in single precision. The
        default cutoff is three times the mean distance of the dipoles, at most 0.45 of the shortest edge.
    centres : sequence of int
        Particles or virtual sites in the middle of the rods.

    Returns
    -------
    openmm.NonbondedForce, openmm.CustomHbondForce
        The second force has the Context parameters `soft_repulsion` and `soft_attraction` of `soft_dipole_force`, and
        `shortest_edge`, below which the forces are wrong. The dipole moment cannot be changed in a Context.

    Raises
    ------
    ValueError
        If rods are not pairs of particles, a number is out of range, or rods do not support the boundary.

    Notes
    -----
    The splitting and the mesh are chosen from errors measured in liquids of 125 and 1000 dipoles. The real-space sum of
    the `NonbondedForce` ends at the cutoff without a switch. Unlike with the compiled kernel, the energy therefore has
    small jumps at the cutoff, which limit the energy error of every scheme.
    """
    rods, edges = checked_pairs(rods, "rod", "plus, minus"), edges_of(box)
    cutoff, switch = _distances(len(rods), edges, boundary)
    parameters = context_parameters(strength, length, sigma, epsilon, attraction, wca=wca)
    spheres = spheres_of(edges, sigma, attraction, sphere_cutoff, sphere_switch, shifted=shifted, wca=wca)
    assert spheres is not None
    if len(centres) != len(rods):
        raise ValueError(
            f"centres must contain one particle for each rod, so the length must be {len(rods)}, not {len(centres)}"
        )
    if not cutoff + length < 0.5 * min(edges):
        raise ValueError(
            f"cutoff + length, {cutoff + length:g} nm, must be below half the shortest edge of the box, "
            f"{0.5 * min(edges):g} nm: use a larger box, a shorter cutoff or shorter rods"
        )
    coupling = parameters.pop("dipole_coupling")
    alpha, spacing = _mesh(len(rods), edges, cutoff, length, boundary.tolerance)
    charges = openmm.NonbondedForce()
    charges.setName("DipoleRods")
    charges.setNonbondedMethod(charges.PME)
    charges.setCutoffDistance(cutoff)
    charges.setUseDispersionCorrection(False)
    charges.setPMEParameters(alpha, *(math.ceil(edge / spacing) for edge in edges))
    charge = (coupling / COULOMB) ** 0.5
    of_particle = {end: sign * charge for rod in rods for end, sign in zip(rod, (1.0, -1.0), strict=True)}
    for i in range(checks.whole(particles, "particles", least=1 + max(of_particle))):
        charges.addParticle(of_particle.get(i, 0.0), 1.0, 0.0)
    for plus, minus in rods:
        charges.addException(plus, minus, 0.0, 1.0, 0.0)
    attracts = "soft_attraction" in parameters
    energy = soft_rod_energy((cutoff, switch, 0.0), spheres, coupling, length, attracts=attracts, wca=wca)
    parameters[SHORTEST] = 2.0 * max(cutoff + length, spheres.cutoff)
    near = openmm.CustomHbondForce(energy)
    middle_and_plus = [(centre, plus) for centre, (plus, _) in zip(centres, rods, strict=True)]
    add_hbonds(near, middle_and_plus, parameters, max(cutoff, spheres.cutoff))
    near.setName(NAME)
    return charges, near


def rod_length(n: int, box: Sequence[float], boundary: Ewald) -> float:
    """Return a length (nm) of n rods at which the errors of octupoles are within the tolerance of the boundary."""
    cutoff, _ = _distances(n, edges_of(box), boundary)
    return cutoff * min(0.1, math.sqrt(2.0 * boundary.tolerance))


def _distances(n: int, edges: Edges, boundary: Ewald) -> tuple[float, float]:
    """Return the cutoff and the start of the switch (nm); raise ValueError if rods do not support the boundary."""
    if not isinstance(boundary, Ewald) or not math.isinf(boundary.dielectric):
        raise ValueError(f"rods of charges need boundary=Ewald() with an infinite dielectric, not {boundary!r}")
    if boundary.tolerance < LEAST_TOLERANCE:
        raise ValueError(
            f"the tolerance of rods of charges must be at least {LEAST_TOLERANCE:g}, not {boundary.tolerance:g}: use a "
            "larger tolerance, or kernel='compiled' in soft_dipole_force or dipole_fluid"
        )
    if boundary.cutoff is None:
        boundary = replace(boundary, cutoff=min(3.0 * mean_distance(n, edges), 0.45 * min(edges)))
    return boundary.distances(edges)


def _mesh(n: int, edges: Edges, cutoff: float, length: float, tolerance: float) -> tuple[float, float]:
    """Return OpenMM's alpha (1/nm) and the largest spacing of its mesh (nm) for a tolerance of the forces.

    With the mean distance a of dipoles, measured errors are exp(-(alpha cutoff)²) (a/length)^1.5 for the real-space
    sum, because the cutoff separates charges of a rod, and 0.01 (alpha spacing)³ (alpha a)^4 for the mesh.
    """
    a = mean_distance(n, edges)
    alpha = math.sqrt(math.log(max(2.0 / tolerance * (a / length) ** 1.5, math.e))) / cutoff
    return alpha, min(0.4, math.pow(70.0 * tolerance / (alpha * a) ** 4, 1.0 / 3.0)) / alpha
