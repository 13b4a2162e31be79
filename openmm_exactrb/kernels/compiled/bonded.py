"""Forces of bonds, angles, torsions, maps of two torsions and pairs of atoms, compiled.

Each term depends on one coordinate: a distance, an angle or a torsion. Terms are computed by vectorised loops over
blocks, with one term per lane. Positions are gathered and replaced by the forces for -dV/d(coordinate) = 1, which are
then scaled and added to the forces on the particles.

The gradient of a torsion follows A. Blondel and M. Karplus, J. Comput. Chem. 17, 1132 (1996),
doi:10.1002/(SICI)1096-987X(19960715)17:9<1132::AID-JCC5>3.0.CO;2-T.
"""

import math

import numpy as np

from openmm_exactrb.kernels.build import compiled, inlined, inner, inner_reordered
from openmm_exactrb.kernels.compiled.vectors import cross, difference, dot, scaled, total
from openmm_exactrb.kernels.records import Terms

_CIRCLE = 2.0 * math.pi
#: Terms per block, and rows of `lanes` (17, 64): three rows for each of up to four particles, the factor of their
#: forces, and the cosines and sines of an angle and of its multiples, from which the factor follows.
_BLOCK, _ROWS = 64, 17
_FACTOR, _COS, _SIN, _COS_N, _SIN_N = 12, 13, 14, 15, 16


@inlined
def _between(lanes, l, i, j):
    """Return the vector from the j-th particle of a term to the i-th particle."""
    i, j = 3 * i, 3 * j
    return lanes[i, l] - lanes[j, l], lanes[i + 1, l] - lanes[j + 1, l], lanes[i + 2, l] - lanes[j + 2, l]


@inlined
def _put(lanes, l, i, u):
    """Replace the position of the i-th particle of a term by the force on this particle."""
    lanes[3 * i, l], lanes[3 * i + 1, l], lanes[3 * i + 2, l] = u


@inlined
def _gather(x, members, begin, column, n, lanes):
    """Copy the positions of the n particles of each term of a block into lanes, and return the number of terms.

    The indices of these particles are in `members`: the block starts at row `begin`, and each term at `column`.
    """
    count = min(_BLOCK, len(members) - begin)
    for l in range(count):
        for i in range(n):
            particle = np.uint64(members[begin + l, column + i])  # unsigned, so that no index counts from the end
            for e in range(3):
                lanes[3 * i + e, l] = x[particle, e]
    return count


@inlined
def _scatter(lanes, members, begin, count, column, n, out):
    """Add the forces in lanes, times their factors, to the forces `out` on particles."""
    for l in range(count):
        f = lanes[_FACTOR, l]
        for i in range(n):
            particle = np.uint64(members[begin + l, column + i])
            for e in range(3):
                out[particle, e] += f * lanes[3 * i + e, l]


@inlined
def _angles(x, angles, begin, lanes):
    """Compute the cosines and sines of a block of angles, times the lengths of both sides, and the unscaled forces."""
    count = _gather(x, angles, begin, 0, 3, lanes)
    for l in range(count):
        u, v = _between(lanes, l, 0, 1), _between(lanes, l, 2, 1)
        normal = cross(u, v)
        sine = max(math.sqrt(dot(normal, normal)), 1e-12)
        lanes[_COS, l], lanes[_SIN, l] = dot(u, v), sine
        of_u = scaled(1.0 / (sine * dot(u, u)), cross(u, normal))
        of_v = scaled(1.0 / (sine * dot(v, v)), cross(normal, v))
        _put(lanes, l, 0, of_u)
        _put(lanes, l, 1, scaled(-1.0, total(of_u, of_v)))
        _put(lanes, l, 2, of_v)
    return count


@inlined
def _torsions(x, torsions, begin, column, lanes):
    """Compute the cosines and sines of a block of torsions, and the unscaled forces."""
    count = _gather(x, torsions, begin, column, 4, lanes)
    for l in range(count):
        first, axis, last = _between(lanes, l, 0, 1), _between(lanes, l, 1, 2), _between(lanes, l, 3, 2)
        a, b, g = cross(first, axis), cross(last, axis), math.sqrt(dot(axis, axis))
        aa, bb = dot(a, a), dot(b, b)
        scale = 1.0 / math.sqrt(aa * bb)
        lanes[_COS, l], lanes[_SIN, l] = scale * dot(a, b), scale / g * dot(cross(b, a), axis)
        of_first, of_last = scaled(-g / aa, a), scaled(g / bb, b)
        of_axis = total(scaled(dot(first, axis) / (aa * g), a), scaled(-dot(last, axis) / (bb * g), b))
        _put(lanes, l, 0, of_first)
        _put(lanes, l, 1, total(of_axis, scaled(-1.0, of_first)))
        _put(lanes, l, 2, scaled(-1.0, total(of_axis, of_last)))
        _put(lanes, l, 3, of_last)
    return count


@inlined
def _series(lanes, begin, count, coefficients):
    """Compute the factors -dV/dphi of V = sum_n (a_n cos(n phi) + b_n sin(n phi))."""
    for l in range(count):
        lanes[_FACTOR, l], lanes[_COS_N, l], lanes[_SIN_N, l] = 0.0, lanes[_COS, l], lanes[_SIN, l]
    for n in range(coefficients.shape[1]):
        for l in range(count):
            c, s, cn, sn = lanes[_COS, l], lanes[_SIN, l], lanes[_COS_N, l], lanes[_SIN_N, l]
            a, b = coefficients[0, n, begin + l], coefficients[1, n, begin + l]
            lanes[_FACTOR, l] += (n + 1) * (a * sn - b * cn)
            lanes[_COS_N, l], lanes[_SIN_N, l] = cn * c - sn * s, sn * c + cn * s


@inlined
def _turn(c, s):
    """Return atan2(s, c) from a short series of atan, since the tangent of a sixteenth of the angle is below 0.2."""
    t = s / max(math.sqrt(c * c + s * s) + c, 1e-300)
    for _ in range(3):
        t = t / (1.0 + math.sqrt(1.0 + t * t))
    tt, series = t * t, 0.0
    for k in range(10, -1, -1):
        series = (1.0 if k % 2 == 0 else -1.0) / (2 * k + 1) + tt * series
    return 16.0 * t * series


@inlined
def _patch(c, s, size):
    """Return the index of the part of the circle that contains an angle, and the position there; nan is in part 0."""
    angle = math.atan2(s, c) % _CIRCLE
    part = max(0, min(int(angle / _CIRCLE * size), size - 1))
    return part, angle - part * (_CIRCLE / size)


@inlined
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


@inlined
def _act(out, i, j, f, u):
    """Add the force f u on particle i, and the opposite force on particle j."""
    for e in range(3):
        out[i, e] += f * u[e]
    for e in range(3):
        out[j, e] -= f * u[e]


@inner
def _add_bonds(x, bonds, of_bonds, out):
    for n in range(len(bonds)):
        i, j = bonds[n]
        u = difference(x, i, j)
        r = math.sqrt(dot(u, u))
        if r != 0.0:  # a bond of zero length has no direction, and OpenMM applies no force either
            _act(out, i, j, of_bonds[1, n] * (of_bonds[0, n] - r) / r, u)


@inner
def _add_pairs(x, pairs, of_pairs, out):
    for n in range(len(pairs)):
        i, j = pairs[n]
        u = difference(x, i, j)
        square = dot(u, u)
        s = of_pairs[1, n] * of_pairs[1, n] / square
        s *= s * s
        f = of_pairs[0, n] / math.sqrt(square) + of_pairs[2, n] * (48.0 * s - 24.0) * s
        _act(out, i, j, f / square, u)


@inner_reordered
def _add_angles(x, angles, of_angles, out):
    lanes = np.empty((_ROWS, _BLOCK))
    for n in range(0, len(angles), _BLOCK):
        count = _angles(x, angles, n, lanes)
        for l in range(count):
            c, s, a, b = lanes[_COS, l], lanes[_SIN, l], of_angles[0, n + l], of_angles[1, n + l]
            lanes[_FACTOR, l] = of_angles[2, n + l] * _turn(a * c + b * s, b * c - a * s)
        _scatter(lanes, angles, n, count, 0, 3, out)


@inner_reordered
def _add_torsions(x, torsions, of_torsions, out):
    lanes = np.empty((_ROWS, _BLOCK))
    for n in range(0, len(torsions), _BLOCK):
        count = _torsions(x, torsions, n, 0, lanes)
        _series(lanes, n, count, of_torsions)
        _scatter(lanes, torsions, n, count, 0, 4, out)


@inner_reordered
def _add_impropers(x, impropers, of_impropers, out):
    lanes = np.empty((_ROWS, _BLOCK))
    for n in range(0, len(impropers), _BLOCK):
        count = _torsions(x, impropers, n, 0, lanes)
        for l in range(count):
            away = math.atan2(lanes[_SIN, l], lanes[_COS, l]) - of_impropers[0, n + l]
            away -= of_impropers[2, n + l] * round(away / of_impropers[2, n + l])
            lanes[_FACTOR, l] = -2.0 * of_impropers[1, n + l] * away
        _scatter(lanes, impropers, n, count, 0, 4, out)


@inner_reordered
def _add_maps(x, maps, patches, out):
    lanes, others = np.empty((_ROWS, _BLOCK)), np.empty((_ROWS, _BLOCK))
    for n in range(0, len(maps), _BLOCK):
        count = _torsions(x, maps, n, 0, lanes)
        _torsions(x, maps, n, 4, others)
        for l in range(count):
            first, size = maps[n + l, 8], maps[n + l, 9]
            s, u = _patch(lanes[_COS, l], lanes[_SIN, l], size)
            t, v = _patch(others[_COS, l], others[_SIN, l], size)
            lanes[_FACTOR, l], others[_FACTOR, l] = _of_map(patches[first + s * size + t], u, v)
        _scatter(lanes, maps, n, count, 0, 4, out)
        _scatter(others, maps, n, count, 4, 4, out)


@compiled("f2", Terms, "F2")
def forces(x, terms, out):
    """Write the forces (n, 3) in kJ/mol/nm on particles at x (n, 3) in nm."""
    out[:] = 0.0
    _add_bonds(x, terms.bonds, terms.of_bonds, out)
    _add_pairs(x, terms.pairs, terms.of_pairs, out)
    _add_angles(x, terms.angles, terms.of_angles, out)
    _add_torsions(x, terms.torsions, terms.of_torsions, out)
    _add_impropers(x, terms.impropers, terms.of_impropers, out)
    _add_maps(x, terms.maps, terms.patches, out)
