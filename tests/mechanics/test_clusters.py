"""Constrained clusters move along the geodesics of their constraints, to roundoff: compiled and in numpy."""

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

import geodesics
import openmm_exactrb as rb
from benchmarks.constraints import clusters as constrained_clusters
from charts import ClusterChart
from openmm_exactrb.constraints.clusters import LARGEST, Clusters, ClusterState, sorted_into_kinds
from openmm_exactrb.mathematics.quaternions import from_matrix, rotation_matrix


class NumpyClusters(Clusters):
    """Clusters that move in NumPy."""

    _advanced = Clusters.advanced_in_numpy


KERNELS = {"library": Clusters, "numpy": NumpyClusters}
STARS = ["XH", "XH2", "XH3", "XH4"]
EPS = 2.0**-52


@pytest.fixture(params=list(KERNELS))
def kernel(request):
    return request.param


@pytest.fixture(params=list(constrained_clusters.CLUSTERS))
def name(request):
    return request.param


def clusters_of(masses, pairs, lengths, kernel, copies=1):
    group = constrained_clusters.group_of(masses, pairs, lengths, copies)
    return KERNELS[kernel](sorted_into_kinds([group]).kinds)


def many(name, kernel, copies=1, seed=1, kT=2.494, away=0.0):
    """Return clusters, and a state of them with velocities at 300 K."""
    masses, pairs, x = constrained_clusters.CLUSTERS[name]
    clusters = clusters_of(masses, pairs, constrained_clusters.lengths_of(pairs, x), kernel, copies)
    places = np.tile(x, (copies, 1)) + away * np.array([0.31, -0.42, 0.57])
    v = constrained_clusters.velocities(np.tile(masses, copies), np.random.default_rng(seed), kT)
    return clusters, constrained_clusters.on_constraints(clusters, places, v)


def in_mpf(clusters, state):
    """Return places and velocities of all particles, exactly."""
    with mp.workdps(50):
        x, p = ([[mp.mpf(a[0, e, k]) + mp.mpf(a[1, e, k]) for e in range(3)] for k in range(a.shape[2])] for a in state)
        order = np.argsort(clusters.particles)
        return [x[k] for k in order], [[c / mp.mpf(clusters.mass[k]) for c in p[k]] for k in order]


def largest_difference(a, b):
    with mp.workdps(50):
        return float(max(abs(p - q) for one, other in zip(a, b, strict=True) for p, q in zip(one, other, strict=True)))


def relative_misfits(clusters, state):
    """Return abs(r_c)/d_c - 1 of all constraints."""
    found = []
    for kind, columns in clusters.columns():
        i, j = columns[:, kind.pairs].transpose(2, 0, 1)
        r = (state.x[:, :, i] - state.x[:, :, j]).sum(axis=0)
        found.append((np.sqrt((r * r).sum(axis=0)) / kind.lengths - 1.0).ravel())
    return np.concatenate(found)


def kinetic_energy(clusters, state):
    p, low = state.p
    return 0.5 * (p * (p + 2.0 * low) / clusters.mass).sum()


def momenta(clusters, state):
    """Return the total linear and angular momentum."""
    x, p = state.x[0], state.p[0]
    return np.concatenate([p.sum(axis=1), np.cross(x.T, p.T).sum(axis=0)])


# -- against 30 digits ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("t", [0.0005, -0.002, 0.02])
def test_a_drift_errs_by_a_rounding_of_its_path_and_of_its_velocities(name, t, pytestconfig):
    quick = name != "peptide" and (t == -0.002 or (t == 0.02 and name in ("XH2", "ring")))
    if not quick and not pytestconfig.getoption("--validate"):
        pytest.skip("up to half a minute of mpmath: run with --validate")
    masses, pairs, _ = constrained_clusters.CLUSTERS[name]
    clusters, state = many(name, "numpy")
    x, v = in_mpf(clusters, state)
    x1, v1 = geodesics.flow(masses, pairs, x, v, t)
    speed = float(max(abs(c) for row in v for c in row))
    for kernel in KERNELS:
        clusters, _ = many(name, kernel)
        X, V = in_mpf(clusters, clusters.drift(state, t))
        assert largest_difference(X, x1) < 3.0 * EPS * abs(t) * speed
        assert largest_difference(V, v1) < 3.0 * EPS * speed


def test_a_triangle_with_all_its_distances_is_the_free_rigid_body(kernel):
    """Two formulations without a formula in common: multipliers here, elliptic functions there."""
    masses, _, _ = constrained_clusters.CLUSTERS["water"]
    m = np.array(masses)
    clusters, state = many("water", kernel)
    order = np.argsort(clusters.particles)
    x, v = state.x[0].T[order], (state.p[0] / clusters.mass).T[order]
    centre, drift = (m[:, None] * np.array([x, v])).sum(axis=1) / m.sum()
    inertia, axes = np.linalg.eigh(
        np.einsum("a,aij->ij", m, [(b @ b) * np.eye(3) - np.outer(b, b) for b in x - centre])
    )
    axes *= np.linalg.det(axes)
    spin = axes.T @ np.cross(x - centre, m[:, None] * (v - drift)).sum(axis=0)
    q = from_matrix(axes[:, :, None])[:, 0]
    for t in (0.002, -0.02, 0.3):
        q1, spin1 = rb.free_rotor(inertia, q, spin, t)
        Q = rotation_matrix(q1)
        sites = (x - centre) @ axes
        moved = clusters.drift(state, t)
        np.testing.assert_allclose(moved.x[0].T[order], centre + t * drift + sites @ Q.T, rtol=0.0, atol=2e-15)
        velocity = drift + np.cross(Q @ (spin1 / inertia), sites @ Q.T)
        np.testing.assert_allclose((moved.p[0] / clusters.mass).T[order], velocity, rtol=0.0, atol=1e-13)


def test_the_oracle_itself_keeps_energy_and_constraints_to_its_digits():
    masses, pairs, x = constrained_clusters.CLUSTERS["ring"]
    lengths = constrained_clusters.lengths_of(pairs, x)
    v = constrained_clusters.velocities(masses, np.random.default_rng(4))
    x0, v0 = geodesics.put_on(masses, pairs, lengths, x, v)
    x1, v1 = geodesics.flow(masses, pairs, x0, v0, 0.01)
    with mp.workdps(40):
        assert abs(geodesics.energy(masses, v1) / geodesics.energy(masses, v0) - 1) < mp.mpf(10) ** -29
        for (i, j), d in zip(pairs, lengths, strict=True):
            square = mp.fsum((a - b) ** 2 for a, b in zip(x1[i], x1[j], strict=True))
            assert abs(square / mp.mpf(d) ** 2 - 1) < mp.mpf(10) ** -29


# -- laws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("t", "rounding"), [(0.0005, 1e-15), (0.004, 1e-15), (0.02, 0.5 * EPS * 500**0.5)])
def test_five_hundred_steps_keep_energy_and_constraints_to_1e_15(name, t, rounding):
    """In a step of 20 fs hydrogens turn by half a radian, and the energy walks with half a rounding a step."""
    clusters, start = many(name, "library", away=10.0)
    state = start
    for _ in range(500):
        state = clusters.drift(state, t)
        assert np.abs(relative_misfits(clusters, state)).max() < 1e-15
        assert abs(kinetic_energy(clusters, state) / kinetic_energy(clusters, start) - 1.0) < rounding
    assert np.abs(state.x[0] - start.x[0]).max() > 0.05


@pytest.mark.parametrize("which", ["XH", "XH3"])
def test_the_energy_walks_without_a_direction(which):
    """Also where hydrogens turn by half a radian a step and every step rounds the same lengths again."""
    copies = 256
    clusters, state = many(which, "library", copies)

    def energies(state):
        p, low = state.p
        return (p * (p + 2.0 * low) / clusters.mass).sum(axis=0).reshape(-1, copies).sum(axis=0)

    start = energies(state)
    for _ in range(200):
        state = clusters.drift(state, 0.02)
    change = energies(state) / start - 1.0
    assert np.sqrt((change**2).mean()) < 0.25 * EPS * 200**0.5
    assert abs(change.mean()) < 4.0 * change.std() / copies**0.5


def test_five_hundred_steps_and_back_return_to_1e_14_nm(name):
    clusters, start = many(name, "library", away=10.0)
    state = start
    for _ in range(500):
        state = clusters.drift(state, 0.002)
    assert np.abs(state.x[0] - start.x[0]).max() > 0.05
    for _ in range(500):
        state = clusters.drift(state, -0.002)
    assert np.abs((state.x - start.x).sum(axis=0)).max() < 1e-14


def test_twenty_stepsadvanced_in_numpy_keep_what_the_others_keep(name):
    clusters, start = many(name, "numpy", away=10.0)
    state = start
    for _ in range(20):
        state = clusters.drift(state, 0.002)
    assert np.abs(relative_misfits(clusters, state)).max() < 1e-15
    assert abs(kinetic_energy(clusters, state) / kinetic_energy(clusters, start) - 1.0) < 1e-15
    for _ in range(20):
        state = clusters.drift(state, -0.002)
    assert np.abs((state.x - start.x).sum(axis=0)).max() < 1e-15


def test_momentum_and_angular_momentum_are_kept(name, kernel):
    clusters, state = many(name, kernel)
    moved = clusters.drift(state, 0.02)
    x, p = state.x[0], state.p[0]
    scale = np.abs(p).sum() * max(1.0, np.abs(x).max())
    np.testing.assert_allclose(momenta(clusters, moved), momenta(clusters, state), rtol=0.0, atol=4.0 * EPS * scale)


def test_times_add_up_however_long(name, kernel):
    """One long drift, which is halved many times, is the sum of short ones."""
    clusters, state = many(name, kernel)
    once, bits = clusters.drift(state, 0.1), state
    for _ in range(50):
        bits = clusters.drift(bits, 0.002)
    np.testing.assert_allclose(once.x[0], bits.x[0], rtol=0.0, atol=2e-14)
    np.testing.assert_allclose(once.p[0], bits.p[0], rtol=0.0, atol=2e-12)


@pytest.mark.parametrize("which", ["XH2", "XH3", "water", "chain", "ring"])
def test_a_drift_is_symplectic(which, kernel):
    """In canonical coordinates: a basis of the tangent space at a place, and the momenta that belong to it."""
    clusters, state = many(which, kernel)
    t = 0.004
    end = clusters.drift(state, t)
    charts = [ClusterChart(clusters, s) for s in (state, end)]
    start = charts[0].coordinates(state)

    def step(z):
        return charts[1].coordinates(clusters.drift(charts[0].state(z), t))

    f = len(start) // 2
    scale = np.concatenate([np.full(f, 2.5e-4), np.full(f, 2.5e-3)])
    columns = [
        (8 * (step(start + d) - step(start - d)) - (step(start + 2 * d) - step(start - 2 * d))) / (12 * d.max())
        for d in np.diag(scale)
    ]
    J, zero = np.array(columns).T, np.zeros((f, f))
    form = np.block([[zero, np.eye(f)], [-np.eye(f), zero]])
    assert f == clusters.degrees_of_freedom
    assert np.abs(J.T @ form @ J - form).max() < 1e-10
    free_flight = np.block([[np.eye(f), t * np.eye(f)], [zero, np.eye(f)]])
    assert np.abs(J - free_flight).max() > 1e-3  # constraints bend the motion


# -- the projection ---------------------------------------------------------------------------------------------------


def test_the_projection_is_the_orthogonal_one_of_the_mass_metric(name, kernel, rng):
    """The closest tangent vector, as least squares find it."""
    clusters, state = many(name, kernel)
    p = rng.standard_normal((3, clusters.mass.size))
    projected = clusters.tangent(ClusterState(state.x, np.stack([p, np.zeros(p.shape)]))).p[0]
    chart = ClusterChart(clusters, state)
    root = np.sqrt(chart.mass)
    nearest = chart.T @ np.linalg.lstsq(root[:, None] * chart.T, p.T.ravel() / root, rcond=None)[0] * chart.mass
    np.testing.assert_allclose(projected.T.ravel(), nearest, rtol=0.0, atol=3e-14)


def test_a_tangent_momentum_stays_what_it_is(name, kernel):
    clusters, state = many(name, kernel)
    once = clusters.tangent(state)
    np.testing.assert_allclose(once.p[0], state.p[0], rtol=0.0, atol=4.0 * EPS * np.abs(state.p[0]).max())
    assert np.array_equal(once.x, state.x)


def test_a_drift_projects_before_it_moves(name, kernel, rng):
    """Kicks before a drift need no projection of their own."""
    clusters, state = many(name, kernel)
    kicked = state._replace(p=state.p + np.stack([rng.standard_normal(state.p[0].shape), np.zeros(state.p[0].shape)]))
    one, other = clusters.drift(kicked, 0.002), clusters.drift(clusters.tangent(kicked), 0.002)
    np.testing.assert_allclose(one.x[0], other.x[0], rtol=0.0, atol=1e-16)
    np.testing.assert_allclose(one.p[0], other.p[0], rtol=0.0, atol=3e-14)


# -- arrays -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("copies", [2, 31, 32, 33, 70])
def test_clusters_do_not_feel_their_neighbours(copies, kernel):
    clusters, state = many("XH3", kernel, copies)
    together = clusters.drift(state, 0.005)
    alone, _ = many("XH3", kernel)
    for k in range(copies):
        apart = alone.drift(ClusterState(*(np.ascontiguousarray(a[:, :, k::copies]) for a in state)), 0.005)
        np.testing.assert_allclose(together.x[0][:, k::copies], apart.x[0], rtol=0.0, atol=1e-17 + EPS * 0.15)
        np.testing.assert_allclose(together.p[0][:, k::copies], apart.p[0], rtol=1e-14, atol=1e-14)


def test_kinds_stand_side_by_side_and_both_kernels_agree():
    groups, masses, x, n = [], [], [], 0
    for m, pairs, places in constrained_clusters.CLUSTERS.values():
        group = constrained_clusters.group_of(m, pairs, constrained_clusters.lengths_of(pairs, places), 3)
        groups.append(replace(group, particles=n + group.particles))
        masses += 3 * m
        x += [places + 0.4 * k for k in range(3)]
        n += group.particles.size
    v = constrained_clusters.velocities(masses, np.random.default_rng(3))
    states = []
    for kernel in KERNELS.values():
        clusters = kernel(sorted_into_kinds(groups).kinds)
        assert [len(kind.particles) for kind in clusters.kinds] == 8 * [3]
        assert clusters.degrees_of_freedom == 3 * n - 3 * sum(len(group.pairs) for group in groups)
        state = constrained_clusters.on_constraints(clusters, np.concatenate(x), v)
        states.append(clusters.drift(clusters.tangent(state), 0.01))
    for a, b in zip(*((s.x[0], s.p[0]) for s in states), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-15, atol=2e-14)


def test_states_handed_in_are_not_modified(kernel):
    clusters, state = many("XH3", kernel, 3)
    kept = ClusterState(*(a.copy() for a in state))
    clusters.drift(state, 0.002), clusters.tangent(state)
    assert all(np.array_equal(a, b) for a, b in zip(state, kept, strict=True))


def test_no_clusters_at_all_are_a_state_without_columns(kernel):
    clusters = KERNELS[kernel]([])
    state = clusters.drift(ClusterState(np.zeros((2, 3, 0)), np.zeros((2, 3, 0))), 0.1)
    assert (len(clusters), clusters.degrees_of_freedom, state.x.shape) == (0, 0, (2, 3, 0))


def test_plain_numbers_are_advanced_too_and_rounded(kernel):
    """Without their low parts places far from the origin keep no more digits than float64 has there."""
    clusters, state = many("XH3", kernel, 5, away=10.0)
    rounded = ClusterState(*(a[:1].copy() for a in state))
    for _ in range(20):
        state, rounded = clusters.drift(state, 0.002), clusters.drift(rounded, 0.002)
    np.testing.assert_allclose(rounded.x[0], state.x[0], rtol=0.0, atol=1e-13)
    assert np.abs(relative_misfits(clusters, rounded)).max() > 1e-15
    assert np.abs(relative_misfits(clusters, state)).max() < 1e-15


def test_atoms_at_rest_stay(name, kernel):
    clusters, state = many(name, kernel, kT=0.0)
    moved = clusters.drift(state, 0.02)
    assert not moved.p.any()
    np.testing.assert_allclose((moved.x - state.x).sum(axis=0), 0.0, atol=1e-24)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_a_cluster_without_an_answer_becomes_nan_alone(bad, kernel):
    clusters, state = many("XH3", kernel, 5)
    state.p[0, 1, 7] = bad  # an atom of cluster 2
    moved = clusters.drift(state, 0.002)
    lost = ~np.isfinite(np.concatenate([moved.x[0], moved.p[0]])).all(axis=0)
    each = lost.reshape(-1, 5)
    assert each.all(axis=0).tolist() == each.any(axis=0).tolist() == [False, False, True, False, False]
    healthy = many("XH3", kernel, 5)[1]
    expected = clusters.drift(healthy, 0.002).x[0]
    np.testing.assert_allclose(moved.x[0][:, ~lost], expected[:, ~lost], atol=1e-15)


@pytest.mark.parametrize("which", STARS)
def test_a_star_on_a_line_is_no_singular_place(which):
    """An atom that one constraint holds always leaves that constraint independent, so trees have no singular place."""
    masses, pairs, x = constrained_clusters.CLUSTERS[which]
    lengths = constrained_clusters.lengths_of(pairs, x)
    rays = np.arange(1.0, len(masses))
    line = np.zeros((len(masses), 3))
    line[1:, 0] = lengths * (-1.0) ** rays
    both = [clusters_of(masses, pairs, lengths, kernel) for kernel in KERNELS]
    v = constrained_clusters.velocities(masses, np.random.default_rng(2))
    state = constrained_clusters.on_constraints(both[0], line, v)
    x1, _ = geodesics.flow(masses, pairs, *in_mpf(both[0], state), 0.002)
    for clusters in both:
        assert largest_difference(in_mpf(clusters, clusters.drift(state, 0.002))[0], x1) < 1e-17


def test_a_chain_of_thousands_of_constraints_moves_as_well(rng):
    """The factor of a tree has no fill: cost and memory grow with the number of constraints."""
    n = LARGEST + 1
    steps = rng.standard_normal((n, 3))
    x = np.cumsum(0.15 * steps / np.linalg.norm(steps, axis=1, keepdims=True), axis=0)
    pairs = np.column_stack([np.arange(n - 1), np.arange(1, n)])
    clusters = clusters_of(np.full(n, 12.0), pairs, np.full(n - 1, 0.15), "library")
    assert len(clusters.kinds[0].graph.columns) == 2 * (n - 1) - 1
    start = constrained_clusters.on_constraints(clusters, x, 0.3 * rng.standard_normal((n, 3)))
    state = start
    for _ in range(5):
        state = clusters.drift(state, 0.002)
    assert np.abs(relative_misfits(clusters, state)).max() < 1e-15
    assert abs(kinetic_energy(clusters, state) / kinetic_energy(clusters, start) - 1.0) < 1e-15
