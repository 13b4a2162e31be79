"""Sequences of whole runs, for flows of a test's own."""

from openmm_exactrb.steps.sequence import repeated, run
from openmm_exactrb.steps.substeps import DRIFT, KICK, GradientKick


def whole(scheme, n):
    """Return n steps, where neighbours share their outer substep, between the processor and its inverse."""
    return scheme.processor + repeated(scheme.sequence, n) + scheme.postprocessor if n else ()


def gradient_kicks(scheme):
    """Return the force-gradient kicks of a step in the order of their use, each once."""
    return list(dict.fromkeys(substep for substep, _ in scheme.sequence if isinstance(substep, GradientKick)))


def advanced(scheme, drift, kick, state, h, n=1, gradient_kick=None):
    """Return a state that a scheme has moved by n steps with these flows.

    gradient_kick(strength) returns that of a force-gradient kick, which is a plain one unless given.
    """
    gradients = {s: gradient_kick(s.strength) if gradient_kick else kick for s in gradient_kicks(scheme)}
    return run(whole(scheme, n), {DRIFT: drift, KICK: kick, **gradients}, state, h)
