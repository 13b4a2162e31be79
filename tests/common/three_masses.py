"""The smallest rigid body."""

import numpy as np
import openmm

POSITIONS = 0.1 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.75**0.5, 0.0]])


def system():
    """Return a System of one triangle of sides 0.1 nm, without forces."""
    system = openmm.System()
    for i in range(3):
        system.addParticle(1.0)
        for j in range(i):
            system.addConstraint(i, j, 0.1)
    return system
