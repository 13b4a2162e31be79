"""Potentials between rigid bodies as OpenMM forces; a function for each potential returns one Force or two.

OpenMM's units (amu, nm, ps and kJ/mol) are consistent, so that numbers in reduced units can be used unchanged.
"""

from openmm_exactrb.potentials.boundaries import Ewald, Open, ReactionField
from openmm_exactrb.potentials.dipoles import SoftDipoles, soft_dipole_force
from openmm_exactrb.potentials.gay_berne import GayBerne, gay_berne_force
from openmm_exactrb.potentials.moments import dipole_strength
from openmm_exactrb.potentials.rods import dipole_rod_forces, rod_length

__all__ = [
    "Ewald",
    "GayBerne",
    "Open",
    "ReactionField",
    "SoftDipoles",
    "dipole_rod_forces",
    "dipole_strength",
    "gay_berne_force",
    "rod_length",
    "soft_dipole_force",
]
