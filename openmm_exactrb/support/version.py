"""The version of a package, as recorded at its installation."""

from __future__ import annotations

from functools import cache
from importlib import metadata


@cache
def version(otherwise: str = "not installed", package: str = "openmm-exactrb") -> str:
    """Return the version of a package, or `otherwise` if the package is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return otherwise
