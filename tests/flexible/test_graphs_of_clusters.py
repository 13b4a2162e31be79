"""Clusters of any size and graph move in kernels as on the host, with tables for each graph and not each cluster."""

import numpy as np
import openmm
import pytest
from zoo import apart, held, pair

import openmm_exactrb as rb
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines.native.flexible import constraints
from openmm_exactrb.engines.native.flexible.blocks import Group, blocks_of
from openmm_exactrb.engines.native.flexible.molecules import LARGEST, NotServedError, require_small_clusters
from peptides import violations

pytestmark = pytest.mark.library


def chain(n):
    return [(k - 1, k) for k in range(1, n)]


def ring(n):
    return [*chain(n), (0, n - 1)]


def comb(n, every):
    """Return a chain with a ring of six on some of its atoms."""
    pairs, last = chain(n), n - 1
    for k in range(0, n, every):
        pairs += [(a, last + 1 + j) for j, a in enumerate([k, *range(last + 1, last + 5)])] + [(k, last + 5)]
        last += 5
    return pairs


def tree(n, seed):
    """Return a tree in which each atom joins any of those before it."""
    rng = np.random.default_rng(seed)
    return [(int(rng.integers(k)), k) for k in range(1, n)]


#: Pairs of the atoms of a molecule, and the number of such molecules.
GRAPHS = {
    "chain of 3": (chain(3)[::-1], 2),
    "chain of 4": (chain(4), 3),
    "chain of 40": (chain(40), 2),
    "ring of 5": (ring(5), 3),
    "ring of 33": (ring(33), 1),
    "star of 6": ([(0, k) for k in range(1, 7)], 2),
    "star from the end": ([(k, 4) for k in range(4)], 2),
    "two rings with an edge in common": ([*ring(10), (2, 7)], 2),
    "cube": ([(i, i ^ bit) for i in range(8) for bit in (1, 2, 4) if i < i ^ bit], 1),
    "tree of 20": (tree(20, 3), 2),
    "comb of 210": (comb(60, 2), 1),
}


def places(pairs, rng):
    """Return positions of atoms, each 0.09 to 0.15 nm from one before it."""
    n = 1 + max(max(ends) for ends in pairs)
    x, placed = np.zeros((n, 3)), {0}
    while len(placed) < n:
        i, j = next(ends for ends in pairs if len(placed & set(ends)) == 1)
        old, new = (i, j) if i in placed else (j, i)
        direction = rng.standard_normal(3)
        x[new] = x[old] + rng.uniform(0.09, 0.15) * direction / np.linalg.norm(direction)
        placed.add(new)
    return x


def system_of(graphs, seed=2):
    """Return a System of molecules in a trap, and positions."""
    rng = np.random.default_rng(seed)
    system, trap = openmm.System(), openmm.CustomExternalForce("k*(x^2+2*y^2+3*z^2)")
    trap.addPerParticleParameter("k")
    positions = []
    for pairs, copies in graphs:
        x = places(pairs, rng)
        masses = rng.choice([1.0, 3.0, 12.0, 16.0], len(x))
        for _ in range(copies):
            first, shift = len(positions), rng.uniform(-1.0, 1.0, 3)
            for mass, place in zip(masses, x, strict=True):
                trap.addParticle(system.addParticle(mass), [rng.uniform(20.0, 200.0)])
                positions.append(place + shift)
            for i, j in pairs:
                system.addConstraint(first + i, first + j, float(np.linalg.norm(x[i] - x[j])))
    system.addForce(trap)
    return system, np.array(positions)


@pytest.mark.parametrize("scheme", ["S2_2", "S6_10"])
def test_clusters_of_all_graphs_move_as_on_the_host(scheme, where):
    system, x = system_of(GRAPHS.values())
    make = lambda engine: rb.ExactRigidBodyIntegrator(0.002, scheme, engine=engine)  # noqa: E731
    contexts = pair(system, x, make, platform=where[1])
    for context in contexts:
        context.getIntegrator().step(20)
    assert contexts[1].getIntegrator().getEngine() == "native"
    assert apart(*contexts) < {"native": 1e-13, "Reference": 1e-14}[where[0]]
    length, slip = violations(system, *held(contexts[1]))
    assert length < 1e-14
    assert slip < 1e-13


def arrays_of(graphs):
    """Return the kernel's arrays of clusters by name."""
    system, x = system_of(graphs)
    groups = [Group(kind.particles, kind.graph) for kind in find_bodies(system, x, pairs=True).clusters.kinds]
    return constraints.arrays(blocks_of(groups, [], len(x)))[0]


def test_memory_is_linear_in_constraints_and_copies_share_their_tables():
    chains = [arrays_of([(chain(n), 1)]) for n in (50, 100, 200)]
    for name in ("room", "graphs"):
        short, middle, long = (len(arrays[name]) for arrays in chains)
        assert long - middle == 2 * (middle - short)
    one, many = arrays_of([(comb(12, 3), 1)]), arrays_of([(comb(12, 3), 30)])
    assert len(many["graphs"]) == len(one["graphs"])
    assert len(many["room"]) == 30 * len(one["room"])


@pytest.mark.parametrize("name", GRAPHS)
def test_larger_clusters_are_refused_only_on_a_gpu(name):
    pairs, _ = GRAPHS[name]
    bodies = find_bodies(*system_of([GRAPHS[name]]), pairs=True)
    require_small_clusters(bodies, None)
    n = 1 + max(map(max, pairs))
    if n <= LARGEST:
        require_small_clusters(bodies, LARGEST)
    else:
        with pytest.raises(NotServedError, match=f"constraints join {n} atoms .* supports at most {LARGEST} on a GPU"):
            require_small_clusters(bodies, LARGEST)
