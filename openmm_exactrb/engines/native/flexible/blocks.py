"""The division of flexible molecules into blocks, each processed by one block of threads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from openmm_exactrb.constraints.tables import Group
from openmm_exactrb.support.types import Indices

#: The cost of a block is the number of memberships of its atoms in terms, about 30 per atom in a protein, plus this
#: number for each atom.
COST_OF_ATOM = 8
#: Molecules whose cost is at most the second number are not divided. Larger molecules are divided into blocks whose
#: cost is about the first number.
COST_OF_BLOCK, COST_OF_MOLECULE = 1200, 6400


@dataclass(frozen=True)
class Blocks:
    """The atoms of flexible molecules, ordered by block, and within a block by cluster.

    Attributes
    ----------
    particles : (n,) array
        The index in the System of each atom.
    atom_of : (n_particles,) array
        The index of each particle of the System among these atoms, or -1 for particles of other molecules.
    block_of : (n,) array
        The index of the block of each atom.
    starts, sizes : (c,) arrays
        The first atom and the number of atoms of each cluster.
    groups : list of (Group, (N,) array)
        The clusters with each graph, and their indices in the order of the blocks.
    first_cluster, first_atom : (b + 1,) arrays
        The first cluster and the first atom of each block; the last entry is the total number.
    """

    particles: Indices
    atom_of: Indices
    block_of: Indices
    starts: Indices
    sizes: Indices
    groups: list[tuple[Group, Indices]]
    first_cluster: Indices
    first_atom: Indices

    def __len__(self) -> int:
        """Return the number of blocks."""
        return len(self.first_atom) - 1


def blocks_of(groups: Sequence[Group], terms: Sequence[Indices], n_particles: int, divides: bool = True) -> Blocks:
    """Divide clusters into blocks of similar cost, such that few terms (., k) involve more than one block.

    Unless it `divides` large molecules, no term involves more than one block.
    """
    count = sum(len(group.particles) for group in groups)
    cluster_of, sizes, smallest = np.full(n_particles, -1), np.zeros(count, int), np.zeros(count, int)
    number: list[Indices] = []
    for group in groups:
        first = sum(map(len, number))
        number.append(np.arange(first, first + len(group.particles)))
        cluster_of[group.particles] = number[-1][:, None]
        sizes[number[-1]], smallest[number[-1]] = group.particles.shape[1], group.particles.min(axis=1)
    members = [cluster_of[particles] for particles in terms if particles.size]
    block = _divided(_costs(members, sizes), _molecules(members, count), smallest, divides)
    order = np.lexsort((smallest, sizes, block))
    rank = np.argsort(order)
    starts = np.cumsum([0, *sizes[order]])[:-1]
    particles, atom_of = np.zeros(int(sizes.sum()), int), np.full(n_particles, -1)
    ranked = [(group, rank[numbers]) for group, numbers in zip(groups, number, strict=True)]
    for group, clusters in ranked:
        particles[starts[clusters][:, None] + np.arange(group.particles.shape[1])] = group.particles
    atom_of[particles] = np.arange(len(particles))
    first_cluster = np.searchsorted(block[order], np.arange(block.max(initial=-1) + 2))
    first_atom = np.append(starts, len(particles))[first_cluster]
    return Blocks(
        particles,
        atom_of,
        np.repeat(block[order], sizes[order]),
        starts,
        sizes[order],
        ranked,
        first_cluster,
        first_atom,
    )


def _costs(members: Sequence[Indices], sizes: Indices) -> Indices:
    """Return the cost of each cluster: its number of memberships in terms, plus `COST_OF_ATOM` for each atom."""
    places = np.concatenate([np.zeros(0, int), *(of_kind.ravel() for of_kind in members)])
    return np.asarray(COST_OF_ATOM * sizes + np.bincount(places, minlength=len(sizes)))


def _molecules(members: Sequence[Indices], count: int) -> Indices:
    """Return the index of the molecule of each cluster, where clusters of a molecule are connected by terms."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = [np.stack([of_kind[:, 0], of_kind[:, k]]) for of_kind in members for k in range(1, of_kind.shape[1])]
    joined = np.concatenate([np.zeros((2, 0), int), *ends], axis=1)
    graph = coo_array((np.ones(joined.shape[1]), tuple(joined)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _divided(cost: Indices, molecule: Indices, smallest: Indices, divides: bool) -> Indices:
    """Return the index of the block of each cluster; a block contains whole molecules, or part of a large molecule.

    A molecule is divided in the order of its particles, which in a protein follows the chain.
    """
    total = np.bincount(molecule, cost).astype(int)
    large = total > (COST_OF_MOLECULE if divides else math.inf)
    first = np.full(len(total), smallest.max(initial=0))
    np.minimum.at(first, molecule, smallest)
    before = np.zeros(len(total), int)  # total cost of the small molecules that precede each molecule
    by_place = np.argsort(first)
    small = by_place[~large[by_place]]
    before[small] = np.cumsum(total[small]) - total[small]
    of_small = before // COST_OF_BLOCK
    parts = np.ceil(total / COST_OF_BLOCK).astype(int)
    order = np.lexsort((smallest, molecule))
    running = np.empty(len(cost), int)
    running[order] = np.cumsum(cost[order]) - cost[order]
    start = np.full(len(total), np.iinfo(int).max)
    np.minimum.at(start, molecule, running)
    part = (running - start[molecule]) * parts[molecule] // np.maximum(total[molecule], 1)
    key = np.where(large[molecule], part, of_small[molecule])
    label = np.where(large[molecule], first[molecule] + 1, 0) * (key.max(initial=0) + 1) + key
    return np.asarray(np.unique(label, return_inverse=True)[1], dtype=np.int64)
