"""Forces of bonds, angles, torsions, maps of two torsions and pairs of atoms, compiled.

Angles follow from atan2, which keeps its digits everywhere. The gradient of a torsion is that of A. Blondel and
M. Karplus, J. Comput. Chem. 17, 1132 (1996), doi:10.1002/(SICI)1096-987X(19960715)17:9<1132::AID-JCC5>3.0.CO;2-T.
"""

from __future__ import annotations

import math

from openmm_exactrb.kernels.build import compiled, inner, inner_reordered

_CIRCLE = 2.0 * math.pi


@inner
def _difference(x, i, j):
    return x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]


@inner_reordered
def _dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@inner_reordered
def _cross(u, v):
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@inner
def _add(out, i, f, u):
    for e in range(3):
        out[i, e] += f * u[e]


@inner
def _act(out, i, j, f, u):
    """Add a force f u on i, and its reaction on j."""
    _add(out, i, f, u)
    _add(out, j, -f, u)


@inner
def _torsion(x, four):
    """Return (cos phi, sin phi) of a torsion, and what `_twist` takes."""
    i, j, k, m = four
    first, axis, last = _difference(x, i, j), _difference(x, j, k), _difference(x, m, k)
    a, b, g = _cross(first, axis), _cross(last, axis), math.sqrt(_dot(axis, axis))
    aa, bb = _dot(a, a), _dot(b, b)
    scale = 1.0 / math.sqrt(aa * bb)
    turn = (scale * _dot(a, b), scale / g * _dot(_cross(b, a), axis))
    along = _dot(first, axis) / (aa * g), _dot(last, axis) / (bb * g)
    return turn, (a, b, g / aa, g / bb, along)


@inner
def _twist(out, four, f, arms):
    """Add the forces of a torsion with -dV/dphi = f."""
    (i, j, k, m), (a, b, of_a, of_b, along) = four, arms
    _act(out, i, j, -f * of_a, a)
    _act(out, m, k, f * of_b, b)
    _act(out, j, k, f * along[0], a)
    _act(out, j, k, -f * along[1], b)


@inner
def _of_torsion(turn, coefficients):
    """Return -dV/dphi of V = sum_n (a_n cos(n phi) + b_n sin(n phi)) at the unit vector (cos phi, sin phi)."""
    (c, s), (a, b), force = turn, coefficients, 0.0
    cn, sn = c, s
    for n in range(len(a)):
        force += (n + 1) * (a[n] * sn - b[n] * cn)
        cn, sn = cn * c - sn * s, sn * c + cn * s
    return force


@inner
def _patch(turn, size):
    """Return which of so many parts of the circle an angle is in, and how far; the first part if it is nan."""
    angle = math.atan2(turn[1], turn[0]) % _CIRCLE
    part = max(0, min(int(angle / _CIRCLE * size), size - 1))
    return part, angle - part * (_CIRCLE / size)


@inner
def _of_map(patch, u, v):
    """Return -dV/du and -dV/dv of V = sum_kl c_kl u^(3-k) v^(3-l)."""
    energy, of_u, of_v = 0.0, 0.0, 0.0
    for k in range(4):
        row, slope = 0.0, 0.0
        for l in range(4):
            slope = slope * v + row
            row = row * v + patch[k, l]
        of_u = of_u * u + energy
        energy = energy * u + row
        of_v = of_v * u + slope
    return -of_u, -of_v


@compiled("f2 i2 f2 i2 f2 i2 f3 i2 f2 i2 f2 i2 f3 F2")
def forces(
    x,
    bonds,
    of_bonds,
    angles,
    of_angles,
    torsions,
    of_torsions,
    pairs,
    of_pairs,
    impropers,
    of_impropers,
    maps,
    patches,
    out,
):
    """Write the forces (n, 3) in kJ/mol/nm on particles at x (n, 3) in nm.

    `of_bonds` (., 2) are lengths and strengths, `of_angles` (., 2) angles and strengths, `of_torsions` (., 2, N) the
    coefficients of cosines and sines, `of_pairs` (., 3) products of charges in kJ nm/mol, sigmas and epsilons,
    `of_impropers` (., 3) angles, strengths k of k (phi - phi0)², and the circle, as OpenMM's formulas have it. `maps`
    (., 10) are the particles of two torsions, the first patch of a map and how many it has in each direction; `patches`
    (., 4, 4) the coefficients of bicubic polynomials, highest powers first.
    """
    out[:] = 0.0
    for n in range(len(bonds)):
        i, j = bonds[n]
        u = _difference(x, i, j)
        r = math.sqrt(_dot(u, u))
        if r != 0.0:  # a bond of no length has no direction: OpenMM has no force there either
            _act(out, i, j, of_bonds[n, 1] * (of_bonds[n, 0] - r) / r, u)
    for n in range(len(pairs)):
        i, j = pairs[n]
        u = _difference(x, i, j)
        square = _dot(u, u)
        s = (of_pairs[n, 1] * of_pairs[n, 1] / square) ** 3
        _act(out, i, j, (of_pairs[n, 0] / math.sqrt(square) + of_pairs[n, 2] * (48.0 * s - 24.0) * s) / square, u)
    for n in range(len(angles)):
        i, j, k = angles[n]
        u, v = _difference(x, i, j), _difference(x, k, j)
        normal = _cross(u, v)
        sine = max(math.sqrt(_dot(normal, normal)), 1e-12)
        f = of_angles[n, 1] * (of_angles[n, 0] - math.atan2(sine, _dot(u, v))) / sine
        _act(out, i, j, f / _dot(u, u), _cross(u, normal))
        _act(out, k, j, f / _dot(v, v), _cross(normal, v))
    for n in range(len(torsions)):
        turn, arms = _torsion(x, torsions[n])
        _twist(out, torsions[n], _of_torsion(turn, (of_torsions[n, 0], of_torsions[n, 1])), arms)
    for n in range(len(impropers)):
        turn, arms = _torsion(x, impropers[n])
        away = math.atan2(turn[1], turn[0]) - of_impropers[n, 0]
        away -= of_impropers[n, 2] * round(away / of_impropers[n, 2])
        _twist(out, impropers[n], -2.0 * of_impropers[n, 1] * away, arms)
    for n in range(len(maps)):
        one, two, first, size = maps[n, :4], maps[n, 4:8], maps[n, 8], maps[n, 9]
        (turn, arms), (other, others) = _torsion(x, one), _torsion(x, two)
        (s, u), (t, v) = _patch(turn, size), _patch(other, size)
        f, g = _of_map(patches[first + s * size + t], u, v)
        _twist(out, one, f, arms)
        _twist(out, two, g, others)
