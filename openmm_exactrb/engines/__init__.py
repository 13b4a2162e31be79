"""Engines: what carries the steps of an integrator out in its Context."""

from openmm_exactrb.engines.catalogue import ENGINES
from openmm_exactrb.engines.engine import Engine

__all__ = ["ENGINES", "Engine"]
