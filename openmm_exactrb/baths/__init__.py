"""Baths of heat: what brings a run to the canonical ensemble.

`momenta` draws all momenta anew at intervals.
"""

from openmm_exactrb.baths.momenta import CanonicalMomenta

__all__ = ["CanonicalMomenta"]
