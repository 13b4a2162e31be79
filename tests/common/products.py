"""Parameters of tests whose products would repeat the same mechanism."""

import itertools
from collections import Counter

import pytest


def _row(values):
    """Return a row of values, any of which may be `pytest.param` of some values, with all of their marks."""
    parts = [value if hasattr(value, "marks") else pytest.param(value) for value in values]
    marks = [mark for part in parts for mark in part.marks]
    return pytest.param(*(value for part in parts for value in part.values), marks=marks)


def pairwise(*axes):
    """Return rows with a value of each axis, such that each pair of values of two axes occurs in one of them.

    Values may be `pytest.param` of one value, whose marks the rows have. The rows are the same every time.
    """
    axes = [list(axis) for axis in axes]
    if len(axes) == 1:
        return [_row([value]) for value in axes[0]]
    left = [tuple(row) for row in itertools.product(*(range(len(axis)) for axis in axes))]
    used, rows = Counter({pair: 0 for row in left for pair in _pairs(row)}), []

    def gain(row):
        """How many pairs of a row are new, and how often the others were not used."""
        times = [used[pair] for pair in _pairs(row)]
        return times.count(0), -sum(times)

    while not all(used.values()):
        best = max(left, key=gain)
        used.update(_pairs(best))
        rows.append(_row(axis[k] for axis, k in zip(axes, best, strict=True)))
    return rows


def _pairs(row):
    """Return all pairs of two places in a row, with their values."""
    return itertools.combinations(enumerate(row), 2)


def spread(first, *others, times=1, offset=0):
    """Return rows in which each value of the first axis occurs so many times, with changing values of the others."""
    combinations = pairwise(*others)
    return [
        _row((value, combinations[(times * k + j + offset) % len(combinations)]))
        for k, value in enumerate(first)
        for j in range(times)
    ]


def in_pairs(axes, indirect=()):
    """Parametrise a test such that each pair of values of two axes occurs, and not each of their combinations.

    An axis has the name of an argument, or names such as "scheme, h" and tuples of values.
    """
    return _parametrize(axes, pairwise(*_values(axes)), indirect)


def spread_over(axes, times=1, indirect=()):
    """Parametrise a test such that each value of its first axis occurs so many times, with the others in turn."""
    return _parametrize(axes, spread(*_values(axes), times=times), indirect)


def _values(axes):
    for names, axis in axes.items():
        yield [pytest.param(*value) if "," in names and not hasattr(value, "marks") else value for value in axis]


def _parametrize(axes, rows, indirect):
    names = [name.strip() for names in axes for name in names.split(",")]
    return pytest.mark.parametrize(names, rows, indirect=list(indirect))
