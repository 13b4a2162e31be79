"""A move of openmmtools, for its replica exchange, multistate and other samplers.

Requires openmmtools, which the extra ``openmmtools`` of this package installs.
"""

from __future__ import annotations

from typing import Any

from openmm import unit
from openmmtools.mcmc import BaseIntegratorMove

from openmm_exactrb.integrators.langevin import ExactRigidBodyLangevinIntegrator

__all__ = ["ExactRigidBodyMove"]

_TIMESTEP = 4.0 * unit.femtosecond
_COLLISION_RATE = 1.0 / unit.picosecond
_ARGUMENTS = "timestep", "collision_rate", "scheme", "flexible_collision_rate", "options"


class ExactRigidBodyMove(BaseIntegratorMove):  # type: ignore[misc]  # of a package without types
    """Steps of `openmm_exactrb.ExactRigidBodyLangevinIntegrator` at the temperature of the thermodynamic state.

    The move takes the place of openmmtools' LangevinDynamicsMove. As there, an application of the move takes the time
    ``n_steps`` times ``timestep``.

    Parameters
    ----------
    timestep : Quantity, optional
        The step size. With the default scheme, forces are evaluated once per step.
    collision_rate : Quantity, optional
        The friction.
    n_steps : int, optional
        The number of steps in an application of the move.
    reassign_velocities : bool, optional
        Whether velocities are drawn at the beginning of an application.
    scheme : str, optional
        The name of a scheme for Langevin dynamics; see `ExactRigidBodyLangevinIntegrator`.
    flexible_collision_rate : Quantity, optional
        The friction of molecules that consist of more than one rigid body, such as a protein.
    n_restart_attempts : int, optional
        How often an application is repeated after an error.
    options : optional
        Further arguments of the integrator, such as ``engine`` or ``bodies``.

    Raises
    ------
    ValueError
        If an argument is not one of the integrator, or has an invalid value.

    Notes
    -----
    openmmtools stores the arguments of a move in NetCDF files, so that a resumed sampler has the same move. When it
    shares a Context, openmmtools sets all global variables of an integrator to zero: the heat then begins from zero,
    and the noise has a new seed.
    """

    def __init__(
        self,
        timestep: unit.Quantity = _TIMESTEP,
        collision_rate: unit.Quantity = _COLLISION_RATE,
        n_steps: int = 1000,
        reassign_velocities: bool = False,
        scheme: str = "BAOA",
        flexible_collision_rate: unit.Quantity | None = None,
        n_restart_attempts: int = 4,
        **options: Any,
    ) -> None:
        super().__init__(n_steps, reassign_velocities, n_restart_attempts)
        self.timestep, self.collision_rate, self.scheme = timestep, collision_rate, scheme
        self.flexible_collision_rate, self.options = flexible_collision_rate, options
        self._integrator_at(300.0)  # with errors of invalid arguments

    def _integrator_at(self, temperature: float | unit.Quantity) -> ExactRigidBodyLangevinIntegrator:
        return ExactRigidBodyLangevinIntegrator(
            temperature,
            self.collision_rate,
            self.timestep,
            scheme=self.scheme,
            flexibleFriction=self.flexible_collision_rate,
            **self.options,
        )

    def _get_integrator(self, thermodynamic_state: Any) -> ExactRigidBodyLangevinIntegrator:
        """Return the integrator that openmmtools copies into its Contexts."""
        return self._integrator_at(thermodynamic_state.temperature)

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments, which openmmtools stores as text."""
        return {**super().__getstate__(), **{name: getattr(self, name) for name in _ARGUMENTS}}

    def __setstate__(self, serialization: dict[str, Any]) -> None:
        """Take arguments from `__getstate__`."""
        super().__setstate__(serialization)
        for name in _ARGUMENTS:
            setattr(self, name, serialization[name])
