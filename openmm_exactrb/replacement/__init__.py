"""Integrators of this package instead of OpenMM's, for scripts and libraries that create OpenMM's by name.

`replace_integrators` is a context manager that a user chooses; outside it, OpenMM's classes are as they were.
"""

from openmm_exactrb.replacement.replace import replace_integrators

__all__ = ["replace_integrators"]
