"""Rows of parameters have all pairs of values, and few rows."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from products import pairwise, spread


@given(st.lists(st.integers(1, 5), min_size=2, max_size=4))
def test_each_pair_of_values_occurs_and_few_rows_do(sizes):
    axes = [[f"{axis}{k}" for k in range(size)] for axis, size in enumerate(sizes)]
    rows = [param.values for param in pairwise(*axes)]
    for one, other in itertools.combinations(range(len(axes)), 2):
        assert {(row[one], row[other]) for row in rows} == set(itertools.product(axes[one], axes[other]))
    assert len(set(rows)) == len(rows)
    largest, second = sorted(sizes)[-1:-3:-1]
    assert len(rows) <= 2 * largest * second


def test_marks_of_values_are_those_of_their_rows():
    rows = pairwise(["a", pytest.param("b", marks=pytest.mark.opencl)], [1, 2])
    assert {row.values: [mark.name for mark in row.marks] for row in rows} == {
        ("a", 1): [],
        ("a", 2): [],
        ("b", 1): ["opencl"],
        ("b", 2): ["opencl"],
    }


@pytest.mark.parametrize("times", [1, 2, 3])
def test_each_value_of_the_first_axis_occurs_as_often_as_asked_and_the_others_in_turn(times):
    rows = [param.values for param in spread("abcdef", [1, 2], ["x", "y", "z"], times=times)]
    assert [row[0] for row in rows] == [letter for letter in "abcdef" for _ in range(times)]
    assert {row[1:] for row in rows} == set(itertools.product([1, 2], ["x", "y", "z"]))
    assert len(set(rows)) == len(rows)
