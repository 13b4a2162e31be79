"""Words of whole runs, for flows of a test's own."""

from openmm_exactrb.motion.engine import run
from openmm_exactrb.schemes.word import repeated


def whole(scheme, n):
    """Return n steps, where neighbours share their outer letter, between the processor and its inverse."""
    return scheme.processor + repeated(scheme.word, n) + scheme.postprocessor if n else ()


def advanced(scheme, drift, kick, state, h, n=1, gradient_kick=None):
    """Return a state that a scheme has moved by n steps with these flows.

    gradient_kick(strength) returns that of a force-gradient kick, which is a plain one unless given.
    """
    gradients = {letter: gradient_kick(strength) if gradient_kick else kick for letter, strength in scheme.gradients}
    return run(whole(scheme, n), {"A": drift, "B": kick, **gradients}, state, h)
