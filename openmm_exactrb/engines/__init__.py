"""Engines, which perform the steps of an integrator in its Context."""

from openmm_exactrb.engines.catalogue import ENGINES
from openmm_exactrb.engines.engine import Engine

__all__ = ["ENGINES", "Engine"]
