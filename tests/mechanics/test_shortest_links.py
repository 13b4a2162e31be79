"""The shortest links through bodies are those of a minimum spanning tree, whatever the shape and the box."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree

from openmm_exactrb.mechanics.images import image_gaps
from openmm_exactrb.mechanics.shortest_links import connected_within, shortest_links

SEEDS = st.integers(0, 2**32 - 1)


def scattered(rng, k):
    return rng.standard_normal((k, 3))


def flat(rng, k):
    return rng.standard_normal((k, 3)) * [1.0, 1.0, 0.0]


def straight(rng, k):
    return np.outer(rng.uniform(0.0, 3.0, k), [0.6, 0.0, 0.8])


def lattice(rng, k):
    """All distances of neighbours are equal."""
    return 0.3 * np.argwhere(np.ones((8, 8, 8)))[rng.permutation(512)[:k]]


def lumps(rng, k):
    """Groups of more particles than are looked through as neighbours, far apart."""
    return 4.0 * rng.standard_normal((k // 30 + 1, 3))[np.arange(k) // 30] + 0.1 * rng.standard_normal((k, 3))


def coincident(rng, k):
    return np.repeat(rng.standard_normal((k // 3 + 1, 3)), 3, axis=0)[:k]


SHAPES = scattered, flat, straight, lattice, lumps, coincident
BOXES = None, 4.0 * np.eye(3), np.array([[5.0, 0.0, 0.0], [1.5, 4.0, 0.0], [-2.0, 1.8, 6.0]])


def tree_lengths(x, box):
    """Return the sorted lengths of the links of the tree, from all distances of all images.

    Of images next to each other: in these boxes, others are farther away than half a diagonal.
    """
    gap = x[:, None] - x[None]
    offered = [np.zeros(3)] if box is None else np.array(list(itertools.product((-1, 0, 1), repeat=3))) @ box
    gap -= 0.0 if box is None else np.round(gap @ np.linalg.inv(box)) @ box
    distances = np.min([np.linalg.norm(gap + offset, axis=2) for offset in offered], axis=0)
    found = minimum_spanning_tree(distances + 1.0).data - 1.0  # scipy takes a zero for a missing link
    return np.sort(found)


@pytest.mark.parametrize("box", BOXES, ids=["free", "cube", "slanted"])
@pytest.mark.parametrize("shape", SHAPES)
@settings(max_examples=6, deadline=None)
@given(SEEDS)
def test_the_links_contain_a_minimum_spanning_tree_of_each_body(shape, box, seed):
    rng = np.random.default_rng(seed)
    n, k = rng.integers(1, 4), rng.integers(2, 160)
    X = np.array([shape(rng, k) + rng.uniform(-5.0, 5.0, 3) for _ in range(n)])
    links, shifts = shortest_links(X, box)
    gap = X.reshape(-1, 3)[links.pairs[:, 1]] - X.reshape(-1, 3)[links.pairs[:, 0]]
    gap += 0.0 if box is None else shifts @ box
    np.testing.assert_allclose(np.linalg.norm(gap, axis=1), links.lengths, rtol=0.0, atol=1e-13)
    gaps, _ = image_gaps(X, box)
    for own, x in zip(gaps, X, strict=True):
        np.testing.assert_allclose(np.sort(own), tree_lengths(x, box), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("shape", SHAPES)
@settings(max_examples=15, deadline=None)
@given(SEEDS)
def test_bodies_count_as_connected_only_by_links_of_given_lengths(shape, seed):
    """And do so if their gaps are much shorter."""
    rng = np.random.default_rng(seed)
    n, k = rng.integers(1, 5), rng.integers(1, 160)
    X = np.array([shape(rng, k) + rng.uniform(-5.0, 5.0, 3) for _ in range(n)])
    longest = image_gaps(X, None)[0].max(axis=1, initial=0.0)
    within = (longest + 1e-3) * rng.uniform(-0.2, 8.0, n)
    found = connected_within(X, within)
    assert not found[within < longest * (1.0 - 1e-12)].any()
    assert found[within > 3.5 * (longest + 1e-3)].all()


@pytest.mark.parametrize("box", BOXES, ids=["free", "cube", "slanted"])
def test_links_up_to_a_length_leave_wider_gaps_infinite(box, rng):
    X = np.array([lumps(rng, 90), lumps(rng, 90)])
    every, some = (np.sort(image_gaps(X, box, within)[0], axis=1) for within in (np.inf, 0.5))
    np.testing.assert_allclose(some, np.where(every <= 0.5, every, np.inf), rtol=0.0, atol=1e-13)
    assert np.isinf(some).any()
    assert image_gaps(X[:0], box)[0].shape == (0, 89)


def test_a_body_of_many_particles_is_linked_in_its_order(rng):
    """A random walk of 50 000 steps, whose tree is known where the steps are short against its folds: a line."""
    x = np.outer(np.cumsum(rng.uniform(0.01, 0.02, 50_000)), [2.0, 3.0, 6.0]) / 7.0
    gaps, _ = image_gaps(x[None], None)
    np.testing.assert_allclose(gaps[0], np.linalg.norm(np.diff(x, axis=0), axis=1), rtol=0.0, atol=1e-12)
