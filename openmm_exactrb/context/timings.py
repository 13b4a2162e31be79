"""Where the time of a run goes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Timings:
    """Wall time in seconds, and evaluations by OpenMM, since the integrator was made or `reset` was called.

    Attributes
    ----------
    forces : float
        Inside OpenMM, and in the compiled kernels of bonded forces: positions that are set, and evaluations.
    rotor : float
        The free motion of the bodies, with the bonded forces within it where one compiled call makes the inner steps.
    total : float
        Everything inside step().
    evaluations : int
        All that steps have OpenMM evaluate, but for nested forces: forces, with or without the energy, and energies
        alone, which barostats, Metropolis's rule and now and then the check for divergence need.
    fast_evaluations : int
        Evaluations of the forces that are nested in the drifts.
    """

    forces: float = 0.0
    rotor: float = 0.0
    total: float = 0.0
    evaluations: int = 0
    fast_evaluations: int = 0

    def reset(self) -> None:
        """Begin again at zero."""
        self.forces = self.rotor = self.total = 0.0
        self.evaluations = self.fast_evaluations = 0
