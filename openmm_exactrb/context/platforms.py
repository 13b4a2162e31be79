"""Which platform of OpenMM, and in which precision, where the user makes no Context."""

from __future__ import annotations

import os

import openmm

_PRECISION = "Precision"


def platforms() -> list[openmm.Platform]:
    """Return those that are here, the fastest first."""
    found = [openmm.Platform.getPlatform(i) for i in range(openmm.Platform.getNumPlatforms())]
    return sorted(found, key=lambda platform: -platform.getSpeed())


def platform_of(name: str | openmm.Platform | None = None) -> openmm.Platform:
    """Return a platform: the named one, else that of OPENMM_DEFAULT_PLATFORM, which OpenMM obeys too, else the fastest.

    Raises
    ------
    ValueError
        If there is none of this name.
    """
    if isinstance(name, openmm.Platform):
        return name
    found = {platform.getName(): platform for platform in platforms()}
    wanted = name if name is not None else os.environ.get("OPENMM_DEFAULT_PLATFORM")
    if not wanted:
        return next(iter(found.values()))
    if wanted not in found:
        raise ValueError(f"there is no platform {wanted!r} here: choose one of {', '.join(found)}")
    return found[wanted]


def mixed(platform: openmm.Platform) -> dict[str, str]:
    """Return the properties of mixed precision where a platform has a choice: its default loses the energy's digits."""
    return {_PRECISION: "mixed"} if _PRECISION in platform.getPropertyNames() else {}
