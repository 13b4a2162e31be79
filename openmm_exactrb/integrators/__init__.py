"""The integrators, what they share with OpenMM's, and their access to bodies."""
