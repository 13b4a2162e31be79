"""The exact flow of the free rigid body, compiled: the twin of `exact`, with its formulas and its names.

Steps with b G h <= 0.3 go through `_short` in blocks of bodies. It has neither branches nor calls, so that the compiler
advances as many bodies at once as a vector register holds; sine and cosine are series after a reduction to an eighth
of a turn. All other steps go through `_long`, body by body.

The formulas are explained in `exact` and `elliptic`; momenta and moments are in ascending principal axes here.
"""

from __future__ import annotations

import math

import numpy as np

from openmm_exactrb.elliptic import RULES, SEPARATRIX_LIMIT, TINY_PHASE
from openmm_exactrb.kernels import compiled, inlined, inner
from openmm_exactrb.quaternions import TO_GRID
from openmm_exactrb.rotors.exact import ON_SEPARATRIX, SAFE, SHORT, VANISHING
from openmm_exactrb.sums_compiled import two_sum

# Bodies in a block. Its rows lie next to each other at distances that the compiler knows, so that it sees that they
# do not overlap.
_BLOCK = 64
_ROWS = 23
# h G/I3 up to which the reduction of its angle is exact to roundoff.
_LARGEST_ANGLE = 1e4
# pi/2 in three parts, the first two of 33 bits.
_P1, _P2, _P3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
# Adding and subtracting it rounds to an integer.
_ROUNDING = 6755399441055744.0
(_N0, _N1, _N2, _N3, _N4), (_W0, _W1, _W2, _W3, _W4) = RULES[1][0].ravel().tolist(), RULES[1][1].tolist()
_SMALLEST, _LARGEST = SAFE
_LANDEN = 24


@inner
def _short_block(block):
    """Advance a block.

    Rows: b, rho, sigma, 1/I3, m (3), t, q (4), the new m (3), whether the step was short, the low parts of q (4) and
    of m (3).
    """
    for i in range(_BLOCK):
        b, rho, sigma, inverse_I3 = block[i], block[_BLOCK + i], block[2 * _BLOCK + i], block[3 * _BLOCK + i]
        x1, x2, x3 = block[4 * _BLOCK + i], block[5 * _BLOCK + i], block[6 * _BLOCK + i]
        t0, t1, t2, t3, d1, d2, d3, is_short = _short(b, rho, sigma, inverse_I3, x1, x2, x3, block[7 * _BLOCK + i])
        q0, q1, q2, q3 = block[8 * _BLOCK + i], block[9 * _BLOCK + i], block[10 * _BLOCK + i], block[11 * _BLOCK + i]
        l0, l1, l2, l3 = block[16 * _BLOCK + i], block[17 * _BLOCK + i], block[18 * _BLOCK + i], block[19 * _BLOCK + i]
        p0, p1, p2, p3 = _product_of_quaternions(q0, q1, q2, q3, t0, t1, t2, t3)
        defect = 0.5 * _one_less_square(q0, q1, q2, q3) - (q0 * l0 + q1 * l1 + q2 * l2 + q3 * l3)
        p0, l0 = two_sum(q0, l0, p0 + q0 * defect)
        p1, l1 = two_sum(q1, l1, p1 + q1 * defect)
        p2, l2 = two_sum(q2, l2, p2 + q2 * defect)
        p3, l3 = two_sum(q3, l3, p3 + q3 * defect)
        block[8 * _BLOCK + i] = p0 if is_short else q0
        block[9 * _BLOCK + i] = p1 if is_short else q1
        block[10 * _BLOCK + i] = p2 if is_short else q2
        block[11 * _BLOCK + i] = p3 if is_short else q3
        block[12 * _BLOCK + i], d1 = two_sum(x1, block[20 * _BLOCK + i], d1)
        block[13 * _BLOCK + i], d2 = two_sum(x2, block[21 * _BLOCK + i], d2)
        block[14 * _BLOCK + i], d3 = two_sum(x3, block[22 * _BLOCK + i], d3)
        block[15 * _BLOCK + i] = 1.0 if is_short else 0.0
        block[16 * _BLOCK + i] = l0 if is_short else 0.0
        block[17 * _BLOCK + i] = l1 if is_short else 0.0
        block[18 * _BLOCK + i] = l2 if is_short else 0.0
        block[19 * _BLOCK + i] = l3 if is_short else 0.0
        block[20 * _BLOCK + i] = d1 if is_short else 0.0
        block[21 * _BLOCK + i] = d2 if is_short else 0.0
        block[22 * _BLOCK + i] = d3 if is_short else 0.0


@inlined
def _one_less_square(q0, q1, q2, q3):
    """Return 1 - q.q of a unit quaternion, as `quaternions.one_less_square` does."""
    h0, h1 = (q0 + TO_GRID) - TO_GRID, (q1 + TO_GRID) - TO_GRID
    h2, h3 = (q2 + TO_GRID) - TO_GRID, (q3 + TO_GRID) - TO_GRID
    rest = (q0 - h0) * (q0 + h0) + (q1 - h1) * (q1 + h1) + (q2 - h2) * (q2 + h2) + (q3 - h3) * (q3 + h3)
    return (1.0 - (h0 * h0 + h1 * h1 + h2 * h2 + h3 * h3)) - rest


@inlined
def _short(b, rho, sigma, inverse_I3, x1, x2, x3, t):
    """Return the rotation of a step less one, the change of the momentum, and whether the step is short enough."""
    square_G = x1 * x1 + x2 * x2 + x3 * x3
    G = math.sqrt(square_G)
    hG = t * G
    flip = -1.0 if x3 < 0.0 else 1.0
    inverse_G = 1.0 / G
    y1, y2, y3 = flip * x1 * inverse_G, x2 * inverse_G, flip * x3 * inverse_G
    size = max(abs(y1), abs(y2))
    is_short = (
        (abs(b * hG) <= SHORT)
        & (abs(hG * inverse_I3) <= _LARGEST_ANGLE)
        & (G > _SMALLEST)
        & (G < _LARGEST)
        & (size > VANISHING)
    )

    x = sigma * (y3 * y3 + rho * y2 * y2)
    transverse = y1 * y1 + sigma * y2 * y2
    B, z = sigma * transverse, rho * transverse
    w = _sine_short(b * hG, x, z)
    u = w * w
    cn, dn = math.sqrt(1.0 - x * u), math.sqrt(1.0 - z * u)
    half_angle = 0.5 * (hG * inverse_I3 + _third_kind_short(w, x, z, B))
    cosine, sine = _cosine_and_sine(half_angle)
    cn_less, dn_less = x * u / (1.0 + cn), z * u / (1.0 + dn)
    t0, t1, t2, t3, d1, d2, d3 = _rotate_little(y1, y2, y3, cn, dn, w, cn_less, dn_less, sigma, rho, cosine, sine)
    d1, d2, d3 = _keeping_the_norm(flip * d1 * G, d2 * G, flip * d3 * G, x1, x2, x3, square_G)
    return t0, flip * t1, t2, flip * t3, d1, d2, d3, is_short


@inlined
def _rotate_little(y1, y2, y3, cn, dn, w, cn_less, dn_less, r, s, cosine, sine):
    """Do as `_rotate`, but return the rotation less one and the change of y, with errors as small as they are.

    `cn_less` and `dn_less` are 1 - cn and 1 - dn.
    """
    wy3, cd = w * y3, cn * dn
    rw2 = r * wy3 * wy3
    inverse = 1.0 / (cn * cn + rw2)
    d1 = (y1 * (cn * cn_less - rw2) - r * wy3 * dn * y2) * inverse
    d2 = (y2 * (cn * (cn_less - dn_less) - rw2) + wy3 * y1) * inverse
    d3 = (y3 * (cn_less * (1.0 + cn) - dn_less - rw2) - s * w * cn * y1 * y2) * inverse
    n1, n2, n3 = y1 + d1, y2 + d2, y3 + d3

    re, im = y2 * y2 + y1 * (cn * n1 + wy3 * n2), -s * w * y2 * n2
    c, e = _twisted(cosine, sine, re, im, cd, w, y1 * n1 + y2 * n2, y2 * d1 - y1 * d2)
    less = _one_less(c, e)

    # z is the change of (y1 + i y2) as it turns.
    z1, z2 = d1 * c - d2 * e - (y1 * less + y2 * e), d1 * e + d2 * c - (y2 * less - y1 * e)
    a0, a1 = 1.0 + y3, 1.0 + n3
    product = a0 * a1
    scale = 0.5 / math.sqrt(product)
    t2 = -scale * (a0 * (z1 + y1 * less - y2 * e) - d3 * (y1 * c + y2 * e))
    t1 = scale * (a0 * (z2 + y2 * less + y1 * e) - d3 * (y2 * c - y1 * e))
    t3 = scale * (product * e + y2 * z1 - y1 * z2)
    along = scale * (product * c + y1 * (y1 + z1) + y2 * (y2 + z2))
    return -_one_less(along, math.sqrt(t1 * t1 + t2 * t2 + t3 * t3)), t1, t2, t3, d1, d2, d3


@inlined
def _one_less(cosine, sine):
    """Return 1 - cosine, without cancellation."""
    return sine * sine / (1.0 + cosine) if cosine > 0.0 else 1.0 - cosine


@inlined
def _rotate(y1, y2, y3, f1, f2, unit, cn, dn, w, r, s, extra_re, extra_im, cosine, sine):
    """Apply the addition theorem to y = (f1 unit, f2 unit, y3) and assemble the rotation of the step.

    `cosine` and `sine` are those of half the angle to which half the argument of the twist is added.
    """
    wy3, cd = w * y3, cn * dn
    inverse = 1.0 / (cn * cn + r * wy3 * wy3)
    g1 = (f1 * cn - r * wy3 * dn * f2) * inverse
    g2 = (f2 * cd + wy3 * f1) * inverse
    re, im = f2 * f2 + f1 * (cn * g1 + wy3 * g2), -s * w * f2 * g2
    c, e = _twisted(cosine, sine, re, im, extra_re, extra_im, f1 * g1 + f2 * g2, f2 * g1 - f1 * g2)

    n1, n2, n3 = g1 * unit, g2 * unit, (y3 * dn - s * w * cn * y1 * y2) * inverse
    a0, a1 = 1.0 + y3, 1.0 + n3
    z1, z2 = n1 * c - n2 * e, n1 * e + n2 * c
    product = a0 * a1
    scale = 0.5 / math.sqrt(product)
    t0, t3 = product * c + y1 * z1 + y2 * z2, product * e + y2 * z1 - y1 * z2
    t2, t1 = -(a0 * z1 - a1 * (y1 * c + y2 * e)), a0 * z2 - a1 * (y2 * c - y1 * e)
    return scale * t0, scale * t1, scale * t2, scale * t3, n1, n2, n3


@inlined
def _twisted(cosine, sine, re, im, extra_re, extra_im, across_re, across_im):
    """Return cosine and sine of an angle plus half the argument of the product of three complex numbers, the twist."""
    re, im = re * extra_re - im * extra_im, re * extra_im + im * extra_re
    re, im = re * across_re - im * across_im, re * across_im + im * across_re
    half_cosine, half_sine = _half_argument(re, im)
    return cosine * half_cosine - sine * half_sine, sine * half_cosine + cosine * half_sine


@inlined
def _half_argument(re, im):
    """Return cosine and sine of half the argument of a complex number, between -pi/2 and pi/2."""
    inverse = 1.0 / math.sqrt(re * re + im * im)
    larger = math.sqrt(0.5 + 0.5 * abs(re * inverse))
    smaller = 0.5 * abs(im * inverse) / larger
    sign = -1.0 if im < 0.0 else 1.0
    return (smaller, sign * larger) if re < 0.0 else (larger, sign * smaller)


@inlined
def _product_of_quaternions(q0, q1, q2, q3, t0, t1, t2, t3):
    return (
        q0 * t0 - q1 * t1 - q2 * t2 - q3 * t3,
        q0 * t1 + q1 * t0 + q2 * t3 - q3 * t2,
        q0 * t2 - q1 * t3 + q2 * t0 + q3 * t1,
        q0 * t3 + q1 * t2 - q2 * t1 + q3 * t0,
    )


@inlined
def _turned(q0, q1, q2, q3, t0, t1, t2, t3):
    """Return the product of two quaternions, of norm one."""
    p0, p1, p2, p3 = _product_of_quaternions(q0, q1, q2, q3, t0, t1, t2, t3)
    half_defect = 0.5 * (1.0 - (p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3))
    return p0 + p0 * half_defect, p1 + p1 * half_defect, p2 + p2 * half_defect, p3 + p3 * half_defect


@inlined
def _keeping_the_norm(d1, d2, d3, x1, x2, x3, square_G):
    """Return the change of x, corrected so that it keeps the norm."""
    n1, n2, n3 = x1 + d1, x2 + d2, x3 + d3
    correction = (d1 * (x1 + n1) + d2 * (x2 + n2) + d3 * (x3 + n3)) * (0.5 / square_G)
    return d1 - n1 * correction, d2 - n2 * correction, d3 - n3 * correction


@inlined
def _of_the_same_norm(n1, n2, n3, x1, x2, x3, G, square_G):
    """Return G n with the norm of x, without a bias."""
    n1, n2, n3 = G * n1, G * n2, G * n3
    defect = (x1 - n1) * (x1 + n1) + (x2 - n2) * (x2 + n2) + (x3 - n3) * (x3 + n3)
    correction = defect * (0.5 / square_G)
    return n1 + n1 * correction, n2 + n2 * correction, n3 + n3 * correction


@inlined
def _sine_short(s, x, z):
    """Return w = sn(v)/c at s = v/c."""
    half = 0.5 * s
    u = half * half
    P, q = (x + z) * u, (x * z) * (u * u)
    in_P = 1.0 + P * (-1 / 6 + P * (1 / 120 + P * (-1 / 5040 + P * (1 / 362880 - P / 39916800))))
    in_q = 1 / 10 + P * (-11 / 420 + P * (17 / 5040 - P * (461 / 1663200))) + q * (1 / 120 - P * (307 / 92400))
    w = half * (in_P + q * in_q)
    u = w * w
    xu, zu = x * u, z * u
    return 2.0 * w * math.sqrt((1.0 - xu) * (1.0 - zu)) / (1.0 - xu * zu)


@inlined
def _third_kind_short(w, x, z, b):
    """Integrate b s²/((1 + b s²) sqrt((1 - x s²)(1 - z s²))) from 0 to w."""
    u = w * w
    return w * (
        _W0 * _integrand(_N0 * u, x, z, b)
        + _W1 * _integrand(_N1 * u, x, z, b)
        + _W2 * _integrand(_N2 * u, x, z, b)
        + _W3 * _integrand(_N3 * u, x, z, b)
        + _W4 * _integrand(_N4 * u, x, z, b)
    )


@inlined
def _integrand(u, x, z, b):
    return b * u / ((1.0 + b * u) * math.sqrt((1.0 - x * u) * (1.0 - z * u)))


@inlined
def _cosine_and_sine(angle):
    """Return cosine and sine, by their Taylor series after a reduction by multiples of pi/2."""
    turns = (angle * (2.0 / math.pi) + _ROUNDING) - _ROUNDING
    r = ((angle - turns * _P1) - turns * _P2) - turns * _P3
    u = r * r
    sine = r + r * u * (
        -1 / 6
        + u
        * (
            1 / 120
            + u
            * (
                -1 / 5040
                + u
                * (
                    1 / 362880
                    + u * (-1 / 39916800 + u * (1 / 6227020800 + u * (-1 / 1307674368000 + u / 355687428096000)))
                )
            )
        )
    )
    cosine = (
        1.0
        - 0.5 * u
        + u
        * u
        * (
            1 / 24
            + u
            * (
                -1 / 720
                + u
                * (1 / 40320 + u * (-1 / 3628800 + u * (1 / 479001600 + u * (-1 / 87178291200 + u / 20922789888000))))
            )
        )
    )
    quadrant = turns - 4.0 * ((0.25 * turns + _ROUNDING) - _ROUNDING)  # -2, -1, 0, 1 or 2
    odd = abs(quadrant) == 1.0
    c, e = (sine, cosine) if odd else (cosine, sine)
    half_turn = abs(quadrant) == 2.0
    return (
        -c if half_turn | (quadrant == 1.0) else c,
        -e if half_turn | (quadrant == -1.0) else e,
    )


@inner
def _long(body, block, i, turn, means):
    """Advance body i of a block by a step of any length, from any momentum."""
    b, rho, sigma, inverse_I3, I1, I2, I3 = body
    t = block[7 * _BLOCK + i]
    m1, m2, m3 = block[4 * _BLOCK + i], block[5 * _BLOCK + i], block[6 * _BLOCK + i]
    largest = max(abs(m1), abs(m2), abs(m3))
    if not (largest < math.inf and abs(t) < math.inf):  # nan comes here too
        for row in range(8, 15):
            block[row * _BLOCK + i] = math.nan
        return
    exponent = math.frexp(largest)[1]
    m1, m2, m3 = math.ldexp(m1, -exponent), math.ldexp(m2, -exponent), math.ldexp(m3, -exponent)
    square_G = m1 * m1 + m2 * m2 + m3 * m3
    if square_G == 0.0:
        block[12 * _BLOCK + i] = block[13 * _BLOCK + i] = block[14 * _BLOCK + i] = 0.0
        return
    G = math.sqrt(square_G)
    hG = t * math.ldexp(G, exponent)
    y1, y2, y3 = m1 / G, m2 / G, m3 / G

    S = _separatrix_distance(I1, I2, I3, m1, m3) / (G * G)
    B = sigma * (y1 * y1 + sigma * y2 * y2)
    mirrored = S >= 0.0
    r, s = (rho, sigma) if mirrored else (sigma, rho)
    if mirrored:
        y1, y3 = y3, y1
    flip = math.copysign(1.0, y3)
    y1, y3 = flip * y1, flip * y3

    rA = r * (y3 * y3 + s * y2 * y2)
    c = math.sqrt(rA)
    kc2 = min(abs(S) / rA, 1.0) if rA > 0.0 else 1.0
    v = b * hG * c
    sn, cn, dn, half_turns = _jacobi(v, kc2, means)
    w = sn / c if c > 0.0 else b * hG
    half_angle = 0.5 * (hG * inverse_I3 + _third_kind(v, kc2, c, B, w, cn, dn, half_turns))
    if mirrored:
        half_angle, extra_re, extra_im = -half_angle, 1.0, 0.0
    else:
        extra_re, extra_im = cn * dn, w
    f1, f2, unit = _rescaled(y1, y2)
    t0, t1, t2, t3, n1, n2, n3 = _rotate(
        y1, y2, y3, f1, f2, unit, cn, dn, w, r, s, extra_re, extra_im, math.cos(half_angle), math.sin(half_angle)
    )
    t1, t3, n1, n3 = flip * t1, flip * t3, flip * n1, flip * n3
    if mirrored:
        t1, t2, t3, n1, n3 = -t3, -t2, -t1, n3, n1
    n1, n2, n3 = _of_the_same_norm(n1, n2, n3, m1, m2, m3, G, square_G)
    block[12 * _BLOCK + i] = math.ldexp(n1, exponent)
    block[13 * _BLOCK + i] = math.ldexp(n2, exponent)
    block[14 * _BLOCK + i] = math.ldexp(n3, exponent)
    q0, q1, q2, q3 = block[8 * _BLOCK + i], block[9 * _BLOCK + i], block[10 * _BLOCK + i], block[11 * _BLOCK + i]
    q0, q1, q2, q3 = _turned(q0, q1, q2, q3, t0, t1, t2, t3)
    block[8 * _BLOCK + i], block[9 * _BLOCK + i], block[10 * _BLOCK + i], block[11 * _BLOCK + i] = q0, q1, q2, q3


@inlined
def _rescaled(y1, y2):
    """Return (y1, y2)/unit, unit a power of two where fourth powers would vanish; (0, 1) and 0 where both are zero."""
    size = max(abs(y1), abs(y2))
    if size >= VANISHING:
        return y1, y2, 1.0
    if size == 0.0:
        return 0.0, 1.0, 0.0
    exponent = math.frexp(size)[1]
    return math.ldexp(y1, -exponent), math.ldexp(y2, -exponent), math.ldexp(1.0, exponent)


@inner
def _jacobi(v, kc2, means):
    """Return sn, cn, dn and the half turns of v, as `elliptic.jacobi` does."""
    if kc2 == 0.0:
        bounded = min(max(v, -SEPARATRIX_LIMIT), SEPARATRIX_LIMIT)
        sech = 1.0 / math.cosh(bounded)
        return math.tanh(bounded), sech, sech, 0.0
    a, g, last = 1.0, math.sqrt(kc2), -1
    converged = False
    while not converged:
        last += 1
        means[0, last], means[1, last] = a, g
        converged = abs(a - g) <= 1e-8 * a or last == _LANDEN - 1
        a, g = 0.5 * (a + g), math.sqrt(a * g)
    phase = v * a
    sine, cosine = math.sin(phase), math.cos(phase)
    if abs(sine) < TINY_PHASE:
        sn, cn, dn = v, math.copysign(1.0, cosine), 1.0
    else:
        t = cosine / sine
        c = a * t
        dn = 1.0
        for k in range(last, -1, -1):
            t = c * t
            c = dn * c
            dn = (means[1, k] + t) / (means[0, k] + t)
            t = c / means[0, k]
        sn = math.copysign(1.0 / math.hypot(1.0, c), sine)
        cn = c * sn
    odd = 1.0 if cn < 0.0 else 0.0
    return sn, cn, dn, odd + 2.0 * np.rint(0.5 * (phase / math.pi - odd))


@inner
def _third_kind(v, kc2, c, b, w, cn, dn, half_turns):
    """Integrate b w²/(1 + b w²) over v/c from 0 to v, as `elliptic.third_kind` does."""
    if kc2 == 0.0:
        if b == 0.0:
            return 0.0
        beta, root = b / (c * c), math.sqrt(b)
        return beta / (1.0 + beta) * (v / c - math.atan(root * w) / root)
    reduced = -w if cn < 0.0 else w
    integral = b / 3.0 * reduced**3 * _carlson_rj(cn * cn, dn * dn, 1.0, 1.0 + b * w * w)
    if half_turns != 0.0:
        beta = b / (c * c)
        integral += 2.0 / 3.0 * half_turns * beta / c * _carlson_rj(0.0, kc2, 1.0, 1.0 + beta)
    return integral


@inner
def _carlson_rj(x, y, z, p):
    """Return R_J(x, y, z, p) for 0 <= x, y, z <= p, at most one of x, y, z zero.

    Duplication, then the series of DLMF 19.36.1-2. B. C. Carlson, Numer. Algorithms 10, 13 (1995),
    doi:10.1007/BF02198293.
    """
    delta = (p - x) * (p - y) * (p - z)
    mean = 0.2 * (x + y + z + 2.0 * p)
    spread = 400.0 * max(abs(mean - x), abs(mean - y), abs(mean - z), abs(mean - p))
    dx, dy, dz = mean - x, mean - y, mean - z
    scale, total = 1.0, 0.0
    while scale * spread >= mean:
        rx, ry, rz, rp = math.sqrt(x), math.sqrt(y), math.sqrt(z), math.sqrt(p)
        d = (rp + rx) * (rp + ry) * (rp + rz)
        root = math.sqrt(scale**3 * delta) / d
        total += scale / d * (math.atan(root) / root if root > 1e-9 else 1.0)
        step = rx * (ry + rz) + ry * rz
        x, y, z, p = 0.25 * (x + step), 0.25 * (y + step), 0.25 * (z + step), 0.25 * (p + step)
        mean = 0.25 * (mean + step)
        scale *= 0.25
    factor = scale / mean
    X, Y, Z = dx * factor, dy * factor, dz * factor
    P = -0.5 * (X + Y + Z)
    E2 = X * Y + X * Z + Y * Z - 3.0 * P * P
    E3 = X * Y * Z + 2.0 * E2 * P + 4.0 * P * P * P
    E4 = (2.0 * X * Y * Z + E2 * P + 3.0 * P * P * P) * P
    E5 = X * Y * Z * P * P
    series = (
        1.0
        - 3 / 14 * E2
        + E3 / 6
        + 9 / 88 * E2 * E2
        - 3 / 22 * E4
        - 9 / 52 * E2 * E3
        + 3 / 26 * E5
        - E2 * E2 * E2 / 16
        + 3 / 40 * E3 * E3
        + 3 / 20 * E2 * E4
        + 45 / 272 * E2 * E2 * E3
        - 9 / 68 * (E3 * E4 + E2 * E5)
    )
    return scale * series / (mean * math.sqrt(mean)) + 6.0 * total


@inlined
def _separatrix_distance(I1, I2, I3, m1, m3):
    """Return S norm(m)² = rho m1² - sigma m3², its cancelling part in double-double."""
    d, d_error = _difference(I2, I1)
    f, f_error = _times(I3, d, d_error)
    a, a_error = _times_squared(f, f_error, m1)
    d, d_error = _difference(I3, I2)
    f, f_error = _times(I1, d, d_error)
    c, c_error = _times_squared(f, f_error, m3)
    leading, error = _difference(a, c)
    distance = leading + (error + (a_error - c_error))
    if abs(distance) <= ON_SEPARATRIX * (a + c):
        return 0.0
    return distance / (I2 * (I3 - I1)) if I3 > I1 else distance


@inlined
def _times_squared(factor, factor_error, x):
    square, square_error = _product(x, x)
    leading, error = _product(factor, square)
    return leading, error + (factor * square_error + factor_error * square)


@inlined
def _times(a, b, b_error):
    leading, error = _product(a, b)
    return _sum_ordered(leading, error + a * b_error)


@inlined
def _difference(a, b):
    d = a - b
    shadow = d - a
    return d, (a - (d - shadow)) - (b + shadow)


@inlined
def _sum_ordered(a, b):
    total = a + b
    return total, b - (total - a)


@inlined
def _product(a, b):
    p = a * b
    a_high, a_low = _halves(a)
    b_high, b_low = _halves(b)
    return p, ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low


@inlined
def _halves(a):
    t = 134217729.0 * a
    high = t - (t - a)
    return high, a - high


@compiled("f2 f3 f3 f1 F3 F3")
def advance(body, q, m, t, q1, m1):
    """Advance bodies by t into q1 and m1, in ascending principal axes.

    Parameters
    ----------
    body : (7, 1) or (7, N) array
        What `exact.constants` returns.
    q, m : (2, 4, N) and (2, 3, N) arrays, or (1, 4, N) and (1, 3, N)
        Sums, or plain numbers.
    t : (1,) or (N,) array
    q1, m1 : arrays of the same shapes
        For the results; they may be q and m.
    """
    block = np.zeros(_ROWS * _BLOCK)
    turn, means = np.empty(4), np.empty((2, _LANDEN))
    each, shared, every, summing = body.shape[1] > 1, 0, t.shape[0] > 1, q.shape[0] > 1
    n = m.shape[2]
    for start in range(0, n, _BLOCK):
        length = min(_BLOCK, n - start)
        for row in range(4):
            for i in range(length):
                block[row * _BLOCK + i] = body[row, start + i if each else shared]
        for row in range(3):
            for i in range(length):
                block[(4 + row) * _BLOCK + i] = m[0, row, start + i]
                block[(20 + row) * _BLOCK + i] = m[1, row, start + i] if summing else 0.0
        for i in range(length):
            block[7 * _BLOCK + i] = t[start + i if every else 0]
        for row in range(4):
            for i in range(length):
                block[(8 + row) * _BLOCK + i] = q[0, row, start + i]
                block[(16 + row) * _BLOCK + i] = q[1, row, start + i] if summing else 0.0
        for i in range(length, _BLOCK):  # the rest is not used, but has to be a number
            for row in range(12):
                block[row * _BLOCK + i] = 1.0
        _short_block(block)
        for i in range(length):
            if block[15 * _BLOCK + i] == 0.0:
                _long(body[:, start + i if each else 0], block, i, turn, means)
        for row in range(4):
            for i in range(length):
                q1[0, row, start + i] = block[(8 + row) * _BLOCK + i]
                if summing:
                    q1[1, row, start + i] = block[(16 + row) * _BLOCK + i]
        for row in range(3):
            for i in range(length):
                m1[0, row, start + i] = block[(12 + row) * _BLOCK + i]
                if summing:
                    m1[1, row, start + i] = block[(20 + row) * _BLOCK + i]
