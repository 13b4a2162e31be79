"""Timings of a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Timings:
    """Wall times in seconds and numbers of evaluations since the integrator was created or `reset` was called.

    Attributes
    ----------
    forces : float
        Time for setting positions and for evaluations, in OpenMM and in the compiled kernels of bonded forces. The
        native engine does not measure this time.
    rotor : float
        Time for the free motion of the bodies, including bonded forces if one compiled call performs the inner steps.
        The native engine does not measure this time.
    total : float
        Total time inside step().
    evaluations : int
        Number of evaluations by OpenMM, excluding those of fast forces. An evaluation computes forces, with or without
        the energy, or, for a barostat, the Metropolis test or the divergence check, only the energy.
    fast_evaluations : int
        Number of evaluations of fast forces.
    """

    forces: float = 0.0
    rotor: float = 0.0
    total: float = 0.0
    evaluations: int = 0
    fast_evaluations: int = 0

    def reset(self) -> None:
        """Set all numbers to zero."""
        self.forces = self.rotor = self.total = 0.0
        self.evaluations = self.fast_evaluations = 0
