"""Baths of heat: what brings a run to the canonical ensemble.

Integrators with a bath in their steps are `langevin`, `rescaling` and, with Metropolis's decisions, `hybrid`; what they
share is in `thermostatted`, their words are in `words`. `momenta` draws all momenta anew at intervals.
"""

from openmm_exactrb.baths.hybrid import ExactRigidBodyHybridIntegrator
from openmm_exactrb.baths.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.baths.momenta import CanonicalMomenta
from openmm_exactrb.baths.rescaling import ExactRigidBodyRescalingIntegrator

__all__ = [
    "CanonicalMomenta",
    "ExactRigidBodyHybridIntegrator",
    "ExactRigidBodyLangevinIntegrator",
    "ExactRigidBodyRescalingIntegrator",
]
