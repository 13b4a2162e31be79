"""Free motion of constrained clusters in the kernels: thirty digits, an independent integrator, and laws."""

import mpmath as mp
import numpy as np
import pytest
from kernel_functions import U, sum_of

import geodesics
from benchmarks.constraints.clusters import CLUSTERS, group_of, lengths_of, velocities
from openmm_exactrb.constraints import tables as constraints
from openmm_exactrb.constraints.clusters import sorted_into_kinds
from openmm_exactrb.constraints.tables import Group
from openmm_exactrb.engines.native.flexible.blocks import blocks_of

#: Clusters of up to six atoms: stars of each size, and other graphs.
SMALL = ["XH", "XH2", "XH3", "XH4", "chain", "ring", "water"]


class Cluster:
    """A cluster at rest, its start at 300 K on its constraints in mpf, and what moves it in the kernels."""

    def __init__(self, name, seed=1):
        self.masses, self.pairs, x = CLUSTERS[name]
        self.lengths, n = lengths_of(self.pairs, x), len(x)
        v = velocities(self.masses, np.random.default_rng(seed))
        self.start = geodesics.put_on(self.masses, self.pairs, self.lengths, x.tolist(), v.tolist())
        kinds = sorted_into_kinds([group_of(self.masses, self.pairs, self.lengths)]).kinds
        blocks = blocks_of([Group(kind.particles, kind.graph) for kind in kinds], [], n)
        self.order, (tables, _) = (
            blocks.particles,
            constraints.arrays(blocks.starts, blocks.sizes, blocks.groups, shared=True),
        )
        self.tables = [tables["clusters"], tables["graphs"], 1.0 / np.array(self.masses)[self.order], tables["lengths"]]

    def numbers(self, state):
        """Return arrays (n, 3, 2) of the kernel from positions and velocities in mpf."""
        with mp.workdps(40):
            return [np.array([[pair_of(c) for c in a[k]] for k in self.order]) for a in state]

    def exact(self, arrays):
        """Return positions and velocities in mpf."""
        back = np.argsort(self.order)
        with mp.workdps(40):
            return [[[sum_of(pair) for pair in a[k]] for k in back] for a in arrays]

    def moved(self, kernels, state, t):
        """Return positions and velocities in mpf after a time."""
        x, v = self.numbers(state)
        kernels("move", len(self.tables[0]), t, *self.tables, x, v, 0, *np.zeros((3, 1)))
        return self.exact((x, v))

    def heat_along_constraints(self, kernels, x, before, after, t):
        """Return what a motion over a time subtracts from the heat (n,) of an exchange at its start."""
        at, v = self.numbers((x, after))
        heat, exchanged = np.zeros(len(v)), [self.numbers((x, w))[1][..., 0].copy() for w in (before, after)]
        kernels("move", len(self.tables[0]), t, *self.tables, at, v, 1, *exchanged, heat)
        return -heat.sum()

    def kept(self, state):
        """Return energy, momentum and angular momentum, whose errors are relative to m v and m v nm."""
        x, v = state
        p = [[m * c for c in row] for m, row in zip(self.masses, v, strict=True)]
        turning = [cross(a, b) for a, b in zip(x, p, strict=True)]
        return [
            geodesics.energy(self.masses, v),
            *(mp.fsum(column) for a in (p, turning) for column in zip(*a, strict=True)),
        ]

    def misfits(self, state):
        """Return relative errors of lengths, and velocities along constraints (nm/ps)."""
        x, v = state
        found = []
        for (i, j), length in zip(self.pairs, self.lengths.tolist(), strict=True):
            r, w = ([a - b for a, b in zip(y[i], y[j], strict=True)] for y in (x, v))
            found.append((mp.norm(r) / mp.mpf(length) - 1, mp.fdot(r, w) / mp.norm(r)))
        return np.abs(np.array(found, float)).max(axis=0)


def pair_of(number):
    high = float(number)
    return high, float(number - mp.mpf(high))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def largest(a, b):
    """Return the largest difference of two lists of rows."""
    return float(max(abs(p - q) for one, other in zip(a, b, strict=True) for p, q in zip(one, other, strict=True)))


@pytest.fixture(params=[*SMALL, "peptide"], scope="module")
def cluster(request):
    return Cluster(request.param)


@pytest.mark.parametrize("cluster", SMALL, indirect=True)  # of more atoms, mpmath takes half a minute
def test_a_drift_errs_by_a_rounding_of_its_path_and_of_its_velocities(kernels, cluster):
    t = 0.002
    with mp.workdps(40):
        x1, v1 = geodesics.flow(cluster.masses, cluster.pairs, *cluster.start, t)
        x, v = cluster.moved(kernels, cluster.start, t)
        speed = float(max(abs(c) for row in v for c in row))
        assert largest(x, x1) < 4.0 * U * t * speed
        assert largest(v, v1) < 4.0 * U * speed


def rattle(cluster, t, steps):
    """Return positions and velocities (n, 3) after a time of RATTLE without forces, with constraints to roundoff."""
    x, v = (np.array(a, float) for a in cluster.start)
    inverse, h = 1.0 / np.array(cluster.masses)[:, None], t / steps
    between = np.zeros((len(cluster.pairs), len(x)))  # between @ x are the vectors of the constraints
    for c, (i, j) in enumerate(cluster.pairs):
        between[c, i], between[c, j] = 1.0, -1.0

    def along(r, now, wanted):
        """Return multiples of the constraints at r that change their products with the vectors `now` by `wanted`."""
        matrix = (between @ (inverse * between.T)) * (now @ r.T)
        return inverse * (between.T @ (np.linalg.solve(matrix, wanted)[:, None] * r))

    for _ in range(steps):
        r, end = between @ x, x + h * v
        for _ in range(6):  # Newton's method
            now = between @ end
            end += along(r, now, 0.5 * (cluster.lengths**2 - (now * now).sum(axis=1)))
        v, x, r = (end - x) / h, end, between @ end
        v -= along(r, r, (r * (between @ v)).sum(axis=1))
    return np.array([x, v])


def test_the_limit_of_rattle_is_the_geodesic(kernels, cluster):
    """RATTLE is of second order and symmetric, so that two step sizes leave an error of fourth order."""
    t = 0.004
    limit = (4.0 * rattle(cluster, t, 200) - rattle(cluster, t, 100)) / 3.0
    x, v = (np.array(a, float) for a in cluster.moved(kernels, cluster.start, t))
    np.testing.assert_allclose(x, limit[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(v, limit[1], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("t", [1e-6, 0.002, -0.03, 0.5])
def test_a_drift_keeps_what_is_kept_and_returns(kernels, cluster, t):
    """At 0.5 ps, in which hydrogens turn by ten radians and more, the kernel divides the drift."""
    with mp.workdps(40):
        state = cluster.moved(kernels, cluster.start, t)
        speed = float(max(abs(c) for row in state[1] for c in row))
        length, slip = cluster.misfits(state)
        assert length < 4.0 * U
        assert slip < 8.0 * U * speed
        scale = [float(geodesics.energy(cluster.masses, state[1]))] + 6 * [max(cluster.masses) * speed]
        for before, after, size in zip(cluster.kept(cluster.start), cluster.kept(state), scale, strict=True):
            assert abs(after - before) < 8.0 * U * size
        back = cluster.moved(kernels, state, -t)
        assert largest(back[0], cluster.start[0]) < 16.0 * U * abs(t) * speed


def test_a_projection_takes_the_velocities_along_constraints_away(kernels, cluster):
    x, v = cluster.start
    kicked = [[c + mp.mpf(k % 3) / 7 for k, c in enumerate(row, start=i)] for i, row in enumerate(v)]
    with mp.workdps(40):
        expected = geodesics.put_on(cluster.masses, cluster.pairs, cluster.lengths, x, kicked)[1]
        places, found = cluster.moved(kernels, (x, kicked), 0.0)
        assert largest(places, cluster.exact(cluster.numbers((x, v)))[0]) == 0.0
        speed = float(max(abs(c) for row in kicked for c in row))
        assert largest(found, expected) < 4.0 * U * speed


@pytest.mark.parametrize("t", [0.0, 0.002])
def test_heat_is_that_of_projected_velocities(kernels, cluster, t):
    """An exchange may follow a kick, so that its velocities have parts along the constraints before it, too."""
    x, v = cluster.start
    noise = np.random.default_rng(3).standard_normal((2, *np.shape(v)))
    with mp.workdps(40):
        before, after = (
            [[c + mp.mpf(d) for c, d in zip(*rows, strict=True)] for rows in zip(v, w.tolist(), strict=True)]
            for w in noise
        )
        along = []
        for w in (before, after):
            projected = geodesics.put_on(cluster.masses, cluster.pairs, cluster.lengths, x, w)[1]
            along.append(geodesics.energy(cluster.masses, w) - geodesics.energy(cluster.masses, projected))
        found = cluster.heat_along_constraints(kernels, x, before, after, t)
        assert float(abs(along[1] - along[0])) > 0.01 * float(along[0])
        assert abs(found - (along[1] - along[0])) < 64.0 * U * max(along)


@pytest.mark.parametrize("name", ["XH3", "chain"])
def test_clusters_that_diverge_are_no_numbers(kernels, name):
    cluster = Cluster(name)
    x, v = cluster.start
    assert mp.isnan(cluster.moved(kernels, (x, [[1e9 * c for c in row] for row in v]), 1.0)[0][0][0])


@pytest.mark.parametrize("name", ["XH", "XH2", "XH3", "XH4"])
@pytest.mark.parametrize("t", [0.0, 0.002])
def test_a_cluster_does_not_depend_on_those_beside_it(kernels, name, t):
    """Several stars are moved at once, unless the step of one of them is divided, as that of the last one here."""
    one = Cluster(name)
    n, rng = len(one.order), np.random.default_rng(4)
    x, v = ([a] * 11 for a in one.numbers(one.start))
    v = [a * np.array(-1.0 if k % 2 else 1.0 + 0.1 * k) for k, a in enumerate(v)]
    v[-1] = 300.0 * v[-1]
    exchanged = rng.standard_normal((2, 11, n, 3))
    together = moved_together(kernels, one, t, x, v, exchanged)
    for k in range(11):
        alone = moved_together(kernels, one, t, x[k : k + 1], v[k : k + 1], exchanged[:, k : k + 1])
        for many, single in zip(together, alone, strict=True):
            np.testing.assert_array_equal(many[n * k : n * k + n], single)


def moved_together(kernels, one, t, x, v, exchanged):
    """Return positions, velocities and the heat of copies of a cluster after a motion over t."""
    count, n, (table, graphs, inverse, lengths) = len(x), len(one.order), one.tables
    rows = np.repeat(table, count, axis=0)
    rows[:, 0] += n * np.arange(count, dtype=np.int32)
    tables = [rows, graphs, np.tile(inverse, count), np.tile(lengths[:n], count)]
    state, heat = [np.concatenate(a) for a in (x, v)], np.zeros(n * count)
    before, after = (np.ascontiguousarray(a.reshape(-1, 3)) for a in exchanged)
    kernels("move", count, t, *tables, *state, 1, before, after, heat)
    return *state, heat
