"""The engines, and the order in which ``engine="auto"`` tries them."""

from __future__ import annotations

from openmm_exactrb.engines.engine import Engine
from openmm_exactrb.engines.host.record import HOST
from openmm_exactrb.engines.native.record import NATIVE

#: All engines by name. A new engine is added as a further entry, which "auto" tries before the host.
ENGINES: dict[str, Engine] = {
    engine.name: engine
    for engine in (
        HOST,
        NATIVE,
    )
}

_FORMER_NAMES = {"device": "native"}


def in_order() -> list[Engine]:
    """Return the engines in the order in which "auto" tries them: the host, which supports all settings, is last."""
    return sorted(ENGINES.values(), key=lambda engine: engine is HOST)


def named(name: str) -> str:
    """Return the present name of an engine that has been called otherwise."""
    return _FORMER_NAMES.get(name, name)
