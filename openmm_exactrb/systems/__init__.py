"""Ready-made Systems, and changes to the masses and exclusions of a System."""

from openmm_exactrb.systems.ellipsoid_fluid import ellipsoids
from openmm_exactrb.systems.exclusions import exclude_within
from openmm_exactrb.systems.fluids import dipole_fluid, rigid_water
from openmm_exactrb.systems.masses import heavy_hydrogens

__all__ = ["dipole_fluid", "ellipsoids", "exclude_within", "heavy_hydrogens", "rigid_water"]
