"""The free rigid body to 30 digits, the classical way, with mpmath.

Deliberately another way than the code under test: a phase from the incomplete integral of the first kind, Legendre's
integral of the third kind continued past its periods, Euler angles about the axis that the momentum circles. What is
degenerate (sphere, symmetric top, stationary rotation, separatrix) is decided exactly, in rational numbers, and has its
own closed form; what is nearly degenerate gets more digits.
"""

from __future__ import annotations

from fractions import Fraction

import mpmath as mp
import numpy as np

DIGITS = 30


def free_rotor(inertia, q0, m0, t, digits=DIGITS):
    """Return the rotation matrix (mp.matrix) and the momentum (list of mpf) at time t.

    Numbers handed in (float or mpf) are exact; q0 is normalised.
    """
    moments, momentum, time = [[_fraction(x) for x in v] for v in (inertia, m0, [t])]
    with mp.workdps(digits + 30 + _lost_digits(moments, momentum, time[0])):
        Q0 = rotation_matrix([mp.mpf(x) for x in q0], normalise=True)
        if not any(momentum) or time[0] == 0:
            return Q0, [_mpf(x) for x in momentum]
        order, sign = _ascending(moments)
        I = [moments[i] for i in order]
        turn, m1 = _solve(I, [sign * momentum[i] for i in order], time[0])
        m = [None] * 3
        P = mp.zeros(3)
        for k, i in enumerate(order):
            m[i] = sign * m1[k]
            P[i, k] = sign
        return Q0 * (P * turn * P.T), m


def errors(reference, m0, q1, m1):
    """Return the errors of (q1, m1): of the momentum relative to its norm, and of the rotation matrix's entries."""
    Q, m = reference
    norm = mp.sqrt(sum(mp.mpf(x) ** 2 for x in m0)) or mp.mpf(1)
    Q1 = rotation_matrix([mp.mpf(x) for x in q1])
    error_m = max(abs(mp.mpf(a) - b) for a, b in zip(m1, m, strict=True)) / norm
    error_Q = max(abs(Q1[i, j] - Q[i, j]) for i in range(3) for j in range(3))
    return float(error_m), float(error_Q)


def taylor(inertia, q0, m0, t, digits=DIGITS, order=40):
    """Integrate the differential equations themselves, by Taylor series; returns what `free_rotor` returns."""
    with mp.workdps(digits + 15):
        I = [mp.mpf(x) for x in inertia]
        m = [mp.mpf(x) for x in m0]
        q = [mp.mpf(x) for x in q0]
        rate = max(abs(x) for x in m) / min(I)
        steps = max(1, int(mp.ceil(abs(t) * rate * 4)))
        h = mp.mpf(t) / steps
        for _ in range(steps):
            m, q = _taylor_step(I, m, q, h, order)
        return rotation_matrix(q, normalise=True), m


def rotation_matrix(q, normalise=False):
    """Return the matrix of a quaternion, scalar first."""
    if normalise:
        norm = mp.sqrt(sum(x * x for x in q))
        q = [x / norm for x in q]
    w, x, y, z = q
    return mp.matrix(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def _taylor_step(I, m, q, h, order):
    M, W, Qs = [[x] for x in m], [[a / b] for a, b in zip(m, I, strict=True)], [[x] for x in q]

    def conv(a, b, k):
        return mp.fdot(a[: k + 1], reversed(b[: k + 1]))

    for k in range(order):
        for i in range(3):
            j, l = (i + 1) % 3, (i + 2) % 3
            M[i].append((conv(M[j], W[l], k) - conv(M[l], W[j], k)) / (k + 1))
        w, x, y, z = Qs
        new = (
            -conv(x, W[0], k) - conv(y, W[1], k) - conv(z, W[2], k),
            conv(w, W[0], k) + conv(y, W[2], k) - conv(z, W[1], k),
            conv(w, W[1], k) + conv(z, W[0], k) - conv(x, W[2], k),
            conv(w, W[2], k) + conv(x, W[1], k) - conv(y, W[0], k),
        )
        for c, value in zip(Qs, new, strict=True):
            c.append(value / (2 * (k + 1)))
        for i in range(3):
            W[i].append(M[i][k + 1] / I[i])
    powers = [h**k for k in range(order + 1)]
    return tuple([mp.fdot(c, powers) for c in group] for group in (M, Qs))


def _fraction(x):
    if isinstance(x, mp.mpf):
        sign, mantissa, exponent, _ = x._mpf_
        return Fraction((-1) ** sign * int(mantissa)) * Fraction(2) ** int(exponent)
    return Fraction(float(x))


def _mpf(x):
    return mp.mpf(x.numerator) / x.denominator


def _lost_digits(I, m, t):
    """Digits that nearly degenerate bodies and long times cost."""
    G2 = sum(x * x for x in m)
    if not G2:
        return 0
    I1, I2, I3 = sorted(I)
    small = [(I2 - I1) / I3, (I3 - I2) / I3, (2 * _kinetic(I, m) * I2 - G2) / G2, *(x * x / G2 for x in m)]
    lost = sum(max(0.0, -float(mp.log10(_mpf(abs(x))))) for x in small if x)
    return int(lost + max(0.0, float(mp.log10(1 + abs(_mpf(t * t * G2 / I1**2))))))


def _kinetic(I, m):
    return sum(x * x / i for x, i in zip(m, I, strict=True)) / 2


def _ascending(moments):
    order = sorted(range(3), key=lambda i: moments[i])
    even = [(order[0] + k) % 3 for k in range(3)] == order
    return order, 1 if even else -1


def _solve(I, m, t):
    """Return the rotation of the step and the new momentum, for rational I1 <= I2 <= I3 and m."""
    I1, I2, I3 = I
    G2 = sum(x * x for x in m)
    excess = 2 * _kinetic(I, m) * I2 - G2  # the sign tells the two families, zero is the separatrix
    if I1 == I3:
        return _uniform(m, _mpf(t / I1)), [_mpf(x) for x in m]
    if sum(1 for x in m if x) == 1:
        axis = next(i for i in range(3) if m[i])
        return _uniform(m, _mpf(t / I[axis])), [_mpf(x) for x in m]
    if I1 == I2:
        return _symmetric_top(I, m, t, axis=2)
    if I2 == I3:
        return _symmetric_top(I, m, t, axis=0)
    return _asymmetric_top(I, m, t, excess)


def _uniform(m, time):
    """Rotation about the momentum by the angle norm(m) time."""
    m = [_mpf(x) for x in m]
    norm = mp.sqrt(sum(x * x for x in m))
    return _rotation([x / norm for x in m], norm * time)


def _rotation(axis, angle):
    half = angle / 2
    return rotation_matrix([mp.cos(half), *(mp.sin(half) * x for x in axis)])


def _symmetric_top(I, m, t, axis):
    """Rotation about the momentum by G t/I_perp, then about the figure axis."""
    perpendicular = I[1]
    rate = _mpf(m[axis] * (1 / I[axis] - 1 / perpendicular)) * _mpf(t)
    e = [mp.mpf(i == axis) for i in range(3)]
    back = _rotation(e, -rate)
    m1 = back * mp.matrix([_mpf(x) for x in m])
    return _uniform(m, _mpf(t / perpendicular)) * _rotation(e, rate), list(m1)


def _asymmetric_top(I, m, t, excess):
    """Jacobi's solution, with Euler angles about the axis j that the momentum circles."""
    j, l = (0, 2) if excess >= 0 else (2, 0)
    G2 = sum(x * x for x in m)
    G, T2 = mp.sqrt(_mpf(G2)), 2 * _kinetic(I, m)
    I1, I2, I3 = I
    # Amplitudes: m_j = A_j dn, m_2 = A_2 sn, m_l = A_l cn.
    drop = abs(G2 - T2 * I[l])
    Aj = mp.sqrt(_mpf(I[j] * drop / (I3 - I1))) * (1 if m[j] >= 0 else -1)
    other = abs(T2 * I[j] - G2)
    A2 = mp.sqrt(_mpf(I2 * other / abs(I2 - I[j])))
    Al = mp.sqrt(_mpf(I[l] * other / (I3 - I1)))
    rate = mp.sqrt(_mpf(abs(I2 - I[j]) * drop / (I1 * I2 * I3)))
    # The sign of the direction in which the phase runs: m_2' = m_3 m_1 (I3 - I1)/(I1 I3).
    direction = 1 if Aj >= 0 else -1
    k2 = _mpf(abs(I2 - I[l]) * other / (abs(I2 - I[j]) * drop))
    sn0, cn0 = _mpf(m[1]) / A2, _mpf(m[l]) / Al
    change = direction * rate * _mpf(t)
    ratio = _mpf(1 / Fraction(I[j]))
    gain = _mpf(T2 - G2 / I[j])
    # Precession about G: G (2T - m_j²/I_j)/(G² - m_j²) = G/I_j + G gain/(G² - Aj² dn²).
    floor = _mpf(G2) - Aj**2
    if excess == 0:
        u0 = mp.asinh(_mpf(m[1]) / A2 / abs(cn0)) if cn0 else None
        # On the separatrix m_j and m_l have signs of their own, and dn = |cn| = sech.
        sign_l = 1 if cn0 >= 0 else -1
        # A phase that grows needs m_2' > 0, that is m_3 m_1 > 0.
        change = sign_l * change
        u1 = u0 + change
        sn1, dn1 = mp.tanh(u1), mp.sech(u1)
        cn1 = sign_l * dn1
        p = Aj**2 / _mpf(G2)
        c = mp.sqrt(p / (1 - p))
        integral = (change + c * (mp.atan(c * sn1) - mp.atan(c * sn0))) / _mpf(G2)
        integral *= 1 / (direction * sign_l * rate)
    else:
        phi0 = mp.atan2(sn0, cn0)
        complete = mp.ellipk(k2)
        u0 = _first_kind(phi0, k2, complete)
        u1 = u0 + change
        turns = mp.nint(u1 / (2 * complete))
        v = u1 - 2 * turns * complete
        sign = -1 if int(turns) % 2 else 1
        sn1, cn1, dn1 = (mp.ellipfun(name, v, m=k2) for name in ("sn", "cn", "dn"))
        sn1, cn1 = sign * sn1, sign * cn1
        n = -(Aj**2) * k2 / floor
        phi1 = mp.atan2(sign * sn1, sign * cn1) + turns * mp.pi
        integral = (_third_kind(n, phi1, k2) - _third_kind(n, phi0, k2)) / (floor * direction * rate)
    m1 = [None] * 3
    m1[j], m1[1], m1[l] = Aj * dn1, A2 * sn1, Al * cn1
    precession = G * (ratio * _mpf(t) + gain * integral)
    start, end = (_frame(v, j, G) for v in ([_mpf(x) for x in m], m1))
    return start.T * _rotation([0, 0, 1], precession) * end, m1


def _frame(m, j, G):
    """Rotation that takes m to the third axis, its first axis along e_j x m: the node line of Euler's angles."""
    third = [x / G for x in m]
    e = [mp.mpf(i == j) for i in range(3)]
    node = _cross(e, third)
    size = mp.sqrt(sum(x * x for x in node))
    node = [x / size for x in node]
    return mp.matrix([node, _cross(third, node), third])


def _cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _first_kind(phi, k2, complete):
    """F(phi, k²) for any phi."""
    turns = mp.nint(phi / mp.pi)
    s = phi - turns * mp.pi
    return mp.sin(s) * mp.elliprf(mp.cos(s) ** 2, 1 - k2 * mp.sin(s) ** 2, 1) + 2 * turns * complete


def _third_kind(n, phi, k2):
    """Pi(n; phi, k²) for any phi and n <= 0, by Carlson's integrals."""
    turns = mp.nint(phi / mp.pi)
    s = mp.sin(phi - turns * mp.pi)
    c2, d2 = 1 - s * s, 1 - k2 * s * s
    value = s * mp.elliprf(c2, d2, 1) + n / 3 * s**3 * mp.elliprj(c2, d2, 1, 1 - n * s * s)
    if turns:
        value += 2 * turns * (mp.elliprf(0, 1 - k2, 1) + n / 3 * mp.elliprj(0, 1 - k2, 1, 1 - n))
    return value


def random_bodies(regime, n=100, seed=0):
    """Return inertia (n, 3) and unit momenta (n, 3) of a regime; the moments come in all orders."""
    rng = np.random.default_rng([seed, sorted(REGIMES).index(regime)])
    inertia, m = REGIMES[regime](rng, n)
    order = rng.permuted(np.tile(np.arange(3), (n, 1)), axis=1)
    return np.take_along_axis(inertia, order, 1), np.take_along_axis(m, order, 1)


def _generic(rng, n):
    inertia = np.sort(rng.uniform(0.2, 1.0, (n, 3)), axis=1)
    m = rng.standard_normal((n, 3))
    return inertia, m / np.linalg.norm(m, axis=1, keepdims=True)


def _near_separatrix(distance):
    def bodies(rng, n):
        inertia, m = _generic(rng, n)
        I1, I2, I3 = inertia.T
        ratio = np.sqrt(I3 * (I2 - I1) / (I1 * (I3 - I2)))
        m[:, 2] = np.copysign(m[:, 0], m[:, 2]) * ratio * (1.0 + distance * rng.choice([-1.0, 1.0], n))
        return inertia, m / np.linalg.norm(m, axis=1, keepdims=True)

    return bodies


def _on_separatrix(rng, n):
    inertia = np.tile([1.0, 2.5, 4.0], (n, 1)) * 0.25
    m = rng.standard_normal((n, 3))
    m[:, 2] = 2.0 * m[:, 0] * rng.choice([-1.0, 1.0], n)
    return inertia, m


def _symmetric(first, second, difference):
    def bodies(rng, n):
        inertia, m = _generic(rng, n)
        inertia[:, second] = inertia[:, first] * (1.0 + difference)
        return np.sort(inertia, axis=1), m

    return bodies


def _near_axis(axis, distance):
    def bodies(rng, n):
        inertia, m = _generic(rng, n)
        sign = np.copysign(1.0, m[:, axis])
        m *= distance
        m[:, axis] = sign
        return inertia, m

    return bodies


def _spherical(rng, n):
    inertia, m = _generic(rng, n)
    inertia[:] = inertia[:, :1]
    return inertia, m


def _thin(rng, n):
    _, m = _generic(rng, n)
    return np.tile([1e-3, 1.0, 1.0], (n, 1)), m


def _resting(rng, n):
    inertia, m = _generic(rng, n)
    return inertia, 0.0 * m


REGIMES = {
    "generic": _generic,
    **{f"separatrix at {d:g}": _near_separatrix(d) for d in (1e-4, 1e-8, 1e-12)},
    "on the separatrix": _on_separatrix,
    **{
        f"I{a + 1} = I{b + 1}{'' if d == 0 else f' within {d:g}'}": _symmetric(a, b, d)
        for a, b in ((0, 1), (1, 2))
        for d in (0.0, 1e-4, 1e-10)
    },
    **{
        f"{'on' if d == 0 else f'within {d:g} of'} axis {k + 1}": _near_axis(k, d)
        for k in range(3)
        for d in (0.0, 1e-6, 1e-10)
    },
    "spherical": _spherical,
    "thin": _thin,
    "resting": _resting,
}
