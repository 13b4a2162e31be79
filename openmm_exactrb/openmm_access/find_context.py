"""A search for the Context of an integrator, for which OpenMM has no method."""

from __future__ import annotations

import gc
from typing import Any

import openmm

#: The message about an integrator without a Context.
NO_CONTEXT = "the integrator has no Context yet: create a Simulation or a Context with the integrator"


def find_context(integrator: openmm.Integrator) -> openmm.Context:
    """Find the Context that was created with an integrator; raise ValueError if it does not exist yet."""
    context = _referring(integrator)
    if context is None and gc.get_freeze_count():  # the garbage collector ignores references in frozen objects
        gc.unfreeze()
        context = _referring(integrator)
        gc.freeze()
    if context is None:
        raise ValueError(NO_CONTEXT)
    return context


def _referring(integrator: Any) -> Any:
    """Return the Context that refers to an integrator, or None.

    Only referrers are searched, because listing all objects may corrupt tuples that other threads are creating.
    """
    for referrer in gc.get_referrers(integrator):
        if isinstance(referrer, openmm.Context):
            return referrer
        if isinstance(referrer, dict) and referrer.get("_integrator") is integrator:
            for owner in gc.get_referrers(referrer):
                if isinstance(owner, openmm.Context):
                    return owner
    return None
