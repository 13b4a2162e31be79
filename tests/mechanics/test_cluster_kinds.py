"""What a cluster is: kinds are found from constraints, and graphs that cannot be held are refused in one sentence."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.constraints import clusters as constrained_clusters
from openmm_exactrb.constraints.clusters import LARGEST, ClusterKind, sorted_into_kinds

STAR = np.array([(0, 1), (2, 0), (0, 3)])


def test_stars_are_of_one_kind_in_whatever_order_their_particles_stand():
    lengths = np.full(3, 0.1)
    one = ClusterKind(np.array([[0, 1, 2, 3], [8, 9, 10, 11]]), np.array([12.0, 1.0, 1.0, 2.0]), STAR, lengths)
    other = ClusterKind(
        np.array([[4, 5, 6, 7]]), np.array([1.0, 2.0, 12.0, 1.0]), np.array([(2, 1), (0, 2), (3, 2)]), lengths
    )
    clusters = sorted_into_kinds([one, other])
    assert [kind.particles.tolist() for kind in clusters.kinds] == [[[0, 1, 2, 3], [6, 4, 7, 5], [8, 9, 10, 11]]]


def test_stars_with_other_lengths_or_masses_are_of_another_kind():
    star = ClusterKind(np.arange(4)[None], np.array([12.0, 1.0, 1.0, 2.0]), STAR, np.full(3, 0.1))
    longer = replace(star, particles=star.particles + 4, lengths=np.array([0.1, 0.1, 0.11]))
    heavier = replace(star, particles=star.particles + 8, masses=np.array([14.0, 1.0, 1.0, 2.0]))
    assert len(sorted_into_kinds([star, longer, heavier]).kinds) == 3


@pytest.mark.parametrize("name", ["XH", "XH3", "chain", "ring"])
def test_constraints_take_freedom(name):
    masses, pairs, x = constrained_clusters.CLUSTERS[name]
    clusters = sorted_into_kinds(
        [constrained_clusters.group_of(masses, pairs, constrained_clusters.lengths_of(pairs, x))]
    )
    assert clusters.degrees_of_freedom == clusters.kinds[0].freedom == 3 * len(masses) - len(pairs)


def kind(masses, pairs, lengths):
    group = ClusterKind(np.arange(len(masses))[None], np.array(masses), np.array(pairs), np.array(lengths))
    return sorted_into_kinds([group]).kinds[0]


def test_redundant_constraints_are_named():
    """Methane with its bonds and its H-H distances: ten constraints for nine internal coordinates."""
    every = [(i, j) for i in range(5) for j in range(i)]
    with pytest.raises(ValueError, match=r"follows from the others .* 0, 1, 2, 3, 4: remove"):
        kind([12.0, 1.0, 1.0, 1.0, 1.0], every, len(every) * [0.15])
    with pytest.raises(ValueError, match="constraint between particles 0 and 1 follows"):
        kind([12.0, 1.0], [(0, 1), (1, 0)], [0.1, 0.1])


@pytest.mark.parametrize(
    ("masses", "pairs", "lengths", "sentence"),
    [
        ([12.0, 0.0], [(0, 1)], [0.1], "particle 1 .* has the mass 0"),
        ([12.0, 1.0], [(0, 1)], [0.0], "constraint of 0 nm between particles 0 and 1"),
        ([12.0, 1.0], [(0, 1)], [np.nan], "constraint of nan nm between particles 0 and 1 is invalid"),
        ([12.0, 1.0], [(1, 1)], [0.1], "needs two different particles"),
        ((LARGEST + 2) * [1.0], [(k, k + 1) for k in range(LARGEST + 1)], (LARGEST + 1) * [0.1], "constraints=HBonds"),
    ],
)
def test_graphs_that_cannot_be_held_are_refused_with_a_reason(masses, pairs, lengths, sentence):
    with pytest.raises(ValueError, match=sentence):
        kind(masses, pairs, lengths)


def test_a_triangle_on_a_line_is_a_singular_place():
    triangle = kind([12.0, 16.0, 16.0], [(0, 1), (0, 2), (1, 2)], [0.12, 0.12, 0.24])
    x = np.array([[0.0, 0.0, 0.0], [0.12, 0.0, 0.0], [-0.12, 0.0, 0.0]])
    with pytest.raises(ValueError, match="particles 0, 1, 2 is in a singular configuration"):
        triangle.check_singular(x[None], np.array([True]))
    triangle.check_singular(x[None], np.array([False]))
