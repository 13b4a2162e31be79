"""The statistical error of the mean of a correlated series."""

from __future__ import annotations

import math

from openmm_exactrb.support.types import Array

# The ratio of the window to the integrated autocorrelation time.
_WINDOW = 5.0


def error_of_mean(series: Array) -> float:
    """Return the standard deviation of the mean of a stationary series.

    The variance of the mean of n values is 2 tau/n times their variance. The integrated autocorrelation time tau is 1/2
    plus the sum of the autocorrelations in a window of 5 tau. As the mean is estimated too, n is reduced by the width
    of the window: U. Wolff (2004), doi:10.1016/S0010-4655(03)00467-3.
    """
    n, off = len(series), series - series.mean()
    variance = float(off @ off) / n
    if not variance:
        return 0.0
    tau, window = 0.5, 0
    while window < _WINDOW * tau and window < n // 4:
        window += 1
        tau += float(off[window:] @ off[:-window]) / (n * variance)
    return math.sqrt(2.0 * max(tau, 0.25) * variance / (n - (2 * window + 1)))
