"""Nosé-Hoover chains, and integrators of them."""

import numpy as np

import openmm_exactrb as rb
from openmm_exactrb.thermostats import NoseHooverChain

H = 0.01
FREQUENCY = 20.0


def chain_of(**options):
    return NoseHooverChain(**({"temperature": 300.0, "collisionFrequency": FREQUENCY} | options))


def nose_hoover(h=H, temperature=30.0, frequency=FREQUENCY, **options):
    return rb.ExactRigidBodyNoseHooverIntegrator(temperature, frequency, h, **{"scheme": "S2_2"} | options)


def stirred(chain, rng):
    """Return coordinates and velocities of the links as they may be in equilibrium."""
    coordinates, velocities = rng.standard_normal((2, chain.chainLength))
    return np.array([coordinates, 0.7 * FREQUENCY * velocities])
