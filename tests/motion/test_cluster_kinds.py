"""What a cluster is: kinds are found from constraints, and graphs that cannot be held are refused in one sentence."""

import numpy as np
import pytest

import constrained_clusters
from openmm_exactrb.motion.cluster_kind import LARGEST, ClusterKind
from openmm_exactrb.motion.clusters import find_clusters


@pytest.fixture(params=["numpy", "numba"])
def kernel(request):
    return request.param


def test_stars_are_of_one_kind_in_whatever_order_their_particles_stand():
    masses = [12.0, 1.0, 1.0, 2.0, 1.0, 2.0, 12.0, 1.0]
    clusters = find_clusters(masses, [(0, 1), (2, 0), (0, 3), (6, 5), (4, 6), (7, 6)], [0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    assert [kind.particles.tolist() for kind in clusters.kinds] == [[[0, 1, 2, 3], [6, 4, 7, 5]]]
    assert clusters.kinds[0].shape == "star"


@pytest.mark.parametrize(("name", "shape"), [("XH", "pair"), ("XH3", "star"), ("chain", "tree"), ("ring", "general")])
def test_the_graph_has_a_name_and_its_freedom(name, shape):
    masses, pairs, x = constrained_clusters.CLUSTERS[name]
    clusters = find_clusters(masses, pairs, constrained_clusters.lengths_of(pairs, x))
    assert clusters.kinds[0].shape == shape
    assert clusters.degrees_of_freedom == clusters.kinds[0].freedom == 3 * len(masses) - len(pairs)


def kind(masses, pairs, lengths):
    return ClusterKind(np.arange(len(masses))[None], np.array(masses), np.array(pairs), np.array(lengths))


def test_redundant_constraints_are_named():
    """Methane with its bonds and its H-H distances: ten constraints for nine internal coordinates."""
    every = [(i, j) for i in range(5) for j in range(i)]
    with pytest.raises(ValueError, match=r"follows from the others of the cluster of particles 0, 1, 2, 3, 4: remove"):
        kind([12.0, 1.0, 1.0, 1.0, 1.0], every, len(every) * [0.15])
    with pytest.raises(ValueError, match="constraint of particles 1 and 0 follows"):
        kind([12.0, 1.0], [(0, 1), (1, 0)], [0.1, 0.1])


@pytest.mark.parametrize(
    ("masses", "pairs", "lengths", "sentence"),
    [
        ([12.0, 0.0], [(0, 1)], [0.1], "particle 1 .* has the mass 0: a constraint needs masses at both ends"),
        ([12.0, 1.0], [(0, 1)], [0.0], "constraint of particles 0 and 1 to 0 nm cannot be kept"),
        ([12.0, 1.0], [(0, 1)], [np.nan], "to nan nm cannot be kept"),
        ([12.0, 1.0], [(1, 1)], [0.1], "needs two particles"),
        ([12.0, 1.0], [(0, 1)], [0.1, 0.1], "do not belong to one kind"),
        ((LARGEST + 2) * [1.0], [(k, k + 1) for k in range(LARGEST + 1)], (LARGEST + 1) * [0.1], "constraints=HBonds"),
    ],
)
def test_graphs_that_cannot_be_held_are_refused_with_a_reason(masses, pairs, lengths, sentence):
    with pytest.raises(ValueError, match=sentence):
        kind(masses, pairs, lengths)


def test_a_triangle_on_a_line_is_a_singular_place(kernel):
    clusters = find_clusters([12.0, 16.0, 16.0], [(0, 1), (0, 2), (1, 2)], [0.12, 0.12, 0.24], kernel)
    x = np.array([[0.0, 0.0, 0.0], [0.12, 0.0, 0.0], [-0.12, 0.0, 0.0]])
    with pytest.raises(ValueError, match="The cluster of particles 0, 1, 2 is at a singular place"):
        clusters.fit(x, np.zeros((3, 3)))


def test_places_that_miss_the_constraints_are_refused(kernel):
    masses, pairs, x = constrained_clusters.CLUSTERS["XH3"]
    clusters = find_clusters(masses, pairs, constrained_clusters.lengths_of(pairs, x), kernel)
    with pytest.raises(ValueError, match=r"missed by 0\.011 nm, .* call context.applyConstraints"):
        clusters.fit(1.1 * x, np.zeros(x.shape))
    with pytest.raises(ValueError, match="not finite"):
        clusters.fit(np.where(x == x[1], np.nan, x), np.zeros(x.shape))
