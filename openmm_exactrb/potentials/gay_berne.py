"""The potential of Gay and Berne for uniaxial ellipsoids, with the exponents mu = 2 and nu = 1."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import openmm

from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.potentials import compiled
from openmm_exactrb.potentials.boundaries import check_cutoff
from openmm_exactrb.support.types import Array


class GayBerne:
    """The picklable function that the PythonForce of ellipsoids calls.

    The potential is 4 epsilon e1 e2² (R^-12 - R^-6) with R = (r - s + shift)/shift. For the axes u and v, and the unit
    vector e between the centres, s = sigma/sqrt(H(chi)), e1 = 1/sqrt(1 - chi² (u.v)²), e2 = H(chi'), and H(x) = 1 - x
    ((u.e)² + (v.e)² - 2 x (u.e)(v.e)(u.v))/(1 - x² (u.v)²) (Gay and Berne, doi:10.1063/1.441483). A switch with six
    continuous derivatives takes the potential to zero at the cutoff.

    Parameters
    ----------
    kappa, kappa_prime : float
        Ratio of length to diameter, and ratio of the well depth side by side to that end to end: chi = (kappa² -
        1)/(kappa² + 1), and chi' = (sqrt(kappa') - 1)/(sqrt(kappa') + 1).
    sigma, epsilon : float
        Diameter (nm), and well depth of two crossed ellipsoids (kJ/mol). The shift is sigma, or for a disc its
        thickness kappa sigma.
    cutoff, switch : float
        Cutoff of the energy of a pair and start of its switch, as distances between centres (nm).
    """

    # Pickles in System XML name this module and the attributes.
    __module__ = "openmm_exactrb.potentials"

    def __init__(
        self, kappa: float, kappa_prime: float, sigma: float, epsilon: float, cutoff: float, switch: float
    ) -> None:
        chi, chi_prime = (kappa**2 - 1.0) / (kappa**2 + 1.0), (kappa_prime**0.5 - 1.0) / (kappa_prime**0.5 + 1.0)
        self.law = (chi, chi_prime, sigma, min(1.0, kappa) * sigma, 4.0 * epsilon, cutoff, switch)

    def __call__(self, state: openmm.State) -> tuple[float, Array]:
        """Return the energy (kJ/mol) and the forces (kJ/mol/nm) on alternating centres and axis points."""
        return self.energy_and_forces(arrays.positions(state), state.getPeriodicBoxVectors(asNumpy=True)._value)

    def energy_and_forces(self, positions: Array, box: Array) -> tuple[float, Array]:
        """Return the energy (kJ/mol) and the forces (2 n, 3) (kJ/mol/nm) on alternating centres and axis points.

        Parameters
        ----------
        positions : (2 n, 3) array
            In nm: the centre and a point on the axis of the first ellipsoid, then those of the second, and so on.
        box : (3, 3) array
            Vectors of the periodic box in nm.

        Raises
        ------
        ValueError
            If the box is not rectangular or too small for the cutoff.
        """
        if np.count_nonzero(box) != 3:
            raise ValueError("ellipsoids need a rectangular box: set orthogonal box vectors")
        edges = box.diagonal().copy()
        check_cutoff(self.law[5], edges.tolist())
        forces, energy = np.empty_like(positions), np.empty(1)
        compiled.load("ellipsoids").gay_berne(positions, edges, np.array(self.law), forces, energy)
        return float(energy[0]), forces


def gay_berne_force(axes: Sequence[tuple[int, int]], potential: GayBerne) -> openmm.PythonForce:
    """Return the potential between ellipsoids, each given by its centre and a point on its axis."""
    force = openmm.PythonForce(potential)
    force.setParticles(list(itertools.chain(*axes)))
    force.setUsesPeriodicBoundaryConditions(True)
    force.setName("GayBernePotential")
    return force
