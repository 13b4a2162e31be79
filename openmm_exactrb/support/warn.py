"""Warnings that point to the user's call, even if they are issued deep in the package or in OpenMM."""

from __future__ import annotations

import sys
import warnings

_OURS = ("openmm_exactrb", "openmm")


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Issue a warning at the line of the nearest caller outside this package and OpenMM."""
    frame, level = sys._getframe(1), 2  # noqa: SLF001  # Python 3.11 has no skip_file_prefixes
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _OURS:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)
