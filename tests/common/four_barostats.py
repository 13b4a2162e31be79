"""OpenMM's four barostats at 1 bar."""

import openmm
from openmm import unit

BAR = unit.bar
MEMBRANE = openmm.MonteCarloMembraneBarostat


def barostats(kelvin, axes=(True, True, True)):
    """Return functions that make them for a frequency, at a temperature; the anisotropic one scales these axes."""
    T = kelvin * unit.kelvin
    return {
        "isotropic": lambda n: openmm.MonteCarloBarostat(1 * BAR, T, n),
        "anisotropic": lambda n: openmm.MonteCarloAnisotropicBarostat(openmm.Vec3(1, 1, 1) * BAR, T, *axes, n),
        "membrane": lambda n: MEMBRANE(1 * BAR, 0 * BAR * unit.nanometer, T, MEMBRANE.XYIsotropic, MEMBRANE.ZFree, n),
        "flexible": lambda n: openmm.MonteCarloFlexibleBarostat(1 * BAR, T, n),
    }
