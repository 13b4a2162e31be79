"""The version of this package, as the tools that installed it know it."""

from __future__ import annotations

from functools import cache
from importlib import metadata


@cache
def version(otherwise: str) -> str:
    """Return the version of this package, or `otherwise` if it is not installed, but a source folder on the path."""
    try:
        return metadata.version("openmm-exactrb")
    except metadata.PackageNotFoundError:
        return otherwise
