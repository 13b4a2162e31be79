"""Jacobi's elliptic functions and the elliptic integral of the third kind, as required for a free rigid body.

All functions use the *complementary* parameter kc² = 1 - k², because near the separatrix of the rigid body kc is tiny
and cannot be recovered from k. `scipy.special.ellipj` takes k², and therefore cannot be used there.
"""

from __future__ import annotations

import numpy as np

from openmm_exactrb.mathematics.quaternions import Real
from openmm_exactrb.support.types import Array

#: Beyond this argument, sech(v)² would leave the range of float64. On the separatrix, the functions are constant there.
SEPARATRIX_LIMIT = 345.0
#: Below this phase, sn v = v, cn v = dn v = 1 to the last bit, and the recurrence in cot(phase) would overflow.
TINY_PHASE = 1e-60
#: For p above this value, three terms of the series of R_J in 1/sqrt(p) are exact to roundoff.
LARGE_P = 1e11
#: If x and y are below this bound and below p times this bound, their first-order terms in R_J are below roundoff.
TINY_SQUARE = 1e-60


def jacobi(v: Array, kc2: Array) -> tuple[Array, Array, Array, Array]:
    """Return Jacobi's sn, cn and dn of v (N,), and the integer nearest to v/2K (odd where cn < 0, 0 where kc = 0).

    kc2 (N,) is the complementary parameter 1 - k², from 0 (tanh and sech) to 1 (sine and cosine). Small values of cn
    and dn keep their relative accuracy.

    Notes
    -----
    R. Bulirsch, Numer. Math. 7, 78 (1965), doi:10.1007/BF01397975: descending Landen transformations with the
    recurrence in cot(am v), so that no inverse function is needed.
    """
    separatrix = kc2 == 0.0
    a = np.ones_like(v)
    g = np.where(separatrix, 1.0, np.sqrt(kc2))
    means = []
    while True:
        means.append((a, g))
        converged = not np.any(np.abs(a - g) > 1e-8 * a)
        a, g = 0.5 * (a + g), np.sqrt(a * g)
        if converged:
            break
    phase = v * a
    sine, cosine = np.sin(phase), np.cos(phase)

    tiny = np.abs(sine) < TINY_PHASE
    t = cosine / np.where(tiny, 1.0, sine)
    c = a * t
    dn = np.ones_like(v)
    for a_i, g_i in reversed(means):
        t = c * t
        c = dn * c
        dn = (g_i + t) / (a_i + t)
        t = c / a_i
    sn = np.copysign(1.0 / np.hypot(1.0, c), sine)
    cn = c * sn

    if tiny.any():
        sn, cn = np.where(tiny, v, sn), np.where(tiny, np.copysign(1.0, cosine), cn)
        dn = np.where(tiny, 1.0, dn)
    odd = np.where(cn < 0.0, 1.0, 0.0)
    half_turns = odd + 2.0 * np.rint(0.5 * (phase / np.pi - odd))
    if separatrix.any():
        bounded = np.clip(v, -SEPARATRIX_LIMIT, SEPARATRIX_LIMIT)
        sech = 1.0 / np.cosh(bounded)
        sn = np.where(separatrix, np.tanh(bounded), sn)
        cn, dn = np.where(separatrix, sech, cn), np.where(separatrix, sech, dn)
        half_turns = np.where(separatrix, 0.0, half_turns)
    return sn, cn, dn, half_turns


def third_kind(v: Array, kc2: Array, c: Array, b: Array, w: Array, cn: Array, dn: Array, half_turns: Array) -> Array:
    """Integrate b w² / (1 + b w²), where w = sn(v)/c, over v/c from v = 0, across any number of half periods.

    cn, dn and half_turns are the results of `jacobi` for v and kc2; b and c are not negative. If c is zero, v is zero
    and w is the limit of sn(v)/c.

    Notes
    -----
    For abs(v) <= K the integral is b/3 w³ R_J(cn², dn², 1, 1 + b w²) with Carlson's R_J (DLMF 19.25.14); if kc = 0, the
    integral is elementary.
    """
    separatrix = kc2 == 0.0
    reduced = np.where(cn < 0.0, -w, w)
    integral: Array = b / 3.0 * reduced**3 * carlson_rj(np.where(separatrix, 1.0, cn * cn), dn * dn, 1.0 + b * w * w)
    turned = half_turns != 0.0
    if turned.any():
        frequency = np.where(turned, c, 1.0)
        beta = b / (frequency * frequency)
        complete = beta / frequency * carlson_rj(0.0, np.where(turned, kc2, 1.0), 1.0 + beta)
        integral = integral + np.where(turned, 2.0 / 3.0 * half_turns * complete, 0.0)
    if separatrix.any():
        frequency = np.where(separatrix, c, 1.0)
        beta = b / (frequency * frequency)
        root = np.sqrt(np.where(beta > 0.0, b, 1.0))
        elementary = beta / (1.0 + beta) * (v / frequency - np.arctan(root * w) / root)
        integral = np.where(separatrix, elementary, integral)
    return integral


def carlson_rj(x: Array | float, y: Array, p: Array) -> Array:
    """Return Carlson's R_J(x, y, 1, p) for arrays (N,) with 0 <= x, y <= 1 and p > 0; x may also be a number.

    Notes
    -----
    SciPy is used except in two limits. For large p, SciPy omits the last term of 3/p (R_F - pi/(2 sqrt(p)) + 2 R_G/p),
    which is up to 1e-13 of the result; the next term is of order p^-3/2 (DLMF 19.27.11-13). If the product x y is not a
    normal number, SciPy's result is wrong by up to 1e-3; the result returned here is 3/p (log(4/(sqrt(x) + sqrt(y))) -
    R_C(1, p)), which equals R_J(x', x', 1, p) for an x' between x and y.
    """
    from scipy.special import elliprc, elliprf, elliprg, elliprj  # imported here, because it is slow to import

    x, y, p = np.broadcast_arrays(x, y, p)
    integral: Array = np.asarray(elliprj(x, y, 1.0, p), dtype=np.float64)
    large = p > LARGE_P
    if large.any():
        X, Y, P = x[large], y[large], p[large]
        integral[large] = 3.0 / P * (elliprf(X, Y, 1.0) - 0.5 * np.pi / np.sqrt(P) + 2.0 / P * elliprg(X, Y, 1.0))
    tiny = np.maximum(x, y) < TINY_SQUARE * np.minimum(p, 1.0)
    if tiny.any():
        roots, P = np.sqrt(x[tiny]) + np.sqrt(y[tiny]), p[tiny]
        integral[tiny] = 3.0 / P * (np.log(4.0 / roots) - elliprc(1.0, P))
    return integral


def third_kind_short(w: Array, x: Array, z: Array, b: Array) -> Array:
    """Integrate b s² / ((1 + b s²) sqrt((1 - x s²)(1 - z s²))) over s from 0 to w, for abs(w) <= 0.3.

    The integral is computed by Gauss's rule with ten nodes on [-w, w], or with six nodes if all abs(w) <= 0.1; since
    the integrand is even, it is evaluated at half of the nodes. For x, z and b in [0, 1], the singularities of the
    integrand are at least a distance of 1 from zero, and the rule is exact to roundoff.
    """
    nodes_squared, weights = RULES[0] if np.max(np.abs(w), initial=0.0) <= 0.1 else RULES[1]
    square = nodes_squared * (w * w)
    bs, root = b * square, (1.0 - x * square) * (1.0 - z * square)
    np.sqrt(root, out=root)
    root *= 1.0 + bs
    bs /= root
    integral: Array = w * (weights @ bs)
    return integral


def _even_rule(n: int) -> tuple[Array, Array]:
    """Return the squared positive nodes (n, 1) and the weights of Gauss's rule with 2n nodes on [-1, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(2 * n)
    return (nodes[n:] ** 2)[:, None], weights[n:]


#: Gauss's rules with 6 and 10 points for even integrands: squared nodes (n, 1) and weights (n,).
RULES = (_even_rule(3), _even_rule(5))


def sine_short(s: Real, x: Real, z: Real) -> Real:
    """Return w = sn(v)/c at s = v/c for abs(s) <= 0.3, where dw/ds = sqrt((1 - x w²)(1 - z w²)).

    x and z are in [0, 1]. The Taylor series to eleventh order is evaluated at s/2, and the argument is then doubled.
    """
    half = 0.5 * s
    u = half * half
    P, q = (x + z) * u, (x * z) * (u * u)
    in_P = 1.0 + P * (-1 / 6 + P * (1 / 120 + P * (-1 / 5040 + P * (1 / 362880 - P / 39916800))))
    in_q = 1 / 10 + P * (-11 / 420 + P * (17 / 5040 - P * (461 / 1663200))) + q * (1 / 120 - P * (307 / 92400))
    w = half * (in_P + q * in_q)
    u = w * w
    xu, zu = x * u, z * u
    return 2.0 * w * np.sqrt((1.0 - xu) * (1.0 - zu)) / (1.0 - xu * zu)


def third_kind_legendre(sn: Array, cn: Array, dn: Array, half_turns: Array, kc2: Array, nc: Array) -> Array:
    """Return Legendre's incomplete integral of the third kind minus its argument, Pi(n; am u, k) - u, for any u.

    The result is the integral of n sn² / (1 - n sn²) from 0 to u. For abs(u) <= K, it is n/3 sn³ R_J(cn², dn², 1, 1 - n
    sn²) (DLMF 19.25.14). The arguments are the results of `jacobi` for u, positive kc2 = 1 - k², and positive nc
    = 1 - n.
    """
    sn2, cn2 = sn * sn, cn * cn
    folded = np.where(cn < 0.0, -sn, sn)
    integral = folded * sn2 * carlson_rj(cn2, dn * dn, cn2 + nc * sn2)
    turned = half_turns != 0.0
    if turned.any():
        integral = integral + 2.0 * half_turns * carlson_rj(0.0, np.where(turned, kc2, 1.0), nc)
    excess: Array = (1.0 - nc) / 3.0 * integral
    return excess
