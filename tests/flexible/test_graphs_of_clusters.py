"""Clusters of any size and graph move in kernels as on the host, with tables for each graph and not each cluster."""

import pytest

from both_engines import apart, maker, pair
from graphs import GRAPHS, chain, comb, system_of
from openmm_exactrb.constraints import tables as constraints
from openmm_exactrb.constraints.tables import Group
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines.native.flexible.blocks import blocks_of
from openmm_exactrb.engines.native.flexible.molecules import LARGEST, require_small_clusters
from openmm_exactrb.errors import NotServedError
from peptides import violations
from places import WHERE
from products import spread_over
from starts import held

pytestmark = pytest.mark.library


@spread_over({"scheme": ["S2_2", "S6_10"], "where": WHERE}, indirect=["where"])
def test_clusters_of_all_graphs_move_as_on_the_host(scheme, where):
    system, x = system_of(GRAPHS.values())
    make = maker(scheme, 0.002)
    contexts = pair(system, x, make, platform=where[1])
    for context in contexts:
        context.getIntegrator().step(10)
    assert contexts[1].getIntegrator().getEngine() == "native"
    assert apart(*contexts) < {"native": 1e-13, "Reference": 1e-14}[where[0]]
    length, slip = violations(system, *held(contexts[1]))
    assert length < 1e-14
    assert slip < 1e-13


def arrays_of(graphs):
    """Return the kernel's arrays of clusters by name."""
    system, x = system_of(graphs)
    groups = [Group(kind.particles, kind.graph) for kind in find_bodies(system, x, pairs=True).clusters.kinds]
    blocks = blocks_of(groups, [], len(x))
    return constraints.arrays(blocks.starts, blocks.sizes, blocks.groups)[0]


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
