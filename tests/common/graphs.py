"""Constrained clusters of any graph."""

import numpy as np
import openmm


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
