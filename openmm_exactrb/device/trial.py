"""Which engine is faster in a Context: a few steps of both, in Contexts of their own."""

from __future__ import annotations

import copy
import statistics
import time
from typing import Any

import openmm

from openmm_exactrb.device import gather
from openmm_exactrb.device.contexts import bring_to, properties

_KINDS = ("device", "host")
# Of each engine: what a round takes at least, in s, or its steps at most; and the rounds, by turns.
_ROUND, _STEPS, _ROUNDS = 0.02, 64, 5
# The device is taken unless it needs this many times the host's time: noise of the times is far below, so that two
# processes on one machine choose alike unless both are about there.
_MARGIN = 1.25
known: dict[tuple[Any, ...], tuple[float, float]] = {}


def verdict(context: Any, integrator: Any) -> tuple[bool, str]:
    """Return whether the device is about as fast as the host in a Context or faster, and a sentence with both times.

    They are measured once in a process for a device, a scheme, a kind of integrator and a number of particles. The
    Context stays as it is.
    """
    platform, asked = context.getPlatform(), properties(context)
    scheme, particles = integrator.getScheme().name, context.getSystem().getNumParticles()
    key = (platform.getName(), *asked.items(), type(integrator), scheme, particles)
    if key not in known:
        known[key] = timed(context, integrator)
    device, host = known[key]
    note = f"{platform.getName()} needs {1e3 * device:.3g} ms for a step, the host with it {1e3 * host:.3g} ms"
    return device <= _MARGIN * host, note


def timed(context: Any, integrator: Any) -> tuple[float, float]:
    """Return the seconds that a step takes on the device and on the host."""
    contexts = [_twin(context, integrator, kind) for kind in _KINDS]
    steps = [_enough(twin.getIntegrator()) for twin in contexts]
    rounds = [
        [_seconds(twin.getIntegrator(), n) for twin, n in zip(contexts, steps, strict=True)] for _ in range(_ROUNDS)
    ]
    device, host = (statistics.median(times) for times in zip(*rounds, strict=True))
    return device, host


def _twin(context: Any, integrator: Any, engine: str) -> openmm.Context:
    """Return a Context of copies, with the state of another one and an engine that was asked for."""
    asked = integrator.getSettings()
    own = type(integrator)(**asked["arguments"] | {"engine": engine})
    for name, value in asked["settings"].items():
        getattr(own, f"set{name}")(value)
    system = gather.without(copy.deepcopy(context.getSystem()))
    twin = openmm.Context(system, own, context.getPlatform(), properties(context))
    bring_to(twin, context)
    return twin


def _enough(integrator: Any) -> int:
    """Return how many steps make a round, after some that compile kernels."""
    integrator.step(2)
    steps = 1
    while steps < _STEPS and _seconds(integrator, steps) * steps < _ROUND:
        steps *= 2
    return steps


def _seconds(integrator: Any, steps: int) -> float:
    """Return the time of a step; a call ends with reading positions, so that the device has finished."""
    start = time.perf_counter()
    integrator.step(steps)
    return (time.perf_counter() - start) / steps
