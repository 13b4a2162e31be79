"""The paper's free-body methods in compiled form: `rotors.euler`, `rotation`, `quaternion` and `moser_veselov`.

The paper's programs are written in Fortran. In numpy, an iteration for each body costs far more than a formula for all
bodies, so costs in numpy are not comparable. The compiled functions have the formulas and the names of the package's
functions. They accept only ascending moments and regular bodies (`euler.is_regular`), and do not check their arguments.
"""

import math
from functools import partial

import numpy as np
from numba import njit

from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mathematics.elliptic import SEPARATRIX_LIMIT, TINY_PHASE
from openmm_exactrb.rotors import moser_veselov

CONVERGED, MOST_ITERATIONS = 1e-15, moser_veselov.MOST_ITERATIONS
#: The largest number of steps of Landen's transformation.
LANDEN = 24
compiled = njit(error_model="numpy", fastmath={"arcp", "contract", "nsz"})  # reciprocals, and fused products
product = njit(error_model="numpy", inline="always")(quaternions.product)


def flow(name, inertia, third_kind=True):
    """Return flow(q, m, t) -> (q, m) of a rotor's name, for C-contiguous q (4, N), m and inertia (3, N), and a time.

    Without `third_kind` the integral of the third kind is left out, to measure the cost of the rest.
    """
    if name.startswith("dmv"):
        terms = moser_veselov._series(inertia, int(name[3:]))  # noqa: SLF001
        s, d = (
            np.vstack([np.broadcast_to(t, (len(t), inertia.shape[1])) for t in kind])
            for kind in zip(*terms, strict=True)
        )
        return partial(moser_veselov_flow, inertia, s, d)
    nodes, weights = np.empty((2, 0))
    if "gauss" in name:
        nodes, weights = np.polynomial.legendre.leggauss(int(name.partition("gauss")[2]) // 2)
    rule = (0.5 * (1.0 + nodes), 0.5 * weights) if third_kind else None
    return partial(jacobi_flow, inertia, name.startswith("rotation"), rule)


# -- Jacobi's solution, with the integral of the third kind or its approximation by Gauss's rule ----------------------


@compiled
def jacobi_flow(inertia, by_matrices, rule, q, m, t):
    """Advance bodies as the flow of `rotation.rotor` or `quaternion.kosenko`; the integral is exact if the rule has no nodes."""
    q1, m1, means = np.empty_like(q), np.empty_like(m), np.empty((2, LANDEN))
    for n in range(m.shape[1]):
        moments, momentum = (inertia[0, n], inertia[1, n], inertia[2, n]), (m[0, n], m[1, n], m[2, n])
        turn, (a, b, c) = jacobi_step(moments, momentum, t, by_matrices, rule, means)
        q1[0, n], q1[1, n], q1[2, n], q1[3, n] = turned((q[0, n], q[1, n], q[2, n], q[3, n]), turn)
        m1[0, n], m1[1, n], m1[2, n] = a, b, c
    return q1, m1


@compiled
def jacobi_step(moments, m, t, by_matrices, rule, means):
    """Return the rotation of a step and the new momentum: `euler._step` and `euler.solve`."""
    I1, I2, I3 = moments
    square = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    G = math.sqrt(square)
    time = t * G
    f1, f3 = math.copysign(1.0, m[0]), math.copysign(1.0, m[2])
    f2 = f1 * f3
    x1, x2, x3 = f1 * m[0] / G, f2 * m[1] / G, f3 * m[2] / G

    a1_squared = x1 * x1 * (I3 - I1) / I1 + x2 * x2 * (I3 - I2) / I2
    a3_squared = x3 * x3 * (I3 - I1) / I3 + x2 * x2 * (I2 - I1) / I2
    energy = x1 * x1 / I1 + x2 * x2 / I2 + x3 * x3 / I3
    excess = x3 * x3 * (I3 - I2) / I3 - x1 * x1 * (I2 - I1) / I1
    high = excess < 0.0
    first, third = math.sqrt(I1 * a1_squared / (I3 - I1)), math.sqrt(I3 * a3_squared / (I3 - I1))
    second = math.sqrt(I2 * a3_squared / (I2 - I1) if high else I2 * a1_squared / (I3 - I2))
    drive = a1_squared * (I2 - I1) if high else a3_squared * (I3 - I2)
    rate = math.sqrt(drive / (I1 * I2 * I3))
    k2 = (a3_squared * (I3 - I2) if high else a1_squared * (I2 - I1)) / drive
    kc2 = min(abs(excess) * (I3 - I1) / drive, 1.0)

    sn, cn = x2 / second, (x3 / third if high else x1 / first)
    norm = math.sqrt(sn * sn + cn * cn)
    sn, cn = sn / norm, cn / norm
    dn = math.sqrt(cn * cn + kc2 * sn * sn)
    before = (sn, cn, dn, 0.0)
    after = jacobi(sn * carlson_rf(cn * cn, dn * dn, 1.0) + rate * time, kc2, means)
    sn, cn, dn, _ = after
    start = (x1, x2, x3)
    end = unit(first * (dn if high else cn), second * sn, third * (cn if high else dn))

    b = (I3 - I1) / (I1 * I3)
    if by_matrices:
        circled = first if high else third
        nc = abs(excess) / (b * I2 * circled * circled)
        psi = energy * time + excess / (I2 * rate) * third_kind(before, after, kc2, nc, rate * time, rule)
        turn = by_frames(moments, start, end, psi)
    else:
        nc = 1.0 / (first * first) if high else I2 * (I3 - I1) / (I1 * (I3 - I2))
        psi = time / I3 + b / rate * third_kind(before, after, kc2, nc, rate * time, rule)
        if high:
            root = math.sqrt(k2 + (third / first) ** 2)
            change = math.atan(root * after[0] / after[2]) - math.atan(root * before[0] / before[2])
        else:
            root = math.sqrt(nc)
            change = continued(after, root) - continued(before, root)
        turn = by_smallest_rotations(start, end, psi - b / rate * third * change / root)
    w, x, y, z = turn
    m1 = with_norm(G * f1 * end[0], G * f2 * end[1], G * f3 * end[2], m, square)
    return (w, f1 * x, f2 * y, f3 * z), m1


@njit(error_model="numpy")
def jacobi(v, kc2, means):
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
        converged = abs(a - g) <= 1e-8 * a or last == LANDEN - 1
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


@compiled
def third_kind(before, after, kc2, nc, argument, rule):
    """Return the difference of the integral of the third kind: `euler.carlson`, or what `euler.gauss` gives."""
    if rule is None:
        return argument
    if not len(rule[0]):
        return argument + legendre(after, kc2, nc) - legendre(before, kc2, nc)
    start = continued(before, 1.0)
    change = continued(after, 1.0) - start
    total = 0.0
    for node, weight in zip(rule[0], rule[1]):  # noqa: B905  # numba has no other zip
        angle = start + node * change
        sine, cosine = math.sin(angle), math.cos(angle)
        sine2, cosine2 = sine * sine, cosine * cosine
        total += weight / ((cosine2 + nc * sine2) * math.sqrt(cosine2 + kc2 * sine2))
    return change * total


@compiled
def legendre(phase, kc2, nc):
    """Do as `elliptic.third_kind_legendre`."""
    sn, cn, dn, half_turns = phase
    sn2, cn2 = sn * sn, cn * cn
    integral = (-sn if cn < 0.0 else sn) * sn2 * carlson_rj_of_one(cn2, dn * dn, cn2 + nc * sn2)
    if half_turns != 0.0:
        integral += 2.0 * half_turns * carlson_rj_of_one(0.0, kc2, nc)
    return (1.0 - nc) / 3.0 * integral


@compiled
def continued(phase, ratio):
    """Do as `euler.Phase.continued`."""
    sn, cn, _, half_turns = phase
    return half_turns * math.pi + math.atan2(ratio * (-sn if cn < 0.0 else sn), abs(cn))


@compiled
def by_frames(moments, start, end, psi):
    """Return the rotation from the frames at start and end and the planar angle between them: `rotation.rotor`."""
    I1, I2, I3 = moments
    a, b, c = (I2 - I3) / (I2 * I3), (I3 - I1) / (I3 * I1), (I1 - I2) / (I1 * I2)
    v0, v = frame(a, b, c, start), frame(a, b, c, end)
    w0, w = cross(start, v0), cross(end, v)
    cosine, sine = math.cos(psi), math.sin(psi)
    e = (cosine * v[0] - sine * w[0], cosine * v[1] - sine * w[1], cosine * v[2] - sine * w[2])
    f = (sine * v[0] + cosine * w[0], sine * v[1] + cosine * w[1], sine * v[2] + cosine * w[2])
    return from_matrix(
        combined(v0[0], e, w0[0], f, start[0], end),
        combined(v0[1], e, w0[1], f, start[1], end),
        combined(v0[2], e, w0[2], f, start[2], end),
    )


@compiled
def frame(a, b, c, x):
    """Return the direction of the momentum's change."""
    v1, v2, v3 = a * x[1] * x[2], b * x[2] * x[0], c * x[0] * x[1]
    norm = math.sqrt(v1 * v1 + v2 * v2 + v3 * v3)
    return v1 / norm, v2 / norm, v3 / norm


@compiled
def cross(x, y):
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]


@compiled
def combined(a, x, b, y, c, z):
    """Return a x + b y + c z."""
    return a * x[0] + b * y[0] + c * z[0], a * x[1] + b * y[1] + c * z[1], a * x[2] + b * y[2] + c * z[2]


@compiled
def from_matrix(Q1, Q2, Q3):
    """Return the quaternion of the rotation matrix with these rows: `quaternions.from_matrix`."""
    x, y, z = Q3[1] - Q2[2], Q1[2] - Q3[0], Q2[0] - Q1[1]
    xy, xz, yz = Q1[1] + Q2[0], Q1[2] + Q3[0], Q2[2] + Q3[1]
    d1, d2, d3 = Q1[0], Q2[1], Q3[2]
    trace = d1 + d2 + d3
    if trace >= max(d1, d2, d3):
        w, x, y, z = 1.0 + trace, x, y, z
    elif d1 >= max(d2, d3):
        w, x, y, z = x, 1.0 + 2.0 * d1 - trace, xy, xz
    elif d2 >= d3:
        w, x, y, z = y, xy, 1.0 + 2.0 * d2 - trace, yz
    else:
        w, x, y, z = z, xz, yz, 1.0 + 2.0 * d3 - trace
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm


@compiled
def by_smallest_rotations(start, end, angle):
    """Return p(0)^-1 y p(t) with a turn y about axis 3: `quaternion._flow`."""
    p0, p = smallest_rotation(start), smallest_rotation(end)
    cosine, sine = math.cos(0.5 * angle), math.sin(0.5 * angle)
    y = product(cosine, 0.0, 0.0, sine, p[0], p[1], p[2], 0.0)
    return product(p0[0], -p0[1], -p0[2], 0.0, y[0], y[1], y[2], y[3])


@compiled
def smallest_rotation(x):
    above = 1.0 + x[2] if x[2] > -0.5 else (x[0] * x[0] + x[1] * x[1]) / (1.0 - x[2])
    norm = math.sqrt(2.0 * above)
    return above / norm, x[1] / norm, -x[0] / norm


# -- the preprocessed discrete Moser-Veselov algorithm ----------------------------------------------------------------


@compiled
def moser_veselov_flow(moments, s_terms, d_terms, q, m, t):
    """Advance bodies as the flow of `moser_veselov.rotor`; nan where it does not converge. Angles are not checked."""
    q1, m1 = np.empty_like(q), np.empty_like(m)
    for n in range(m.shape[1]):
        I, u = (moments[0, n], moments[1, n], moments[2, n]), (m[0, n], m[1, n], m[2, n])
        s, d = modified(I, s_terms, d_terms, n, u, t)
        angle, converged = iterate((s / I[0] + d, s / I[1] + d, s / I[2] + d), u, t)
        turn, u1 = cayley(angle, u)
        if not converged:
            turn, u1 = (math.nan, math.nan, math.nan, math.nan), (math.nan, math.nan, math.nan)
        q1[0, n], q1[1, n], q1[2, n], q1[3, n] = turned((q[0, n], q[1, n], q[2, n], q[3, n]), turn)
        m1[0, n], m1[1, n], m1[2, n] = u1
    return q1, m1


@compiled
def modified(I, s_terms, d_terms, n, m, h):
    """Return s and d of `moser_veselov._modified`."""
    C = 0.5 * (m[0] * m[0] + m[1] * m[1] + m[2] * m[2]) * h * h
    H = 0.5 * (m[0] * m[0] / I[0] + m[1] * m[1] / I[1] + m[2] * m[2] / I[2]) * h * h
    s, d, k, degree = 1.0, 0.0, 0, 0
    ratio, power = H / C, 1.0
    while k < len(s_terms):
        degree += 1
        power *= C
        monomial = power
        for _ in range(degree + 1):
            s += s_terms[k, n] * monomial
            d += d_terms[k, n] * monomial
            monomial *= ratio
            k += 1
    return s, d


@compiled
def iterate(inverse, m, h):
    """Solve the equations of the discrete step, and say whether this converged: `moser_veselov._iterate`."""
    a, b, c = inverse
    if not (a > 0.0 and b > 0.0 and c > 0.0):
        return (0.0, 0.0, 0.0), False
    g1, g2, g3 = 0.5 * (c - b) / (c * b), 0.5 * (a - c) / (a * c), 0.5 * (b - a) / (b * a)
    f1, f2, f3 = h * m[0], h * m[1], h * m[2]
    x1, x2, x3 = f1, f2, f3
    converged = False
    for _ in range(MOST_ITERATIONS):
        a1, a2, a3 = a * x1, b * x2, c * x3
        alpha = 1.0 + 0.25 * (a1 * a1 + a2 * a2 + a3 * a3)
        y1, y2, y3 = alpha * f1 + g1 * a2 * a3, alpha * f2 + g2 * a3 * a1, alpha * f3 + g3 * a1 * a2
        change, size = max(abs(y1 - x1), abs(y2 - x2), abs(y3 - x3)), max(abs(y1), abs(y2), abs(y3))
        x1, x2, x3 = y1, y2, y3
        converged = change <= CONVERGED * size
        if converged or not size < math.inf:
            break
    return (a * x1, b * x2, c * x3), converged


@compiled
def cayley(angle, m):
    """Return the rotation of a discrete step and the momentum seen from the turned body: `moser_veselov._step`."""
    c = (0.5 * angle[0], 0.5 * angle[1], 0.5 * angle[2])
    alpha = 1.0 + c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
    across = cross(m, c)
    twice = cross(across, c)
    factor = 2.0 / alpha
    m1, m2, m3 = (
        m[0] + (across[0] + twice[0]) * factor,
        m[1] + (across[1] + twice[1]) * factor,
        m[2] + (across[2] + twice[2]) * factor,
    )
    root = math.sqrt(alpha)
    turn = (1.0 / root, c[0] / root, c[1] / root, c[2] / root)
    return turn, with_norm(m1, m2, m3, m, m[0] * m[0] + m[1] * m[1] + m[2] * m[2])


# -- what both share --------------------------------------------------------------------------------------------------


@compiled
def turned(q, turn):
    """Return the product of two quaternions, renormalised."""
    w, x, y, z = product(q[0], q[1], q[2], q[3], turn[0], turn[1], turn[2], turn[3])
    factor = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    return factor * w, factor * x, factor * y, factor * z


@compiled
def unit(x, y, z):
    """Do as `quaternions.renormalise`."""
    factor = 1.5 - 0.5 * (x * x + y * y + z * z)
    return factor * x, factor * y, factor * z


@compiled
def with_norm(x, y, z, m, square):
    """Do as `compensated.keep_norm`."""
    difference = (m[0] - x) * (m[0] + x) + (m[1] - y) * (m[1] + y) + (m[2] - z) * (m[2] + z)
    factor = 1.0 + 0.5 * difference / square
    return factor * x, factor * y, factor * z


@compiled
def carlson_rf(x, y, z):
    """Return Carlson's R_F: duplication, then the series of DLMF 19.36.1."""
    mean = (x + y + z) / 3.0
    dx, dy = mean - x, mean - y
    spread, scale = 340.0 * max(abs(dx), abs(dy), abs(mean - z)), 1.0
    while scale * spread >= mean:
        rx, ry, rz = math.sqrt(x), math.sqrt(y), math.sqrt(z)
        step = rx * (ry + rz) + ry * rz
        x, y, z, mean, scale = (
            0.25 * (x + step),
            0.25 * (y + step),
            0.25 * (z + step),
            0.25 * (mean + step),
            0.25 * scale,
        )
    X, Y = dx * scale / mean, dy * scale / mean
    Z = -X - Y
    E2, E3 = X * Y - Z * Z, X * Y * Z
    return (1.0 - E2 / 10.0 + E3 / 14.0 + E2 * E2 / 24.0 - 3.0 / 44.0 * E2 * E3) / math.sqrt(mean)


@compiled
def carlson_rj_of_one(x, y, p):
    """Return Carlson's R_J(x, y, 1, p) for positive p: duplication, then the series of DLMF 19.36.2.

    The package's `carlson_rj` is for p that is not below the other three.
    """
    z = 1.0
    delta = (p - x) * (p - y) * (p - z)
    mean = 0.2 * (x + y + z + 2.0 * p)
    dx, dy, dz = mean - x, mean - y, mean - z
    spread = 440.0 * max(abs(dx), abs(dy), abs(dz), abs(mean - p))
    scale, total = 1.0, 0.0
    while scale * spread >= mean:
        rx, ry, rz, rp = math.sqrt(x), math.sqrt(y), math.sqrt(z), math.sqrt(p)
        d = (rp + rx) * (rp + ry) * (rp + rz)
        total += scale / d * carlson_rc_of_one(scale * scale * scale * delta / (d * d))
        step = rx * (ry + rz) + ry * rz
        x, y, z, p = 0.25 * (x + step), 0.25 * (y + step), 0.25 * (z + step), 0.25 * (p + step)
        mean, scale = 0.25 * (mean + step), 0.25 * scale
    X, Y, Z = dx * scale / mean, dy * scale / mean, dz * scale / mean
    P = -0.5 * (X + Y + Z)
    E2 = X * Y + X * Z + Y * Z - 3.0 * P * P
    E3 = X * Y * Z + 2.0 * E2 * P + 4.0 * P * P * P
    E4 = (2.0 * X * Y * Z + E2 * P + 3.0 * P * P * P) * P
    E5 = X * Y * Z * P * P
    series = 1.0 - 3 / 14 * E2 + E3 / 6 + 9 / 88 * E2 * E2 - 3 / 22 * E4 - 9 / 52 * E2 * E3 + 3 / 26 * E5
    return scale * series / (mean * math.sqrt(mean)) + 6.0 * total


@compiled
def carlson_rc_of_one(e):
    """Return Carlson's R_C(1, 1 + e)."""
    if abs(e) < 1e-3:
        return 1.0 - e * (1 / 3 - e * (1 / 5 - e * (1 / 7 - e * (1 / 9 - e / 11))))
    root = math.sqrt(abs(e))
    return math.atan(root) / root if e > 0.0 else math.atanh(root) / root
