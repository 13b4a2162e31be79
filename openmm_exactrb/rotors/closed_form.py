"""The exact flow of the free rigid body in numpy, for any number of bodies at once.

Euler's equations are solved without a phase and without an inverse function, because the addition theorem of Jacobi's
functions advances the momentum itself from 0 to h. The orientation follows from one incremental integral of the third
kind and the argument of a complex number.

With moments of inertia I1 <= I2 <= I3, x = m/G, G = norm(m), time s = b G t and

    b = (I3 - I1)/(I1 I3),  rho = I3 (I2 - I1)/(I2 (I3 - I1)),  sigma = 1 - rho = I1 (I3 - I2)/(I2 (I3 - I1)),

Euler's equations read x1' = -sigma x2 x3, x2' = x3 x1, x3' = -rho x1 x2. They are invariant under the exchange of axes
1 and 3 together with rho and sigma, so that one formula applies to both families of orbits. The formula is written in y
= (x_l, x2, x_j), where j is the axis that the momentum circles: 3 if S = rho x1² - sigma x3² < 0, and 1 otherwise (S =
0 is the separatrix). Then (r, s) is (sigma, rho) for j = 3, and (rho, sigma) for j = 1. A rotation by pi about axis 2
ensures that y3 >= 0.

An exchange of two axes is a reflection of the body, so that angles change sign if j = 1.

For a short step, the changes of orientation and momentum are computed, with errors proportional to these changes.
Orientations and momenta may be double-doubles (`openmm_exactrb.mathematics.compensated`), to which the changes are
added. A run of short steps then has no roundoff other than these errors. Longer steps round to float64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.mathematics.compensated import add, exactly, keep_norm, times, times_squared, two_difference
from openmm_exactrb.mathematics.elliptic import jacobi, sine_short, third_kind, third_kind_short
from openmm_exactrb.mathematics.quaternions import Real, multiply, norm_defect, renormalise
from openmm_exactrb.rotors.constants import SHORT
from openmm_exactrb.support.types import Array

#: The range of momenta whose squares neither overflow nor underflow.
SAFE = (1e-70, 1e70)
#: The largest angle h G/I3 of a step of the library, for which the reduction of angles is exact to roundoff.
LARGEST_ANGLE = 1e4
#: The size of components of a unit vector below which their eighth powers may underflow.
VANISHING = 1e-36
#: The error of S in double-doubles, relative to its terms. If S is smaller, the momentum is treated as on the
#: separatrix.
ON_SEPARATRIX = 1e-30


def advance(body: Array, q: Array, m: Array, t: Array, q1: Array, m1: Array) -> None:
    """Write the orientations q1 and momenta m1 of bodies after t (1,) or (N,), in axes of ascending principal moments.

    `body` (7, 1) or (7, N) is a result of `openmm_exactrb.rotors.exact.constants`; q and m are double-doubles (2, 4, N)
    and (2, 3, N), or plain numbers (1, 4, N) and (1, 3, N).
    """
    t = np.broadcast_to(t, m.shape[2:])
    G = np.sqrt(np.einsum("in,in->n", m[0], m[0]))
    across = np.maximum(np.abs(m[0, 0]), np.abs(m[0, 1]))
    short = (np.abs(body[0] * t) * G <= SHORT) & (SAFE[0] < G) & (SAFE[1] > G) & (across > VANISHING * G)
    if short.all():
        q1[...], m1[...] = _step_short(body, q, m, G, t)
        return
    for chosen, step in ((short, _step_short), (~short, _step_long)):
        if chosen.any():
            part = body if body.shape[1] == 1 else body[:, chosen]
            q1[:, :, chosen], m1[:, :, chosen] = step(part, q[:, :, chosen], m[:, :, chosen], G[chosen], t[chosen])


def _step_short(body: Array, q: Array, m: Array, G: Array, t: Array) -> tuple[Array, Array]:
    turn, change = _short(body, m[0], G, t)
    rotation = multiply(q[0], turn)
    turned, defect = q[0] + rotation, 0.5 * norm_defect(q[0])
    if len(q) == 2:
        defect -= np.einsum("in,in->n", turned, q[1])
    # The result is normalised, and not q itself, which points elsewhere after a rotation by a large angle.
    return add(q, rotation + turned * defect), add(m, change)


def _step_long(body: Array, q: Array, m: Array, G: Array, t: Array) -> tuple[Array, Array]:
    turn, m1 = _long(body, m[0], G, t)
    q1 = renormalise(multiply(q[0], turn))
    return (q1[None], m1[None]) if len(q) == 1 else (exactly(q1), exactly(m1))


def _short(body: Array, m: Array, G: Array, t: Array) -> tuple[Array, Array]:
    """Return the rotation minus the identity, and the change of the momentum, for b G h <= 0.3.

    Series replace elliptic functions, and the formula for j = 3 applies to both families of orbits.
    """
    b, rho, sigma, inverse_I3 = body[:4]
    flip = np.copysign(1.0, m[2])
    y = m / G
    y[0] *= flip
    y[2] *= flip
    hG = t * G

    square = y * y
    x = sigma * (square[2] + rho * square[1])
    B = sigma * (square[0] + sigma * square[1])
    z = rho * (square[0] + sigma * square[1])
    w = sine_short(b * hG, x, z)
    u = w * w
    cn, dn = np.sqrt(1.0 - x * u), np.sqrt(1.0 - z * u)
    angle = hG * inverse_I3 + third_kind_short(w, x, z, B)
    turn, change = _rotate_short(y, cn, dn, w, x * u / (1.0 + cn), z * u / (1.0 + dn), sigma, rho, angle)
    turn[1::2] *= flip
    change[::2] *= flip
    return turn, _norm_conserving(G * change, m, G)


def _long(body: Array, m: Array, _: Array, t: Array) -> tuple[Array, Array]:
    """Return the rotation and the new momentum of a step of any length, from any momentum."""
    b, rho, sigma, inverse_I3 = body[:4]
    exponent = np.frexp(np.abs(m).max(axis=0))[1]
    m = np.ldexp(m, -exponent)
    G = np.sqrt(np.einsum("in,in->n", m, m))
    resting = G == 0.0
    hG = t * np.ldexp(G, exponent)
    G = np.where(resting, 1.0, G)
    y = m / G
    y[2] += resting

    I1, I2, I3 = body[4:]
    distance, terms = separatrix_difference(I1, I2, I3, m[0], m[2])
    distance = np.where(np.abs(distance) <= ON_SEPARATRIX * terms, 0.0, distance)
    S = distance / np.where(I3 > I1, I2 * (I3 - I1), 1.0) / (G * G)
    mirrored = S >= 0.0
    B = sigma * (y[0] * y[0] + sigma * y[1] * y[1])
    r, s = np.where(mirrored, (rho, sigma), (sigma, rho)) * np.ones_like(G)
    y[::2] = np.where(mirrored, y[::-2], y[::2])
    flip = np.copysign(1.0, y[2])
    y[::2] *= flip

    rA = r * (y[2] * y[2] + s * y[1] * y[1])
    kc2 = np.minimum(np.abs(S) / np.where(rA > 0.0, rA, 1.0), 1.0)
    kc2 = np.where(rA > 0.0, kc2, 1.0)
    c = np.sqrt(rA)
    v = b * hG * c
    sn, cn, dn, half_turns = jacobi(v, kc2)
    w = np.where(c > 0.0, sn / np.where(c > 0.0, c, 1.0), b * hG)
    angle = hG * inverse_I3 + third_kind(v, kc2, c, B, w, cn, dn, half_turns)
    extra = np.where(mirrored, 1.0, _complex(cn * dn, w))
    turn, y1 = _rotate(y, cn, dn, w, r, s, np.where(mirrored, -angle, angle), extra)
    turn[1::2] *= flip
    y1[::2] *= flip
    turn[1:] *= np.where(mirrored, -1.0, 1.0)
    turn[1::2] = np.where(mirrored, turn[:0:-2], turn[1::2])
    y1[::2] = np.where(mirrored, y1[::-2], y1[::2])
    m1 = np.where(resting, 0.0, keep_norm(G * y1, m, G * G))
    return turn, np.ldexp(m1, exponent)


def _rotate_short(
    y: Array, cn: Array, dn: Array, w: Array, cn_less: Array, dn_less: Array, r: Array, s: Array, angle: Array
) -> tuple[Array, Array]:
    """Return the rotation of `_rotate` minus the identity, and the change of y.

    `cn_less` is 1 - cn, and `dn_less` is 1 - dn.
    """
    y1, y2, y3 = y
    wy3, cd = w * y3, cn * dn
    rw2 = r * wy3 * wy3
    inverse = 1.0 / (cn * cn + rw2)
    change = np.empty_like(y)
    change[0] = (y1 * (cn * cn_less - rw2) - r * wy3 * dn * y2) * inverse
    change[1] = (y2 * (cn * (cn_less - dn_less) - rw2) + wy3 * y1) * inverse
    change[2] = (y3 * (cn_less * (1.0 + cn) - dn_less - rw2) - s * w * cn * y1 * y2) * inverse
    n1, n2, n3 = y + change

    twist = _complex(y2 * y2 + y1 * (cn * n1 + wy3 * n2), -s * w * y2 * n2) * _complex(cd, w)
    twist *= _complex(y1 * n1 + y2 * n2, y1 * -change[1] + y2 * change[0])
    psi = 0.5 * (angle + np.arctan2(twist.imag, twist.real))
    cosine, sine = np.cos(psi), np.sin(psi)
    turned, less = _complex(cosine, sine), _complex(_versine(cosine, sine), -sine)

    xi0 = _complex(y1, y2)
    xi_change = _complex(change[0], change[1]) * turned - xi0 * less
    a0, a1 = 1.0 + y3, 1.0 + n3
    product = a0 * a1
    scale = 0.5 / np.sqrt(product)
    across = a0 * (xi_change + xi0 * less.conj()) - change[2] * (xi0 * turned.conj())
    turn = np.empty((4, len(w)))
    turn[1], turn[2], turn[3] = across.imag, -across.real, product * sine - (xi0.conj() * xi_change).imag
    turn[1:] *= scale
    along = scale * (product * cosine + (xi0 * (xi0 + xi_change).conj()).real)
    turn[0] = -_versine(along, np.sqrt(np.einsum("in,in->n", turn[1:], turn[1:])))
    return turn, change


def _versine(cosine: Array, sine: Array) -> Array:
    """Return 1 - cosine, without cancellation."""
    return np.where(cosine > 0.0, sine * sine / (1.0 + cosine), 1.0 - cosine)


def _rotate(
    y: Array, cn: Array, dn: Array, w: Array, r: Array, s: Array, angle: Array, extra: NDArray[np.complex128]
) -> tuple[Array, Array]:
    """Apply the addition theorem to y, and return the rotation of the step and the new y.

    With xi = y1 + i y2 and a = 1 + y3, p = (a, y2, -y1, 0)/sqrt(2a) is the smallest rotation from y to e3, and
    the step is conj(p(0)) (cos psi, 0, 0, sin psi) p(h).
    """
    y1, y2, y3 = y
    wy3, cd = w * y3, cn * dn
    inverse = 1.0 / (cn * cn + r * wy3 * wy3)
    f1, f2, unit = _rescaled(y1, y2)
    g1 = (f1 * cn - r * wy3 * dn * f2) * inverse
    g2 = (f2 * cd + wy3 * f1) * inverse
    twist = _complex(f2 * f2 + f1 * (cn * g1 + wy3 * g2), -s * w * f2 * g2) * extra
    twist *= _complex(f1, f2) * _complex(g1, -g2)
    psi = 0.5 * (angle + np.arctan2(twist.imag, twist.real))
    turned = _complex(np.cos(psi), np.sin(psi))

    new = np.empty_like(y)
    new[0], new[1], new[2] = g1 * unit, g2 * unit, (y3 * dn - s * w * cn * y1 * y2) * inverse
    xi0, xi1 = _complex(y1, y2), _complex(new[0], new[1])
    xi1 *= turned
    a0, a1 = 1.0 + y3, 1.0 + new[2]
    product = a0 * a1
    scale = 0.5 / np.sqrt(product)
    along = product * turned + xi0 * xi1.conj()
    across = a0 * xi1 - a1 * (xi0 * turned.conj())
    turn = np.empty((4, len(w)))
    turn[0], turn[1], turn[2], turn[3] = along.real, across.imag, -across.real, along.imag
    turn *= scale
    return turn, new


def _rescaled(y1: Array, y2: Array) -> tuple[Array, Array, Array | float]:
    """Return (y1, y2)/unit and unit: 1, or a power of two if eighth powers would underflow; (0, 1) and 0 for zeros."""
    size = np.maximum(np.abs(y1), np.abs(y2))
    vanishing = size < VANISHING
    if not vanishing.any():
        return y1, y2, 1.0
    zero = size == 0.0
    exponent = np.where(vanishing, np.frexp(size)[1], 0)
    unit = np.where(zero, 0.0, np.ldexp(1.0, exponent))
    return np.ldexp(y1, -exponent), np.where(zero, 1.0, np.ldexp(y2, -exponent)), unit


def _complex(real: Array, imag: Array) -> NDArray[np.complex128]:
    out = np.empty(real.shape, dtype=np.complex128)
    out.real = real
    out.imag = imag
    return out


def _norm_conserving(change: Array, m: Array, G: Array) -> Array:
    """Return the change of m, corrected to conserve the norm of m."""
    m1 = m + change
    change -= m1 * (np.einsum("in,in->n", change, m + m1) * (0.5 / (G * G)))
    return change


def separatrix_difference(I1: Real, I2: Real, I3: Real, m1: Real, m3: Real) -> tuple[Real, Real]:
    """Return d = I3 (I2 - I1) m1² - I1 (I3 - I2) m3², which vanishes on the separatrix, and the sum of both terms.

    The difference is computed in double-double, because near the separatrix a double would lose all of its digits.
    """
    first = times_squared(times(I3, two_difference(I2, I1)), m1)
    third = times_squared(times(I1, two_difference(I3, I2)), m3)
    leading, error = two_difference(first[0], third[0])
    return leading + (error + (first[1] - third[1])), first[0] + third[0]
