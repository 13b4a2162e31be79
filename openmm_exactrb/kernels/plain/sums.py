"""Sums high + low in numpy: see `openmm_exactrb.compensated`."""

from __future__ import annotations

from openmm_exactrb.compensated import Array, add


def advance(x: Array, rate: Array, t: float, total: Array) -> None:
    """Write x + t rate of sums x (2, k, N) and rates (k, N) into `total`."""
    total[...] = add(x, t * rate)
