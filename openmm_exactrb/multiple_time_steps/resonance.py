"""Resonances of multiple time steps: slow forces drive a fast motion if the step is a multiple of half the period.

J. J. Biesiadecki and R. D. Skeel, J. Comput. Phys. 109, 318 (1993), doi:10.1006/jcph.1993.1220.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np
import openmm

from openmm_exactrb.errors import StepSizeWarning
from openmm_exactrb.multiple_time_steps.bonded import Bonded
from openmm_exactrb.multiple_time_steps.stiffness import LIBRATION, frequencies
from openmm_exactrb.openmm_access import parameters
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.steps.substeps import DRIFT
from openmm_exactrb.support.types import Array
from openmm_exactrb.support.warn import warn

# Stiffness of slow forces in kJ/mol/nm²: that of hydrogen in water.
_SLOW = LIBRATION**2
# Growth rate of amplitudes (1/ps) above which a resonance is relevant; a friction of 5/ps compensates this rate.
_GROWTH = 2.5
# The period of the fastest normal mode of alanine dipeptide relative to that of its fastest isolated bond or angle. The
# second number is the largest mass (amu) of an atom whose bond is a separate mode: hydrogen, including heavy hydrogen.
_COUPLED, _LIGHT = 0.8, 4.0
_HEAVY = 2.5  # in amu; hydrogen and deuterium below this mass could be made heavier
_HARMONICS = 6


class Resonance(NamedTuple):
    """The shortest step (ps) at which slow forces drive a mode, the period of the mode (ps), and its particles."""

    step: float
    period: float
    particles: tuple[int, ...]

    def below(self, scheme: Scheme) -> float:
        """Return the interval (ps) between force evaluations at the resonance, rounded down to a multiple of 0.1 fs."""
        return math.floor(1e4 * self.step / scheme.forces) * 1e-4


def growth(scheme: Scheme, k: int) -> float:
    """Return the growth rate of an oscillator of frequency w at w h = k pi, in units of s/(m w) for a slow spring s.

    Kicks b_j at the times c_j h of a step modulate the spring constant s of a slow force in time. The modulus of the
    k-th Fourier coefficient is s S_k, where S_k is the modulus of sum_j b_j exp(2 pi i k c_j). This harmonic drives an
    oscillator of mass m and frequency w at twice the frequency w, so that amplitudes grow at the rate s S_k/(2 m w).
    The function returns S_k/2.
    """
    places, kicks = [], []
    behind = accumulate((part if substep == DRIFT else 0.0 for substep, part in scheme.sequence), initial=0.0)
    for (substep, part), place in zip(scheme.sequence, behind, strict=False):
        if substep.kicks:
            places.append(place)
            kicks.append(part)
    return 0.5 * float(abs(np.exp(2j * math.pi * k * np.array(places)) @ np.array(kicks)))


class Resonances:
    """The resonances of the bonds and angles in given force groups of a System.

    Parameters
    ----------
    system : openmm.System
    groups : sequence of int
    forces : sequence of Bonded, optional
        The forces with these bonds and angles; by default, all forces of the System.
    masses : (n_particles,) array, optional
        Masses, including those of virtual sites; by default those of the System.
    """

    def __init__(
        self,
        system: openmm.System,
        groups: Sequence[int] = range(32),
        forces: Sequence[Bonded] | None = None,
        masses: Array | None = None,
    ) -> None:
        self._massless = parameters.masses(system) == 0.0
        masses = parameters.masses(system) if masses is None else masses
        self._mass = np.where(masses > 0.0, masses, np.inf)
        self._modes, self._told = [*frequencies(system, groups, forces, masses)], False

    def first(self, scheme: Scheme) -> Resonance | None:
        """Return the resonance of a scheme at the shortest step, or None if no resonance is relevant.

        A slow spring s in the kicks raises the square of the frequency w by s/m. The mode is driven if w is within the
        growth rate of k pi/h. Both effects are proportional to s/m, so a bond that is softer than the slow forces is
        irrelevant.
        """
        rates, found = np.array([growth(scheme, k) for k in range(1, _HARMONICS + 1)]), []
        for frequency, particles in self._modes:
            mass = self._mass[particles].min(axis=1)
            alone = (particles.shape[1] == 2) & (mass <= _LIGHT)
            w = np.where(alone, frequency, frequency / _COUPLED)
            strong = (rates[:, None] * _SLOW > _GROWTH * mass * w) & (w > 0.0)
            some, k = strong.any(axis=0), strong.argmax(axis=0)
            highest = np.sqrt(w * w + (1.0 + 2.0 * rates[k]) * _SLOW / mass)
            steps = np.where(some, (k + 1) * math.pi / highest, np.inf)
            if some.any():
                n = int(steps.argmin())
                found.append(Resonance(float(steps[n]), 2.0 * math.pi / float(w[n]), tuple(particles[n].tolist())))
        return min(found, default=None)

    def warn(self, scheme: Scheme, step: float) -> None:
        """Warn once if the step (ps) of a scheme is beyond the first resonance."""
        found = None if self._told else self.first(scheme)
        if found is None or step <= found.step:
            return
        self._told = True
        what = "bond" if len(found.particles) == 2 else "angle"
        particles = ", ".join(map(str, found.particles))
        warn(
            f"with steps of {1e3 * step:.3g} fs, the slow forces may heat vibrations of the molecules. At steps of "
            f"{1e3 * found.step:.3g} fs and above, {scheme.name} is near a resonance with the {what} of particles "
            f"{particles}, whose period is about {1e3 * found.period:.3g} fs. Use at most "
            f"{1e3 * found.below(scheme):.1f} fs per force evaluation, {self._remedy(found.particles)}or monitor the "
            "temperature of the solute",
            StepSizeWarning,
        )

    def _remedy(self, particles: tuple[int, ...]) -> str:
        """Return advice to slow or constrain a bond or angle, or an empty text if it contains no hydrogen."""
        if self._massless[list(particles)].any():
            return ""
        mass = self._mass[list(particles)].min()
        if len(particles) == 2 and mass <= _LIGHT:
            return "constrain bonds to hydrogen (constraints=HBonds), "
        return "make hydrogens heavier (openmm_exactrb.heavy_hydrogens), " if mass < _HEAVY else ""
