"""The methods of OpenMM that are replaced for the whole process.

Each of them calls the original method, unless the integrator of the Context belongs to this package.
"""

from __future__ import annotations

from typing import Any

from openmm_exactrb.context.minimiser import minimise_by_integrators
from openmm_exactrb.context.states import load_by_integrators
from openmm_exactrb.context.velocities import draw_by_integrators


def replace_methods(kind: type[Any]) -> None:
    """Replace methods that users call before an integrator of a class has found its Context."""
    minimise_by_integrators(kind)  # LocalEnergyMinimizer.minimize
    draw_by_integrators(kind)  # Context.setVelocitiesToTemperature
    load_by_integrators(kind)  # Context.setState
