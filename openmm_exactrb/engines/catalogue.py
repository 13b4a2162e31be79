"""The engines, and the order in which ``engine="auto"`` tries them."""

from __future__ import annotations

from openmm_exactrb.engines.device.record import DEVICE
from openmm_exactrb.engines.engine import Engine
from openmm_exactrb.engines.host.record import HOST

#: All engines by name. A new engine is added as a further entry, which "auto" tries before the host.
ENGINES: dict[str, Engine] = {engine.name: engine for engine in (HOST, DEVICE)}


def in_order() -> list[Engine]:
    """Return the engines in the order in which "auto" tries them: the host, which supports all settings, is last."""
    return sorted(ENGINES.values(), key=lambda engine: engine is HOST)
