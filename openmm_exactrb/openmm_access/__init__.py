"""Access to OpenMM's objects: units, arrays, platforms, molecules and the Context of an integrator."""
