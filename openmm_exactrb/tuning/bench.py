"""Runs of methods from one start: their energies, and their wall time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from openmm_exactrb.motion.guard import NonFiniteError
from openmm_exactrb.tuning.error import LOST, Series
from openmm_exactrb.tuning.movers import Method, Mover, Ours, Verlet
from openmm_exactrb.tuning.scales import scales_of
from openmm_exactrb.tuning.start import Start

_SAMPLES, _FEWEST_SAMPLES = 300, 48


class Bench:
    """Runs methods from one start.

    Parameters
    ----------
    start : Start
        Of a System that conserves its energy, with velocities.

    Attributes
    ----------
    start : Start
    scales : Scales
        At the start.

    Raises
    ------
    ValueError
        If the System has no rigid bodies, positions do not fit, or nothing moves.
    """

    def __init__(self, start: Start) -> None:
        self.start = start
        self.scales = scales_of(start)
        self._movers: dict[str, Mover] = {}

    @property
    def has_baseline(self) -> bool:
        """Whether OpenMM's Verlet integrator moves the same bodies: constraints hold all of them."""
        return self.start.bodies is None and self.start.system.getNumConstraints() > 0

    def mover(self, method: Method) -> Mover:
        """Return what runs a scheme, or the baseline `VERLET`."""
        name = method if isinstance(method, str) else method.name
        if name not in self._movers:
            self._movers[name] = Verlet(self.start) if isinstance(method, str) else Ours(self.start, method)
        return self._movers[name]

    def run(self, method: Method, step: float, duration: float) -> Series:
        """Run from the start.

        Parameters
        ----------
        method : Scheme, NestedScheme or `VERLET`
        step : float
            Of the whole scheme, in ps.
        duration : float
            In ps; at least 48 steps are made.

        Returns
        -------
        Series
            Not stable, and shorter, if the energy leaves its value at the start by a tenth of the kinetic energy, or
            numbers become infinite. Whatever else goes wrong is raised.
        """
        mover, n_bodies = self.mover(method), self.scales.n_bodies
        every = max(1, round(duration / _SAMPLES / step))
        energies: list[float] = []
        with np.errstate(all="ignore"):
            try:
                mover.begin(step)
                first = mover.energy() / n_bodies
                while len(energies) < max(_FEWEST_SAMPLES, math.ceil(duration / (every * step))):
                    mover.move(every)
                    energies.append(mover.energy() / n_bodies)
                    if not abs(energies[-1] - first) < LOST * self.scales.kinetic:
                        return Series(np.array(energies), every * step, False)
            except NonFiniteError:
                return Series(np.array(energies), every * step, False)
        return Series(np.array(energies), every * step, True)

    def seconds_per_evaluation(
        self, methods: Sequence[Method], interval: float, repeats: int = 7, evaluations: int = 28
    ) -> list[float]:
        """Time a force evaluation within `step`, with all that the integrator does beside it.

        Parameters
        ----------
        methods : sequence of Scheme, NestedScheme or `VERLET`
        interval : float
            Time a force evaluation in ps, at which all of them are stable.
        repeats, evaluations : int
            Rounds through all methods, and force evaluations in each; the fastest round counts, as
            whatever else the machine does only adds to it.

        Returns
        -------
        list of float
            In seconds.
        """
        rounds = []
        for _ in range(repeats):
            times = []
            for mover in map(self.mover, methods):
                mover.begin(mover.stages * interval)
                mover.move(1)
                times.append(mover.seconds_per_evaluation(max(2, round(evaluations / mover.stages))))
            rounds.append(times)
        return [float(t) for t in np.min(rounds, axis=0)]
