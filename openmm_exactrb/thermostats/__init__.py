"""Thermostats and the integrators that use them, one file for each thermostat.

`Langevin`, `StochasticRescaling`, `NoseHooverChain` and `HybridMonteCarlo` are values of the argument ``thermostat`` of
`openmm_exactrb.ExactRigidBodyIntegrator`. `CanonicalMomenta` draws all momenta at intervals.
"""

from openmm_exactrb.thermostats.hybrid import ExactRigidBodyHybridIntegrator, HybridMonteCarlo
from openmm_exactrb.thermostats.langevin import ExactRigidBodyLangevinIntegrator, Langevin
from openmm_exactrb.thermostats.momenta import CanonicalMomenta
from openmm_exactrb.thermostats.nose_hoover import ExactRigidBodyNoseHooverIntegrator, NoseHooverChain
from openmm_exactrb.thermostats.rescaling import ExactRigidBodyRescalingIntegrator, StochasticRescaling

__all__ = [
    "CanonicalMomenta",
    "ExactRigidBodyHybridIntegrator",
    "ExactRigidBodyLangevinIntegrator",
    "ExactRigidBodyNoseHooverIntegrator",
    "ExactRigidBodyRescalingIntegrator",
    "HybridMonteCarlo",
    "Langevin",
    "NoseHooverChain",
    "StochasticRescaling",
]
