"""What the integrators with a thermostat of their own have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypedDict

from openmm import unit

from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.free_motion import Constrain
from openmm_exactrb.schemes import Scheme


class Options(TypedDict, total=False):
    """Keyword arguments of all integrators; see `ExactRigidBodyIntegrator`."""

    bodies: Sequence[Sequence[int]] | None
    fast: str | Sequence[int] | None
    inner: str | Scheme | None
    innerSteps: int | None
    engine: str
    forceInterval: float | unit.Quantity | None
    checkDivergence: bool
    constraints: Sequence[Constrain]


class ThermostattedIntegrator(ExactRigidBodyIntegrator):
    """An `ExactRigidBodyIntegrator` whose arguments include those of its thermostat."""

    def _arguments(self) -> dict[str, Any]:
        arguments = super()._arguments()
        thermostat = arguments.pop("thermostat")
        return {**arguments, **thermostat.settings()}
