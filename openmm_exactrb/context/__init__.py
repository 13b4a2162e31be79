"""One Context of OpenMM and all that touches it."""
