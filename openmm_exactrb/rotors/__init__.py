"""Flows of the free rigid body with a common interface."""

from openmm_exactrb.errors import NotConvergedWarning
from openmm_exactrb.rotors.flow import Rotation
from openmm_exactrb.rotors.front import free_rotor
from openmm_exactrb.rotors.registry import (
    LARGEST_MOMENT,
    ROTORS,
    SMALLEST_MOMENT,
    WIDEST,
    Rotor,
    look_up,
    rotor,
    rotor_of_sums,
)

__all__ = [
    "LARGEST_MOMENT",
    "ROTORS",
    "SMALLEST_MOMENT",
    "WIDEST",
    "NotConvergedWarning",
    "Rotation",
    "Rotor",
    "free_rotor",
    "look_up",
    "rotor",
    "rotor_of_sums",
]
