"""What a cluster is: kinds are found from constraints, and graphs that cannot be held are refused in one sentence."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.constraints import clusters as constrained_clusters
from openmm_exactrb.constraints.clusters import ClusterKind, sorted_into_kinds

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
