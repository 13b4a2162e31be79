"""The processors of the catalogue, against the algebra that they were found with and against oscillators."""

import numpy as np
import pytest
from scipy.linalg import expm

import openmm_exactrb as rb
from benchmarks.schemes import processors
from orders import exponent
from sequences import gradient_kicks


@pytest.mark.parametrize(("name", "order"), [("W2_1", 2), ("W4_4", 4), ("S2_3", 2), ("Chin4A", 4), ("W4_5", 4)])
def test_conditions_of_the_order_hold(name, order):
    zero, leading = processors.conditions(rb.SCHEMES[name], order)
    assert np.abs(zero).max() < 1e-12
    assert np.abs(leading).max() > 1e-6


def test_without_its_processor_a_kernel_is_of_order_two():
    zero, _ = processors.conditions(rb.SCHEMES["TI2"], 4)
    assert np.abs(zero).max() > 1e-2


def test_the_series_is_that_of_matrices():
    """The modified field of an oscillator, by matrices, differs from the series by what is beyond its degrees."""
    scheme, errors = rb.SCHEMES["W4_4"], []
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [-1.0, 0.0]])
    sizes = 0.02, 0.03, 0.04
    for x in sizes:
        words = {"": np.eye(2)}
        for _ in range(processors.DEGREES - 1):
            # The first letter acts first, so that its matrix stands behind: matrices multiply the other way round.
            words |= {letter + word: M @ m for word, M in words.items() for letter, m in (("A", x * A), ("B", x * B))}
        field = processors.modified(scheme)
        series = sum(
            field[2 ** len(w) - 1 + int("0" + w.replace("A", "0").replace("B", "1"), 2)] * M for w, M in words.items()
        )
        whole = [*scheme.processor, *scheme.sequence, *scheme.postprocessor]
        step = processors.matrices(whole, np.array([x]))[0]
        errors.append(np.abs(expm(series) - step).max())
    assert errors[0] < 1e-9
    assert exponent(sizes, errors) > 5.5


@pytest.mark.parametrize(("name", "kernel", "steps"), [("W2_1", "V2_drift", 1), ("W4_4", "TI2", 2)])
def test_what_swings_is_gone_and_the_frequency_stays(name, kernel, steps):
    x = np.linspace(0.2, 0.9, 9)
    form, frequency = processors.swing(rb.SCHEMES[name], steps * x)
    before, same = processors.swing(rb.SCHEMES[kernel], x)
    assert np.abs(form).max() < 0.01 * np.abs(before).max()
    np.testing.assert_allclose(frequency, same, rtol=1e-6, atol=1e-12)


def test_displacements_to_either_side_leave_a_step_that_goes_back_nearly():
    """Two half steps that differ are no palindrome; what is left is far smaller than what a step is wrong by."""
    pair = rb.SCHEMES["W4_4"]
    assert pair.b == (0.5, 0.5)
    first, second = gradient_kicks(pair)
    assert first.strength == -second.strength
    assert pair.c == pytest.approx([c / 8.0 for c in 2 * rb.SCHEMES["TI2"].c])
