"""Timings of a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Timings:
    """Wall time in seconds, and evaluations by OpenMM, since the integrator was made or `reset` was called.

    Attributes
    ----------
    forces : float
        Time in OpenMM and in the compiled kernels of bonded forces, for setting positions and for evaluations.
    rotor : float
        Time for the free motion of the bodies, including bonded forces if one compiled call performs the inner steps.
    total : float
        Total time inside step().
    evaluations : int
        Evaluations by OpenMM, except for nested forces: forces, with or without the energy, and energies alone, which
        barostats, the Metropolis test and occasionally the divergence check need.
    fast_evaluations : int
        Evaluations of the forces that are nested in the drifts.
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
