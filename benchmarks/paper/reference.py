"""Free rigid bodies by Taylor series in double-double arithmetic: a 30-digit reference without elliptic functions.

A number is an unevaluated sum of two doubles. The innermost loops run over bodies, so that bodies are processed
together in vector registers.
"""

import numba
import numpy as np

_LANES = 32
_ORDER = 26
_REACH = 0.45
_kernel = numba.njit(cache=True, error_model="numpy")


@_kernel
def _split(a):
    """Return the upper 26 bits and the rest."""
    t = 134217729.0 * a
    high = t - (t - a)
    return high, a - high


@_kernel
def _add_product(total, rest, a, row, b, column, k):
    """Add the sum over j of a[row, j] b[column, k - j] to total + rest; both are (component, j, hi and lo, lane)."""
    for j in range(k + 1):
        for i in range(_LANES):
            a0, a1, b0, b1 = a[row, j, 0, i], a[row, j, 1, i], b[column, k - j, 0, i], b[column, k - j, 1, i]
            p = a0 * b0
            ah, al = _split(a0)
            bh, bl = _split(b0)
            error = ((ah * bh - p) + ah * bl + al * bh) + al * bl + (a0 * b1 + a1 * b0)
            s = total[i] + p
            shadow = s - total[i]
            rest[i] += error + ((total[i] - (s - shadow)) + (p - shadow))
            total[i] = s


@_kernel
def _scaled(out, total, rest, factor, divisor):
    """Write (total + rest) factor / divisor; factor is (hi and lo, lane)."""
    for i in range(_LANES):
        a0 = total[i] + rest[i]
        a1 = rest[i] - (a0 - total[i])
        p = a0 * factor[0, i]
        ah, al = _split(a0)
        bh, bl = _split(factor[0, i])
        error = ((ah * bh - p) + ah * bl + al * bh) + al * bl + (a0 * factor[1, i] + a1 * factor[0, i])
        s = p + error
        error -= s - p
        q = s / divisor
        qh, ql = _split(q)
        dh, dl = _split(divisor)
        p = q * divisor
        remainder = (s - p) - (((qh * dh - p) + qh * dl + ql * dh) + ql * dl) + error
        r = remainder / divisor
        out[0, i] = q + r
        out[1, i] = r - (out[0, i] - q)


@_kernel
def _steps(m, q, rate, half, n):
    """Advance m (3, order + 1, 2, lane) and q (4, ...), whose first coefficients are the state, by n steps."""
    total, rest = np.empty(_LANES), np.empty(_LANES)
    one = np.zeros((2, _LANES))
    one[0] = 1.0
    for _ in range(n):
        for k in range(_ORDER):
            for c in range(3):
                total[:], rest[:] = 0.0, 0.0
                _add_product(total, rest, m, (c + 1) % 3, m, (c + 2) % 3, k)
                _scaled(m[c, k + 1], total, rest, rate[c], k + 1.0)
            # qdot = q (0, omega)/2, row by row; w holds h omega / 2.
            for row in range(4):
                total[:], rest[:] = 0.0, 0.0
                for c in range(3):
                    source, sign = _quaternion_term(row, c)
                    part, low = np.zeros(_LANES), np.zeros(_LANES)
                    _add_product(part, low, q, source, m, c, k)
                    scaled = np.empty((2, _LANES))
                    _scaled(scaled, part, low, half[c], 1.0)
                    for i in range(_LANES):
                        s = total[i] + sign * scaled[0, i]
                        shadow = s - total[i]
                        rest[i] += (total[i] - (s - shadow)) + (sign * scaled[0, i] - shadow) + sign * scaled[1, i]
                        total[i] = s
                _scaled(q[row, k + 1], total, rest, one, k + 1.0)
        for state in (m, q):
            for c in range(state.shape[0]):
                for k in range(_ORDER):
                    down = _ORDER - 1 - k
                    for i in range(_LANES):
                        a, b = state[c, down, 0, i], state[c, down + 1, 0, i]
                        s = a + b
                        shadow = s - a
                        low = (a - (s - shadow)) + (b - shadow) + state[c, down, 1, i] + state[c, down + 1, 1, i]
                        state[c, down, 0, i] = s + low
                        state[c, down, 1, i] = low - (state[c, down, 0, i] - s)


@_kernel
def _quaternion_term(row, c):
    """Return which component of q stands with omega_c in row `row` of q (0, omega), and its sign."""
    if row == 0:
        return c + 1, -1.0
    if row - 1 == c:
        return 0, 1.0
    other = 3 - c - (row - 1)  # the third axis
    return other + 1, 1.0 if (other - c) % 3 == 2 else -1.0


def _pair(x):
    """Return hi and lo parts of longdouble values along a new axis before the last."""
    high = x.astype(np.float64)
    return np.stack([high, (x - high).astype(np.float64)], axis=-2)


def taylor(inertia, m, t):
    """Return attitudes (4, n) and momenta (3, n) of free bodies at the time t, from attitudes (1, 0, 0, 0).

    Parameters
    ----------
    inertia, m : (3, n) arrays
    t : float

    Returns
    -------
    q, m : longdouble arrays
    """
    steps = np.ceil(t * np.linalg.norm(m, axis=0) / inertia.min(axis=0) / _REACH)
    steps = np.ceil(2.0 ** (np.ceil(4.0 * np.log2(np.maximum(steps, 4.0))) / 4.0)).astype(int)
    q1, m1 = np.empty((4, m.shape[1]), np.longdouble), np.empty((3, m.shape[1]), np.longdouble)
    for count in np.unique(steps):
        same = np.flatnonzero(steps == count)
        for first in range(0, len(same), _LANES):
            chosen = np.resize(same[first : first + _LANES], _LANES)
            I, h = inertia[:, chosen].astype(np.longdouble), np.longdouble(t) / np.longdouble(int(count))
            inverse = 1 / I
            rate = (np.roll(inverse, -2, axis=0) - np.roll(inverse, -1, axis=0)) * h
            series_m, series_q = (np.zeros((c, _ORDER + 1, 2, _LANES)) for c in (3, 4))
            series_m[:, 0, 0], series_q[0, 0, 0] = m[:, chosen], 1.0
            _steps(series_m, series_q, _pair(rate), _pair(h * inverse / 2), int(count))
            m1[:, chosen], q1[:, chosen] = (s[:, 0].astype(np.longdouble).sum(axis=1) for s in (series_m, series_q))
    return q1, m1
