"""Statistical errors of the means of correlated series."""

import numpy as np
import pytest
from scipy import signal

from openmm_exactrb.averages.correlation import error_of_mean


@pytest.mark.parametrize(("n", "time"), [(200, 0.0), (40, 0.0), (200, 2.0), (200, 10.0), (1000, 20.0), (40, 2.0)])
def test_the_error_is_the_scatter_of_the_means_of_independent_series(n, time):
    """Of autoregressive series with a correlation time; 20 blocks give 0.4 to 0.9 of the error for the last four."""
    kept = np.exp(-1.0 / time) if time else 0.0
    noise = np.random.default_rng(7).standard_normal((3000, n))
    noise[:, 1:] *= np.sqrt(1.0 - kept**2)
    series = signal.lfilter([1.0], [1.0, -kept], noise, axis=1)
    errors = np.array([error_of_mean(one) for one in series])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(series.mean(axis=1).std(), rel=0.12)
    if (n, time) == (200, 10.0):
        assert errors.std() / errors.mean() == pytest.approx(0.4, abs=0.05)  # docs/how-to/temperature.md


def test_the_error_of_a_constant_is_zero():
    assert error_of_mean(np.full(40, 1.5)) == 0.0


def test_the_error_scales_with_the_series():
    series = np.random.default_rng(1).standard_normal(100)
    assert error_of_mean(10.0 + 1e6 * series) == pytest.approx(1e6 * error_of_mean(series))
