"""Soft dipolar spheres: their force, and the function that its PythonForce calls."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context.dipole_boxes import NAME, SHORTEST, WRITTEN_FOR
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.potentials import compiled
from openmm_exactrb.potentials.boundaries import OPEN, Boundary, Ewald, Images, check_cutoff, checked, edges_of
from openmm_exactrb.potentials.formula import soft_dipole_bonds, soft_dipole_hbonds
from openmm_exactrb.potentials.spheres import SphereCutoff, cutoff_in
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array


def soft_dipole_force(
    arrows: Sequence[tuple[int, int]],
    *,
    strength: float,
    length: float,
    sigma: float = 1.0,
    epsilon: float = 1.0,
    attraction: float = 0.0,
    wca: bool = False,
    box: Sequence[float] | None = None,
    boundary: Boundary = OPEN,
    sphere_cutoff: float | None = None,
    sphere_switch: float | None = None,
    shifted: bool = False,
    kernel: str = "auto",
) -> openmm.CustomHbondForce | openmm.CustomCompoundBondForce | openmm.PythonForce:
    """Return the force of soft spheres with point dipoles.

    The energy of a pair is 4 epsilon (sigma/r)^12 + mu_i.mu_j/r³ - 3 (mu_i.r)(mu_j.r)/r^5, as in section 3.4 of
    Celledoni et al. (doi:10.1137/070704393). With an attraction of 1, the energy is that of the Stockmayer fluid.

    Parameters
    ----------
    arrows : sequence of (centre, tip)
        Particles or virtual sites of each body: the centre, and the tip at a distance of `length` along the dipole.
    strength : float
        Dipole moment in sqrt(kJ/mol nm³).
    length : float
        Distance between centre and tip in nm.
    sigma, epsilon : float
        Size (nm) and strength (kJ/mol) of the soft spheres.
    attraction : float
        Factor of the Lennard-Jones attraction -4 epsilon (sigma/r)^6: 1 for the Stockmayer fluid.
    wca : bool
        Whether the energy of the spheres is truncated at its minimum, and shifted to be zero there (Weeks, Chandler and
        Andersen, J. Chem. Phys. 54, 5237 (1971)). With an attraction of 1, these are the repulsive spheres of many
        ferrofluid models. The second derivative is discontinuous at the minimum, so no scheme keeps an order above 2.
    box : sequence of three float, optional
        Edges in nm of a rectangular periodic box, for `ReactionField` and `Ewald`; also set them with
        ``System.setDefaultPeriodicBoxVectors``.
    boundary : Open, ReactionField or Ewald
        Surroundings of the sample: nothing, a dielectric beyond a cutoff, or all periodic images. The cutoff and the
        switch of a boundary apply to the dipoles only.
    sphere_cutoff, sphere_switch : float, optional
        Cutoff of the energy of two spheres in a box and start of its switch, in nm. The default cutoff is 3 sigma, or
        half the shortest edge of the box if that is less; the switch begins at three quarters of the cutoff. A run ends
        with an error if a barostat shrinks the box below twice a cutoff; pass shorter cutoffs with a barostat.
    shifted : bool
        Whether to subtract the energy of two spheres at the cutoff from their energy before the switch is applied.
    kernel : {"auto", "openmm", "bonds", "compiled"}
        Type of the force. "auto" or "compiled": a kernel in double precision on all cores, the fastest on a CPU.
        "openmm": a `CustomHbondForce` if there is a cutoff, which OpenCL, CUDA and HIP evaluate on the device. "bonds":
        a `CustomCompoundBondForce` with a bond for each pair, which supports cutoffs up to half the box, also on these
        devices. `Ewald` needs the compiled kernel.

    Returns
    -------
    openmm.CustomHbondForce, openmm.CustomCompoundBondForce or openmm.PythonForce
        The force, with the Context parameters `soft_repulsion` (4 epsilon sigma^12), `dipole_coupling`
        ((strength/length)²) and, with an attraction, `soft_attraction` (4 epsilon sigma^6 times the attraction).
        In double precision, energies and forces of the three types agree to 1e-13.

    Raises
    ------
    ValueError
        If the kernel is unknown, arrows are not pairs of particles, a number is out of range, box and boundary are
        incompatible, an Ewald sum has too many waves or a kernel other than the compiled one, or, with "openmm", cutoff
        + 2 length reaches half the shortest edge.

    Notes
    -----
    All three types use the box of the Context. The box must be rectangular with "bonds" and the compiled kernel. With
    "bonds", the formula measures the edges of the box. They must be from 0.62 to 2.1 times the Context parameters
    `box_x`, `box_y` and `box_z`, which are initially the argument `box`, and at least the Context parameter
    `shortest_edge`, which is twice the longest cutoff. Otherwise the energy is nan. For a much larger or smaller box,
    set `box_x`, `box_y` and `box_z` to its edges. The `CustomHbondForce` moves centres and tips to their nearest images
    individually, and is silently wrong if an edge is less than its Context parameter `shortest_edge`, 2 (cutoff + 2
    length). In a box in which a force is not valid, the integrators of this package raise a ValueError. With "openmm",
    they also raise a ValueError if there is a barostat.

    XmlSerializer writes the compiled kernel's settings with pickle, as for every PythonForce.
    """
    arrows = checked_pairs(arrows)
    edges = None if box is None else edges_of(box)
    truncation = checked(boundary).truncation(edges, len(arrows))
    spheres = spheres_of(edges, sigma, attraction, sphere_cutoff, sphere_switch, shifted=shifted, wca=wca)
    kernel = _chosen(kernel, needs_compiled=isinstance(boundary, Ewald))
    parameters = context_parameters(strength, length, sigma, epsilon, attraction, wca=wca)
    if kernel == "compiled":
        dipoles = SoftDipoles(truncation, boundary.images(len(arrows), edges), wca=wca, spheres=spheres)
        force = openmm.PythonForce(dipoles, parameters)
        force.setParticles(list(itertools.chain(*arrows)))
        force.setUsesPeriodicBoundaryConditions(boundary.periodic)
    elif kernel == "openmm" and truncation is not None and edges is not None and spheres is not None:
        _check_tips(truncation[0], float(length), edges)
        parameters[SHORTEST] = 2.0 * max(truncation[0] + 2.0 * float(length), spheres.cutoff)
        force = soft_dipole_hbonds(arrows, parameters, truncation, spheres, wca=wca)
    else:
        if truncation is not None and edges is not None and spheres is not None:
            parameters |= zip(WRITTEN_FOR, edges, strict=True)
            parameters[SHORTEST] = 2.0 * max(truncation[0], spheres.cutoff)
        force = soft_dipole_bonds(arrows, parameters, truncation, spheres, wca=wca)
        force.setUsesPeriodicBoundaryConditions(boundary.periodic)
    force.setName(NAME)
    return force


def spheres_of(
    edges: Sequence[float] | None,
    sigma: float,
    attraction: float,
    cutoff: float | None,
    switch: float | None,
    *,
    shifted: bool,
    wca: bool,
) -> SphereCutoff | None:
    """Return the cutoff of the spheres, None without a box; raise ValueError if the box is too small."""
    found = cutoff_in(edges, checks.positive(sigma, "sigma", "nm"), cutoff, switch, shifted=shifted)
    if wca and attraction > 0.0:
        if shifted:
            raise ValueError("wca=True already shifts the energy of the spheres to zero at its minimum: omit shifted=")
        end = (2.0 / attraction) ** (1.0 / 6.0) * sigma
        if found is not None and found.switch < end:
            raise ValueError(
                f"the switch of the spheres begins at {found.switch:g} nm, before the minimum of their energy at "
                f"{end:g} nm: set sphere_switch= beyond this minimum, in a larger box if necessary"
            )
    return found


def _chosen(kernel: str, *, needs_compiled: bool) -> str:
    """Return the kernel of the force: "openmm", "bonds" or "compiled". An Ewald sum needs "compiled"."""
    if kernel not in ("auto", "openmm", "bonds", "compiled"):
        raise ValueError(f"the kernel {kernel!r} is unknown: choose one of auto, openmm, bonds, compiled")
    if needs_compiled and kernel not in ("auto", "compiled"):
        raise ValueError(
            "only the compiled kernel computes an Ewald sum in a single force: use kernel='compiled', "
            "dipole_rod_forces (two forces) or boundary=ReactionField()"
        )
    return "compiled" if kernel == "auto" else kernel


def _check_tips(cutoff: float, length: float, edges: Sequence[float]) -> None:
    """Raise ValueError if the tips of two arrows within the cutoff may be nearer to another image (lengths in nm)."""
    half, reach = 0.5 * min(edges), cutoff + 2.0 * length
    if not reach < half:
        raise ValueError(
            f"kernel='openmm' needs cutoff + 2 * length below half the shortest edge of the box, {half:g} nm, but this "
            f"sum is {reach:g} nm: use a shorter cutoff, a larger box, or kernel='bonds'"
        )


def checked_pairs(pairs: Any, name: str = "arrow", ends: str = "centre, tip") -> list[tuple[int, int]]:
    """Return arrows as pairs of particles; raise ValueError if a particle occurs twice."""
    rows = checks.lists_of_indices(pairs, f"{name}s")
    if not rows:
        raise ValueError(f"soft dipoles need at least one {name}, a pair of particles ({ends}), such as (0, 1)")
    for row in rows:
        if len(row) != 2 or min(row) < 0:
            raise ValueError(f"each {name} must be a pair of particles ({ends}), such as (0, 1), not {tuple(row)}")
    particles = list(itertools.chain(*rows))
    if len({*particles}) < len(particles):
        twice = next(i for i in particles if particles.count(i) > 1)
        raise ValueError(f"particle {twice} occurs twice in the {name}s: use two separate particles for each {name}")
    return [(first, second) for first, second in rows]


def context_parameters(
    strength: float, length: float, sigma: float, epsilon: float, attraction: float, *, wca: bool
) -> dict[str, float]:
    """Return the parameters of a Context, which all kernels read."""
    strength, length = checks.number(strength, "strength"), checks.positive(length, "length", "nm")
    sigma, epsilon = checks.positive(sigma, "sigma", "nm"), checks.not_negative(epsilon, "epsilon")
    parameters = {"soft_repulsion": 4.0 * epsilon * sigma**12, "dipole_coupling": (strength / length) ** 2}
    if checks.number(attraction, "attraction"):
        parameters["soft_attraction"] = 4.0 * epsilon * sigma**6 * attraction
    if wca and not (attraction > 0.0 and epsilon > 0.0):
        raise ValueError("wca=True needs an energy with a minimum: set attraction and epsilon to positive numbers")
    return parameters


class SoftDipoles:
    """The picklable function that the PythonForce of soft dipoles calls.

    Parameters
    ----------
    truncation : (cutoff, switch, reaction), optional
        Distances in nm and the strength of the reaction field in 1/nm³. With a truncation, the boundaries are periodic.
    ewald : (alpha, k_max, dielectric) or (alpha, steps, order, dielectric), optional
        An Ewald sum instead of the reaction field: inverse width of the Gaussians (1/nm); the largest wave number
        (1/nm), or the spacings of a mesh along the edges (nm) and the order of its splines; and the relative
        permittivity around all images.
    wca : bool
        Whether the energy of the spheres is truncated at its minimum.
    spheres : SphereCutoff, optional
        Cutoff of the spheres if there is a truncation; by default that of the dipoles.
    """

    # Pickles in System XML name this module and the attributes.
    __module__ = "openmm_exactrb.potentials"
    #: Default for Systems that were written before the spheres had a separate cutoff.
    spheres: tuple[float, float, bool] | None = None

    def __init__(
        self,
        truncation: tuple[float, float, float] | None = None,
        ewald: Images | None = None,
        *,
        wca: bool = False,
        spheres: SphereCutoff | None = None,
    ) -> None:
        self.truncation = truncation
        self.ewald = ewald
        self.wca = wca
        if spheres is not None:
            self.spheres = spheres.cutoff, spheres.switch, spheres.shifted

    def __call__(self, state: openmm.State) -> tuple[float, Array]:
        """Return the energy (kJ/mol) and the forces (kJ/mol/nm) on alternating centres and tips."""
        box = self.truncation and state.getPeriodicBoxVectors(asNumpy=True)._value
        return self.energy_and_forces(arrays.positions(state), dict(state.getParameters()), box)

    def energy_and_forces(
        self, positions: Array, parameters: Mapping[str, float], box: Array | None = None, threads: int | None = None
    ) -> tuple[float, Array]:
        """Return the energy (kJ/mol) and the forces (2 n, 3) (kJ/mol/nm) on alternating centres and tips.

        Parameters
        ----------
        positions : (2 n, 3) array
            In nm: the centre and the tip of the first arrow, then those of the second, and so on.
        parameters : mapping
            Context parameters `soft_repulsion` (kJ/mol nm^12), `dipole_coupling` (kJ/mol nm) and, with an attraction,
            `soft_attraction` (kJ/mol nm^6).
        box : (3, 3) array, optional
            Vectors of the periodic box in nm, required with a truncation.
        threads : int, optional
            Number of threads, by default chosen from the number of pairs. Results are bit-identical for any number.

        Raises
        ------
        ValueError
            If the box is not rectangular or too small, or the energy of truncated spheres has no minimum.
        """
        return compiled.load("pairs").soft_dipoles(  # type: ignore[no-any-return]
            positions,
            parameters["soft_repulsion"],
            parameters["dipole_coupling"],
            self.truncation and self._in_box(box, parameters),
            threads,
            attraction=parameters.get("soft_attraction", 0.0),
            minimum=_minimum(parameters) if self.wca else None,
            ewald=self.ewald,
        )

    def _in_box(self, box: Array | None, parameters: Mapping[str, float]) -> tuple[float, ...]:
        """Return the truncation in the form that the kernel uses."""
        assert self.truncation is not None
        if box is None or np.count_nonzero(box) != 3:
            raise ValueError("soft dipoles need a rectangular box: set orthogonal box vectors")
        cutoff, switch, reaction = self.truncation
        end, begin, shifted = self.spheres or (cutoff, switch, False)
        a, b, c = map(float, box.diagonal())
        check_cutoff(end, (a, b, c), "sphere_cutoff")
        check_cutoff(cutoff, (a, b, c), "the cutoff of the boundary")
        of_dipoles = float(cutoff**2), 1.0 / (cutoff**2 - switch**2), reaction
        shift = parameters["soft_repulsion"] * end**-12 - parameters.get("soft_attraction", 0.0) * end**-6
        of_spheres = float(end**2), 1.0 / (end**2 - begin**2), float(shift) if shifted else 0.0
        return a, b, c, float(max(cutoff, end) ** 2), *of_dipoles, *of_spheres


def _minimum(parameters: Mapping[str, float]) -> tuple[float, float]:
    """Return the squared distance (nm²) where the spheres' energy has its minimum, and the depth (kJ/mol)."""
    repulsion = parameters["soft_repulsion"]
    if not repulsion > 0.0:
        raise ValueError(f"with wca=True, the Context parameter soft_repulsion must be positive, not {repulsion}")
    ratio = parameters["soft_attraction"] / repulsion
    return (2.0 / ratio) ** (1.0 / 3.0) if ratio > 0.0 else math.inf, 0.25 * ratio**2 * repulsion
