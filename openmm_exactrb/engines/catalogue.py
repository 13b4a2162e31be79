"""The engines, in the order in which ``engine="auto"`` tries them, the host last."""

from __future__ import annotations

from openmm_exactrb.engines.device.record import DEVICE
from openmm_exactrb.engines.engine import Engine
from openmm_exactrb.engines.host.record import HOST

#: All engines by name. One of your own is one more entry, which "auto" tries before the host.
ENGINES: dict[str, Engine] = {engine.name: engine for engine in (HOST, DEVICE)}


def in_order() -> list[Engine]:
    """Return the engines in the order in which they are tried; the host, which supports all settings, is the last."""
    return sorted(ENGINES.values(), key=lambda engine: engine is HOST)
