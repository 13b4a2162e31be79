"""Access to an OpenMM Context: forces, state, variables and updates."""
