"""The order of a method, measured."""

from functools import cache

import numpy as np


def exponent(sizes, errors):
    """Return the power of three or more sizes with which errors grow."""
    assert len(sizes) >= 3, "two points are always on a line"
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def slope(end, steps):
    """Return the order of a method as the slope of the errors over the numbers of steps.

    Parameters
    ----------
    end : callable
        end(n) -> (3, N) array, what n steps over one and the same time lead to. Its error is told by halving the steps.
    steps : sequence of int
        Three or more.
    """
    end = cache(end)
    errors = [np.median(np.abs(end(n) - end(2 * n)).max(axis=0)) for n in steps]
    assert min(errors) > 1e-13, "the errors reached roundoff"
    return -exponent(steps, errors)


def composes_verlet(scheme):
    """Return whether a step is a row of Verlet steps, kick first: it keeps its order with drifts of order 2."""
    halves = [0.0, *scheme.a, 0.0]
    return (
        scheme.first == "kick"
        and not scheme.has_gradients
        and all(abs(b - 0.5 * (i + j)) < 1e-14 for b, i, j in zip(scheme.b, halves[:-1], halves[1:], strict=True))
    )
