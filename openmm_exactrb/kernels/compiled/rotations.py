"""The rotation of one body in a step, from its unit angular momentum, by the formulas of `plain.exact`, compiled."""

import math

from openmm_exactrb.kernels.build import inlined
from openmm_exactrb.kernels.compiled.formulas import product
from openmm_exactrb.mathematics.quaternions import TO_GRID

# pi/2 in three parts, the first two of 33 bits.
_P1, _P2, _P3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
# Adding and then subtracting this number rounds to an integer.
_ROUNDING = 6755399441055744.0


@inlined
def cosine_and_sine(angle):
    """Return the cosine and sine of an angle, by Taylor series after a reduction by multiples of pi/2."""
    turns = (angle * (2.0 / math.pi) + _ROUNDING) - _ROUNDING
    r = ((angle - turns * _P1) - turns * _P2) - turns * _P3
    u = r * r
    sine = 1 / 6227020800 + u * (-1 / 1307674368000 + u / 355687428096000)
    sine = -1 / 5040 + u * (1 / 362880 + u * (-1 / 39916800 + u * sine))
    sine = r + r * u * (-1 / 6 + u * (1 / 120 + u * sine))
    cosine = 1 / 479001600 + u * (-1 / 87178291200 + u / 20922789888000)
    cosine = -1 / 720 + u * (1 / 40320 + u * (-1 / 3628800 + u * cosine))
    cosine = 1.0 - 0.5 * u + u * u * (1 / 24 + u * cosine)
    quadrant = turns - 4.0 * ((0.25 * turns + _ROUNDING) - _ROUNDING)  # -2, -1, 0, 1 or 2
    odd = abs(quadrant) == 1.0
    c, e = (sine, cosine) if odd else (cosine, sine)
    half_turn = abs(quadrant) == 2.0
    return -c if half_turn | (quadrant == 1.0) else c, -e if half_turn | (quadrant == -1.0) else e


@inlined
def norm_defect(q0, q1, q2, q3):
    """Return 1 - q.q of a unit quaternion, as `quaternions.norm_defect` does."""
    h0, h1 = (q0 + TO_GRID) - TO_GRID, (q1 + TO_GRID) - TO_GRID
    h2, h3 = (q2 + TO_GRID) - TO_GRID, (q3 + TO_GRID) - TO_GRID
    rest = (q0 - h0) * (q0 + h0) + (q1 - h1) * (q1 + h1) + (q2 - h2) * (q2 + h2) + (q3 - h3) * (q3 + h3)
    return (1.0 - (h0 * h0 + h1 * h1 + h2 * h2 + h3 * h3)) - rest


@inlined
def rotate_short(y1, y2, y3, cn, dn, w, cn_less, dn_less, r, s, cosine, sine):
    """Return the rotation of `rotate` minus the identity, and the change of y.

    `cn_less` is 1 - cn, and `dn_less` is 1 - dn.
    """
    wy3, cd = w * y3, cn * dn
    rw2 = r * wy3 * wy3
    inverse = 1.0 / (cn * cn + rw2)
    d1 = (y1 * (cn * cn_less - rw2) - r * wy3 * dn * y2) * inverse
    d2 = (y2 * (cn * (cn_less - dn_less) - rw2) + wy3 * y1) * inverse
    d3 = (y3 * (cn_less * (1.0 + cn) - dn_less - rw2) - s * w * cn * y1 * y2) * inverse
    n1, n2, n3 = y1 + d1, y2 + d2, y3 + d3

    re, im = y2 * y2 + y1 * (cn * n1 + wy3 * n2), -s * w * y2 * n2
    c, e = twisted(cosine, sine, re, im, cd, w, y1 * n1 + y2 * n2, y2 * d1 - y1 * d2)
    less = versine(c, e)

    # z is the change of (y1 + i y2) in the rotation.
    z1, z2 = d1 * c - d2 * e - (y1 * less + y2 * e), d1 * e + d2 * c - (y2 * less - y1 * e)
    a0, a1 = 1.0 + y3, 1.0 + n3
    product = a0 * a1
    scale = 0.5 / math.sqrt(product)
    t2 = -scale * (a0 * (z1 + y1 * less - y2 * e) - d3 * (y1 * c + y2 * e))
    t1 = scale * (a0 * (z2 + y2 * less + y1 * e) - d3 * (y2 * c - y1 * e))
    t3 = scale * (product * e + y2 * z1 - y1 * z2)
    along = scale * (product * c + y1 * (y1 + z1) + y2 * (y2 + z2))
    return -versine(along, math.sqrt(t1 * t1 + t2 * t2 + t3 * t3)), t1, t2, t3, d1, d2, d3


@inlined
def versine(cosine, sine):
    """Return 1 - cosine, without cancellation."""
    return sine * sine / (1.0 + cosine) if cosine > 0.0 else 1.0 - cosine


@inlined
def rotate(y1, y2, y3, f1, f2, unit, cn, dn, w, r, s, extra_re, extra_im, cosine, sine):
    """Apply the addition theorem to `y = (f1*unit, f2*unit, y3)` and assemble the rotation of the step.

    `cosine` and `sine` belong to half the angle, to which half the argument of the twist is added.
    """
    wy3, cd = w * y3, cn * dn
    inverse = 1.0 / (cn * cn + r * wy3 * wy3)
    g1 = (f1 * cn - r * wy3 * dn * f2) * inverse
    g2 = (f2 * cd + wy3 * f1) * inverse
    re, im = f2 * f2 + f1 * (cn * g1 + wy3 * g2), -s * w * f2 * g2
    c, e = twisted(cosine, sine, re, im, extra_re, extra_im, f1 * g1 + f2 * g2, f2 * g1 - f1 * g2)

    n1, n2, n3 = g1 * unit, g2 * unit, (y3 * dn - s * w * cn * y1 * y2) * inverse
    a0, a1 = 1.0 + y3, 1.0 + n3
    z1, z2 = n1 * c - n2 * e, n1 * e + n2 * c
    product = a0 * a1
    scale = 0.5 / math.sqrt(product)
    t0, t3 = product * c + y1 * z1 + y2 * z2, product * e + y2 * z1 - y1 * z2
    t2, t1 = -(a0 * z1 - a1 * (y1 * c + y2 * e)), a0 * z2 - a1 * (y2 * c - y1 * e)
    return scale * t0, scale * t1, scale * t2, scale * t3, n1, n2, n3


@inlined
def twisted(cosine, sine, re, im, extra_re, extra_im, across_re, across_im):
    """Return cosine and sine of an angle plus half the argument of the twist, the product of three complex numbers."""
    re, im = re * extra_re - im * extra_im, re * extra_im + im * extra_re
    re, im = re * across_re - im * across_im, re * across_im + im * across_re
    half_cosine, half_sine = half_argument(re, im)
    return cosine * half_cosine - sine * half_sine, sine * half_cosine + cosine * half_sine


@inlined
def half_argument(re, im):
    """Return the cosine and sine of half the argument of a complex number; the half is between -pi/2 and pi/2."""
    inverse = 1.0 / math.sqrt(re * re + im * im)
    larger = math.sqrt(0.5 + 0.5 * abs(re * inverse))
    smaller = 0.5 * abs(im * inverse) / larger
    sign = -1.0 if im < 0.0 else 1.0
    return (smaller, sign * larger) if re < 0.0 else (larger, sign * smaller)


@inlined
def turned(q0, q1, q2, q3, t0, t1, t2, t3):
    """Return the product of two unit quaternions, normalised."""
    p0, p1, p2, p3 = product(q0, q1, q2, q3, t0, t1, t2, t3)
    half_defect = 0.5 * (1.0 - (p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3))
    return p0 + p0 * half_defect, p1 + p1 * half_defect, p2 + p2 * half_defect, p3 + p3 * half_defect


@inlined
def norm_conserving(d1, d2, d3, x1, x2, x3, square_G):
    """Return the change of x, corrected to conserve the norm of x."""
    n1, n2, n3 = x1 + d1, x2 + d2, x3 + d3
    correction = (d1 * (x1 + n1) + d2 * (x2 + n2) + d3 * (x3 + n3)) * (0.5 / square_G)
    return d1 - n1 * correction, d2 - n2 * correction, d3 - n3 * correction


@inlined
def keep_norm(n1, n2, n3, x1, x2, x3, G, square_G):
    """Return G n, corrected without bias to have the norm of x."""
    n1, n2, n3 = G * n1, G * n2, G * n3
    defect = (x1 - n1) * (x1 + n1) + (x2 - n2) * (x2 + n2) + (x3 - n3) * (x3 + n3)
    correction = defect * (0.5 / square_G)
    return n1 + n1 * correction, n2 + n2 * correction, n3 + n3 * correction
