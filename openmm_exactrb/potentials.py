"""Potentials between rigid bodies as OpenMM forces; each is one function that returns a Force.

OpenMM's units, amu, nm, ps and kJ/mol, are a consistent set: reduced units map to them one to one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb import kernels, vectors

# Coulomb's constant in kJ/mol nm/e², CODATA 2018, as OpenMM has it.
_COULOMB = 138.93545764438198
# 1 D = 1e-21/c C m, over the elementary charge.
_DEBYE_IN_E_NM = 1e-21 / 299792458.0 / 1.602176634e-19 * 1e9
# An Ewald sum of this many waves takes 100 MB, and 1 ms a dipole.
_MOST_WAVES = 1_000_000


def dipole_strength(dipole: unit.Quantity | float) -> float:
    """Convert a dipole moment to sqrt(kJ/mol nm³), where the energy of two dipoles is mu²/r³ times an angle's factor.

    Parameters
    ----------
    dipole : Quantity or float
        A moment in units of charge times length (e nm, debye), or a number that already is in sqrt(kJ/mol nm³).

    Raises
    ------
    ValueError
        If the unit is not one of a dipole moment.

    Examples
    --------
    >>> from openmm import unit
    >>> round(dipole_strength(2.35 * unit.debye), 4)  # SPC/E water
    0.5767
    """
    quantity: Any = dipole
    if not unit.is_quantity(quantity):
        return float(quantity)
    if quantity.unit == unit.debye:
        # OpenMM's own factor, 0.0208227 e nm, is off by 1.6e-4.
        quantity = quantity._value * _DEBYE_IN_E_NM * unit.elementary_charge * unit.nanometer
    try:
        return float(quantity.value_in_unit(unit.elementary_charge * unit.nanometer) * _COULOMB**0.5)
    except TypeError:
        raise ValueError(
            f"{dipole} is not a dipole moment: give it in e nm or debye, or as a number in sqrt(kJ/mol nm^3)"
        ) from None


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
    cutoff: float | None = None,
    switch: float | None = None,
    dielectric: float = np.inf,
    long_range: str = "reaction field",
    ewald_tolerance: float = 1e-4,
    kernel: str = "auto",
) -> openmm.CustomCompoundBondForce | openmm.PythonForce:
    """Soft spheres with a point dipole: 4 epsilon (sigma/r)^12 + mu_i.mu_j/r³ - 3 (mu_i.r)(mu_j.r)/r^5 over all pairs.

    Section 3.4 of the paper; with `attraction` the Stockmayer fluid. With a box the boundaries are periodic: the
    nearest image within a cutoff, the field of a dielectric around it, -2 (eps - 1)/(2 eps + 1) mu_i.mu_j/a³ for a pair
    (Barker and Watts, Mol. Phys. 26, 789 (1973)), and a switch S on the whole energy, proportional to the integral of
    (s (1 - s))^6 from 0 to s, where s runs from 1 to 0 in r² between `switch` and `cutoff`: forces have five continuous
    derivatives, as schemes of order 6 need them. The radius a³ = 3 integral S r² dr is that of a sharp sphere with the
    same volume: a uniform polarisation then has the reaction field that `dielectric` asks for, which the fluctuation
    formula of `dielectric_constant` relies on.

    An Ewald sum (de Leeuw, Perram and Smith, Proc. R. Soc. A 373, 27 (1980)) takes the dipoles of all images, and the
    switch then acts on the spheres and on next to nothing of the dipoles. It too has an exact gradient: whatever its
    tolerance, in a fixed box it is as smooth as the switch, and a symplectic scheme keeps its energy. Where the box
    changes, the energy jumps by up to about the tolerance.

    Parameters
    ----------
    arrows : sequence of (centre, tip)
        Particles or virtual sites of each body: its centre, and a point at `length` from it along its dipole.
    strength : float
        Dipole moment in sqrt(kJ/mol nm³).
    length : float
        Distance between centre and tip in nm.
    sigma, epsilon : float
        In nm and kJ/mol.
    attraction : float
        How much of the attraction -4 epsilon (sigma/r)^6 of Lennard-Jones there is: 1 for the Stockmayer fluid.
    wca : bool
        Whether the spheres' energy ends at its minimum, raised to be zero there (Weeks, Chandler and Andersen, J. Chem.
        Phys. 54, 5237 (1971)): with an attraction of 1 the repulsive spheres of many a ferrofluid. The second
        derivative has a step there: take a scheme of order 2, none keeps a higher one.
    box : sequence of three float, optional
        Edges in nm of a rectangular periodic box.
    cutoff, switch : float, optional
        In nm; half the shortest edge and three quarters of the cutoff.
    dielectric : float
        Relative permittivity around the cutoff sphere: infinity for a conductor, 1 for truncation without a field. With
        an Ewald sum, around all images.
    long_range : {"reaction field", "ewald"}
        What stands for dipoles beyond the cutoff in a periodic box. The Ewald sum needs the compiled kernel.
    ewald_tolerance : float
        Error of the dipoles' forces and fields, as a part of their root mean square in a liquid or gas.
    kernel : {"auto", "openmm", "compiled"}
        Who computes it: OpenMM from a formula, or a compiled kernel in double precision on all cores, which needs
        numba and is some fifty times faster on a CPU. "auto" takes the compiled one where numba is installed; on a
        GPU platform ask for "openmm", which stays on the device.

    Returns
    -------
    openmm.CustomCompoundBondForce or openmm.PythonForce
        Both have the Context parameters `soft_repulsion`, 4 epsilon sigma^12, `dipole_coupling`, (strength/length)²,
        and with an attraction `soft_attraction`, 4 epsilon sigma^6 times it. Energies and forces agree to 1e-13.

    Raises
    ------
    ValueError
        If the kernel is unknown, there is no arrow, a number is out of its range, the cutoffs do not fit the box, or an
        Ewald sum has no box, too many waves, or another kernel than the compiled one.
    ModuleNotFoundError
        If the compiled kernel is asked for, or an Ewald sum, and numba is not installed.

    Notes
    -----
    OpenMM's formula has products of coordinates, one reciprocal and one square root: its compiler makes this three
    times faster than the same energy in `distance` or in powers of r. Its box is the Context parameters `box_x`,
    `box_y` and `box_z`, which a barostat does not change; the compiled kernel follows the box of the Context.

    XmlSerializer writes the compiled kernel's settings with pickle, as it does for every PythonForce.
    """
    if not arrows:
        raise ValueError("soft dipoles need at least one arrow (centre, tip)")
    if not dielectric >= 1.0:
        raise ValueError(f"dielectric must be at least 1, not {dielectric}")
    if not np.isfinite(attraction):
        raise ValueError(f"attraction must be a finite number, not {attraction}")
    if wca and not attraction > 0.0:
        raise ValueError("without an attraction there is no minimum: wca needs a positive one, 1 for Lennard-Jones")
    if long_range not in ("reaction field", "ewald"):
        raise ValueError(f"unknown long_range {long_range!r}: choose one of reaction field, ewald")
    truncation = ewald = None
    if box is not None:
        truncation = _truncation(box, cutoff, switch, 1.0 if long_range == "ewald" else dielectric)
        if long_range == "ewald":
            _check_ewald(ewald_tolerance, kernel)
            kernel, ewald = "compiled", (*_splitting(len(arrows), box, truncation, ewald_tolerance), dielectric)
    elif long_range == "ewald":
        raise ValueError("an Ewald sum needs a periodic box")
    parameters = {"soft_repulsion": 4.0 * epsilon * sigma**12, "dipole_coupling": (strength / length) ** 2}
    if attraction:
        parameters["soft_attraction"] = 4.0 * epsilon * sigma**6 * attraction
    if kernels.chosen(kernel):
        force = openmm.PythonForce(SoftDipoles(truncation, ewald, wca=wca), parameters)
        force.setParticles(list(itertools.chain(*arrows)))
    else:
        force = _soft_dipole_formula(arrows, truncation, attracts=bool(attraction), wca=wca)
        for name, value in (parameters | _box_parameters(box)).items():
            force.addGlobalParameter(name, value)
    force.setUsesPeriodicBoundaryConditions(box is not None)
    force.setName("SoftDipoleForce")
    return force


class SoftDipoles:
    """What the PythonForce of soft dipoles computes; it can be pickled.

    Parameters
    ----------
    truncation : (cutoff, switch, reaction), optional
        Distances in nm and the strength of the reaction field in 1/nm³; with it the boundaries are periodic.
    ewald : (alpha, k_max, dielectric), optional
        An Ewald sum in place of the reaction field: inverse width of the clouds and largest wave number, in 1/nm, and
        relative permittivity around all images.
    wca : bool
        Whether the spheres' energy ends at its minimum.
    """

    def __init__(
        self,
        truncation: tuple[float, float, float] | None = None,
        ewald: tuple[float, float, float] | None = None,
        *,
        wca: bool = False,
    ) -> None:
        self.truncation = truncation
        self.ewald = ewald
        self.wca = wca

    def __call__(self, state: openmm.State) -> tuple[float, NDArray[np.float64]]:
        """Return energy (kJ/mol) and forces (kJ/mol/nm) on centres and tips in turns."""
        parameters = dict(state.getParameters())
        repulsion, minimum = parameters["soft_repulsion"], None
        if self.wca:
            if not repulsion > 0.0:
                raise ValueError(f"spheres with a minimum need a positive soft_repulsion, not {repulsion}")
            ratio = parameters["soft_attraction"] / repulsion
            minimum = (2.0 / ratio) ** (1.0 / 3.0) if ratio > 0.0 else math.inf, 0.25 * ratio**2 * repulsion
        energy, forces = kernels.load("pairs_compiled").soft_dipoles(
            vectors.positions(state),
            repulsion,
            parameters["dipole_coupling"],
            self.truncation and self._in_box(state.getPeriodicBoxVectors(asNumpy=True)._value),
            attraction=parameters.get("soft_attraction"),
            minimum=minimum,
            ewald=self.ewald,
        )
        return energy, forces

    def _in_box(self, vectors: NDArray[np.float64]) -> tuple[float, float, float, float, float, float]:
        """Return the truncation as the kernel takes it."""
        assert self.truncation is not None
        cutoff, switch, reaction = self.truncation
        edges = vectors.diagonal()
        if np.count_nonzero(vectors) != 3:
            raise ValueError("soft dipoles need a rectangular box")
        _check_cutoff(cutoff, edges)
        a, b, c = map(float, edges)
        return a, b, c, cutoff**2, 1.0 / (cutoff**2 - switch**2), reaction


def _truncation(
    box: Sequence[float], cutoff: float | None, switch: float | None, dielectric: float
) -> tuple[float, float, float]:
    """Return cutoff, begin of the switch, and strength of the reaction field."""
    edges = np.asarray(box, dtype=np.float64)
    if edges.shape != (3,) or not (np.isfinite(edges).all() and (edges > 0.0).all()):
        raise ValueError(f"box must be three positive edges, not {box!r}")
    cutoff = 0.5 * float(edges.min()) if cutoff is None else cutoff
    _check_cutoff(cutoff, edges)
    switch = 0.75 * cutoff if switch is None else switch
    if not 0.0 <= switch < cutoff:
        raise ValueError(f"switch must be between 0 and the cutoff {cutoff:g}, not {switch}")
    return cutoff, switch, 2.0 * (1.0 - 1.0 / dielectric) / (2.0 + 1.0 / dielectric) / _sharp_volume(cutoff, switch)


def _check_ewald(tolerance: float, kernel: str) -> None:
    """Raise what keeps an Ewald sum from being made."""
    if not 1e-13 <= tolerance <= 1e-2:
        raise ValueError(f"ewald_tolerance must be between 1e-13 and 1e-2, not {tolerance}")
    kernels.require()
    if not kernels.chosen(kernel):
        raise ValueError(
            "only the compiled kernel has an Ewald sum: ask for kernel='compiled', or for long_range='reaction field'"
        )


def _splitting(
    n: int, box: Sequence[float], truncation: tuple[float, float, float], tolerance: float
) -> tuple[float, float]:
    """Return inverse width of the clouds, alpha, and largest wave number of an Ewald sum.

    What is left out of either sum is a Gaussian, exp(-x²) with x = alpha switch or y = k_max/(2 alpha), times powers of
    x or y and of a, alpha times the distance between dipoles: the sums over random dipoles have these powers. The
    factors before them are the largest that were measured in liquids and gases of 8 to 256 dipoles.
    """
    cutoff, switch, _ = truncation
    switch = max(switch, 1e-3 * cutoff)  # refused below, and not a division by zero
    x = y = 3.0
    distance = (math.prod(box) / n) ** (1.0 / 3.0)
    for _ in range(60):
        a = x * distance / switch
        x = math.log(max(a**2.5 * x**1.5 / tolerance, math.e)) ** 0.5
        y = math.log(max(0.7 * a**2.5 * y**1.5 / tolerance, 0.9 * a**3 * y / tolerance, math.e)) ** 0.5
    alpha = x / switch
    waves = kernels.load("ewald_compiled").number_of_waves(box, 2.0 * alpha * y)
    if waves > _MOST_WAVES:
        raise ValueError(
            f"an Ewald sum with a switch at {switch:g} nm and a tolerance of {tolerance:g} needs {waves:.2g} waves, "
            f"more than {_MOST_WAVES}: let the switch begin farther out, or ask for less"
        )
    return alpha, 2.0 * alpha * y


def _sharp_volume(cutoff: float, switch: float) -> float:
    """Return 3 integral S(r) r² dr, the cube of the radius of a sharp sphere with the volume of the switched one."""
    x, weights = np.polynomial.legendre.leggauss(15)  # exact: a polynomial of degree 28
    r = switch + 0.5 * (cutoff - switch) * (1.0 + x)
    t = 2.0 * (cutoff**2 - r**2) / (cutoff**2 - switch**2) - 1.0
    S = 0.5 + np.polynomial.polynomial.polyval(t**2, [3003, -6006, 9009, -8580, 5005, -1638, 231]) * t / 2048.0
    return switch**3 + 1.5 * (cutoff - switch) * float(weights @ (S * r**2))


def _check_cutoff(cutoff: float, edges: NDArray[np.float64]) -> None:
    if not 0.0 < cutoff <= 0.5 * float(edges.min()) * (1.0 + 1e-12):
        raise ValueError(f"cutoff must be positive and at most half the box, {0.5 * edges.min():g} nm, not {cutoff}")


def _box_parameters(box: Sequence[float] | None) -> dict[str, float]:
    return {} if box is None else {f"box_{axis}": float(edge) for axis, edge in zip("xyz", box, strict=True)}


def _soft_dipole_formula(
    arrows: Sequence[tuple[int, int]], truncation: tuple[float, float, float] | None, *, attracts: bool, wca: bool
) -> openmm.CustomCompoundBondForce:
    """Return the potential as a formula for OpenMM, with all pairs as bonds."""
    core = "soft_repulsion*i^6 - soft_attraction*i^3" if attracts else "soft_repulsion*i^6"
    if wca:
        core = f"step(2*soft_repulsion*i^3 - soft_attraction)*({core} + soft_attraction^2/(4*soft_repulsion))"
    energy = f"{core} + dipole_coupling*i3*(uv - 3*i*ur*vr);"
    displacement = "x = x1 - x3; y = y1 - y3; z = z1 - z3;"
    if truncation is not None:
        cutoff, switch, reaction = truncation
        energy = (
            f"S*({core} + dipole_coupling*((i3 - {reaction!r})*uv - 3*i*i3*ur*vr));"
            "S = 0.5 + t*(3003 - 6006*u + 9009*u^2 - 8580*u^3 + 5005*u^4 - 1638*u^5 + 231*u^6)/2048;"
            "u = t*t; t = 2*s - 1;"
            f"s = min(1, max(0, ({cutoff**2!r} - r2)/{cutoff**2 - switch**2!r}));"
        )
        displacement = "".join(
            f"{x} = d{x} - box_{x}*floor(d{x}/box_{x} + 0.5); d{x} = {x}1 - {x}3;" for x in ("x", "y", "z")
        )
    force = openmm.CustomCompoundBondForce(
        4,
        f"{energy}"
        "uv = ux*vx + uy*vy + uz*vz; ur = ux*x + uy*y + uz*z; vr = vx*x + vy*y + vz*z;"
        "i3 = i*sqrt(i); i = 1/r2; r2 = x*x + y*y + z*z;"
        f"{displacement}"
        "ux = x2 - x1; uy = y2 - y1; uz = z2 - z1;"
        "vx = x4 - x3; vy = y4 - y3; vz = z4 - z3",
    )
    for (centre1, tip1), (centre2, tip2) in itertools.combinations(arrows, 2):
        force.addBond([centre1, tip1, centre2, tip2], [])
    return force
