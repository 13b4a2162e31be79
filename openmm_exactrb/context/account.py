"""Numbers that the steps of an integrator add up, in its global variables: checkpoints and States take them along.

Like those of the ledger the names and their order are a part of the format of checkpoints: they stay. All integrators
have all of them, so that a checkpoint or State of one kind can be read by another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import openmm

_PREFIX = "exactrb_"
SEED, STREAM, HEAT, ACCEPTED, PROPOSED = "seed", "stream", "heat", "accepted", "proposed"


class Account:
    """Numbers by name, within one call of `step`.

    What a step adds counts when the step is kept.

    Parameters
    ----------
    integrator : openmm.CustomIntegrator, optional
        For which `declare` was called. Not needed where there are no names.
    names : sequence of str, optional
    """

    def __init__(self, integrator: Any = None, names: Sequence[str] = ()) -> None:
        self._integrator = integrator
        self._present = {name: read(integrator, name) for name in names}
        self._kept = dict(self._present)

    def add(self, name: str, amount: float) -> None:
        """Add to a number."""
        self._present[name] += amount

    def keep(self) -> None:
        """Keep what was added."""
        self._kept = dict(self._present)

    def close(self) -> None:
        """Write what was kept."""
        for name, value in self._kept.items():
            write(self._integrator, name, value)


def declare(integrator: openmm.CustomIntegrator) -> None:
    """Give a new integrator its variables, at zero."""
    for name in (SEED, STREAM, HEAT, ACCEPTED, PROPOSED):
        integrator.addGlobalVariable(_PREFIX + name, 0.0)


def read(integrator: openmm.CustomIntegrator, name: str) -> float:
    """Return a number."""
    return float(integrator.getGlobalVariableByName(_PREFIX + name))


def write(integrator: openmm.CustomIntegrator, name: str, value: float) -> None:
    """Set a number."""
    integrator.setGlobalVariableByName(_PREFIX + name, value)
