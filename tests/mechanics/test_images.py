"""Linked particles that a periodic box has split are put together, however long the bodies are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from openmm_exactrb.mechanics.bodies import Kind, RigidBodies
from openmm_exactrb.mechanics.images import Shapes, half_width, image_gaps, joined, shortest_trees
from openmm_exactrb.mechanics.links import Links

CUBE = np.eye(3)
SLANTED = np.array([[1.0, 0.0, 0.0], [0.2, 1.0, 0.0], [-0.1, 0.3, 1.0]])
SEEDS = st.integers(0, 2**32 - 1)


def random_box(rng):
    """Return vectors in the reduced form that OpenMM asks for."""
    edges = rng.uniform(0.8, 1.5, 3)
    slants = rng.uniform(-0.5, 0.5, 3)
    return np.array(
        [[edges[0], 0, 0], [slants[0] * edges[0], edges[1], 0], [slants[1] * edges[0], slants[2] * edges[1], edges[2]]]
    )


def wrapped(x, box):
    return x - np.floor(x @ np.linalg.inv(box)) @ box


def apart(x):
    return np.linalg.norm(x[:, None] - x[None], axis=2)


def chain(rng, steps, longest):
    directions = rng.standard_normal((steps, 3))
    steps = rng.uniform(0.2, 1.0, (steps, 1)) * longest * directions / np.linalg.norm(directions, axis=1)[:, None]
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]) + rng.uniform(-1.0, 1.0, 3)


@given(SEEDS)
def test_a_chain_is_joined_along_its_links_wherever_it_is_split(seed):
    """It may be longer than the box, and any two of its particles may be near to images of each other."""
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    x = chain(rng, 12, 0.9 * half_width(box))
    order = rng.permutation(13)
    pairs = np.column_stack([order[:-1], order[1:]])
    whole = np.empty_like(x)
    whole[order] = x
    links = Links(pairs, np.linalg.norm(whole[pairs[:, 0]] - whole[pairs[:, 1]], axis=1), 13)
    assert joined(whole, links, box) is whole
    y = joined(wrapped(whole, box), links, box)
    np.testing.assert_allclose(y - y[0], whole - whole[0], rtol=0.0, atol=5e-15)


def body_of(sites, masses):
    """Return bodies of one shape whose particles are as many as the sites."""
    centred = sites - masses @ sites / masses.sum()
    moments, axes = np.linalg.eigh(
        np.einsum("s,sij->ij", masses, [(r @ r) * np.eye(3) - np.outer(r, r) for r in centred])
    )
    kind = Kind(
        np.arange(len(sites))[None], slice(0, 1), masses, (centred @ axes)[None], float(masses.sum()), moments[None]
    )
    return RigidBodies([kind], len(sites))


@given(SEEDS, st.integers(3, 8), st.sampled_from([0.3, 0.8, 1.6, 2.5]))
def test_a_known_shape_is_found_again_whatever_its_size(seed, count, size):
    """Sizes in units of the smallest distance between sides of the box: gaps may be wider than half of it, or all."""
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    x = 2.0 * half_width(box) * size * rng.uniform(-0.5, 0.5, (count, 3)) + rng.uniform(-1.0, 1.0, 3)
    shapes = Shapes(body_of(x, rng.uniform(1.0, 2.0, count)))
    assert shapes.whole(x, box) is x
    y = shapes.whole(wrapped(x, box), box)
    np.testing.assert_allclose(apart(y), apart(x), rtol=0.0, atol=5e-15)
    scattered = x + rng.integers(-1, 2, x.shape) @ box
    z = shapes.whole(scattered, box)
    np.testing.assert_allclose(apart(z), apart(x), rtol=0.0, atol=1e-14)


def test_a_rod_of_half_the_box_stays_where_it_is_and_is_refused_where_two_images_suit_it():
    shapes = Shapes(body_of(np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]), np.ones(2)))
    whole = np.array([[0.1, 0.2, 0.3], [0.6, 0.2, 0.3]])
    assert shapes.whole(whole, CUBE) is whole
    with pytest.raises(ValueError, match="the group of particles 0, 1, and two images fit equally well"):
        shapes.whole(whole + np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), CUBE)


def test_many_bodies_are_joined_each_by_itself():
    rng = np.random.default_rng(3)
    pairs = np.arange(3000).reshape(-1, 3)[:, [0, 1, 0, 2]].reshape(-1, 2)
    x = rng.uniform(0.0, 5.0, (1000, 1, 3)) + 0.1 * rng.standard_normal((1000, 3, 3)) / np.sqrt(3)
    x = x.reshape(-1, 3)
    links = Links(pairs, np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1), 3000)
    y = joined(wrapped(x, 5.0 * SLANTED), links, 5.0 * SLANTED).reshape(-1, 3, 3)
    x = x.reshape(-1, 3, 3)
    np.testing.assert_allclose(y - y[:, :1], x - x[:, :1], rtol=0.0, atol=1e-14)


@given(SEEDS, st.integers(2, 12))
def test_the_tree_through_a_body_has_the_least_total_length(seed, count):
    from scipy.sparse.csgraph import minimum_spanning_tree

    x = np.random.default_rng(seed).standard_normal((count, 3))
    (tree,) = shortest_trees(x[None])
    length = np.linalg.norm(x[tree[:, 0]] - x[tree[:, 1]], axis=1).sum()
    assert length == pytest.approx(minimum_spanning_tree(apart(x)).sum(), rel=3e-15)


@pytest.mark.parametrize("box", [CUBE, SLANTED])
@settings(max_examples=20)
@given(SEEDS)
def test_gaps_across_a_box_are_those_of_what_it_has_split(box, seed):
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.02, 0.16, (6, 1)) * [1.0, 0.2, 0.1], axis=0) + rng.uniform(0.0, 1.0, 3)
    x = x[rng.permutation(6)]
    split = wrapped(x, box)
    (gaps,), (shifts,) = image_gaps(split[None], box)
    own, _ = image_gaps(x[None], None)
    assert gaps.max() <= own.max() + 1e-12
    if np.ptp(x @ np.linalg.inv(box), axis=0).max() + 0.2 < 1.0:  # its ends are not nearer to each other's images
        y = split + shifts @ box
        np.testing.assert_allclose(y - y[0], x - x[0], rtol=0.0, atol=2e-15)
