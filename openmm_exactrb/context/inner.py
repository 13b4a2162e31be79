"""The inner state of a processed scheme, and how a later Context recognises the forces to which it belongs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from openmm_exactrb.context import variables
from openmm_exactrb.mechanics.state import Remembered, State
from openmm_exactrb.openmm_access import arrays, platforms


class Changeable(Protocol):
    """Forces that were known when an inner state was computed, such as `openmm_exactrb.context.forces.KnownForces`."""

    def changed(self) -> bool:
        """Return whether OpenMM would now evaluate other forces."""


class Inner(NamedTuple):
    """A state in the inner coordinates of a processed scheme, from which its steps continue, and what it belongs to.

    Attributes
    ----------
    state : State
    fingerprint : float
        A number that identifies the settings, the box and the parameters to which the state belongs.
    memory : Remembered
        The forces of the last kicks.
    forces : sequence of Changeable
        The forces to which the state belongs, unless the state was loaded or OpenMM reports changed forces.
    """

    state: State
    fingerprint: float
    memory: Remembered = ([], [])
    forces: Sequence[Changeable] = ()

    def outdated(self, told: bool | None) -> bool:
        """Return whether forces have changed, as OpenMM `told` the integrator or, if None, by evaluation."""
        return any(forces.changed() for forces in self.forces) if told is None else told


def save_forces(context: Any, integrator: Any) -> None:
    """Save a sum of the present forces in the variables of an integrator together with its inner state."""
    variables.put(integrator, variables.FORCES, _sum_of_forces(context, integrator)[0])


def has_saved_forces(context: Any, integrator: Any) -> bool:
    """Return whether a Context has the forces with which its state was saved, except for rounding errors and noise."""
    present, size = _sum_of_forces(context, integrator)
    error = platforms.rounding(context) * size
    if abs(present - variables.get(integrator, variables.FORCES)) <= error:
        return True
    return abs(present - _sum_of_forces(context, integrator)[0]) > error


def _sum_of_forces(context: Any, integrator: Any) -> tuple[float, float]:
    """Return a weighted sum of all components of the forces, and the root of the sum of their squares."""
    forces = arrays.forces(context.getState(forces=True, groups=integrator.getIntegrationForceGroups())).ravel()
    return float(forces @ np.cos(np.arange(len(forces)))), float(np.linalg.norm(forces))
