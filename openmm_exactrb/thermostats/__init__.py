"""Thermostats: values of the argument ``thermostat`` of `openmm_exactrb.ExactRigidBodyIntegrator`, one file for each.

A file contains what the thermostat saves, its flow in NumPy and the name of its kernel, whose text is in
thermostats.cl.
"""

from openmm_exactrb.thermostats.hybrid import HybridMonteCarlo
from openmm_exactrb.thermostats.langevin import Langevin
from openmm_exactrb.thermostats.nose_hoover import NoseHooverChain
from openmm_exactrb.thermostats.rescaling import StochasticRescaling
from openmm_exactrb.thermostats.thermostat import Factors, Thermostat

__all__ = ["Factors", "HybridMonteCarlo", "Langevin", "NoseHooverChain", "StochasticRescaling", "Thermostat"]
