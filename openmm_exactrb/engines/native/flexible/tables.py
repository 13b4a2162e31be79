"""Tables for the kernel: blocks, their atoms and clusters, and the terms that involve these atoms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.engines.native.flexible import expressions
from openmm_exactrb.engines.native.flexible.blocks import Blocks
from openmm_exactrb.engines.native.flexible.expressions import Custom
from openmm_exactrb.multiple_time_steps.terms import EXACT, Terms, kinds_of
from openmm_exactrb.support.types import Indices


class Copies(NamedTuple):
    """Copies of terms, one for each block that a term involves: `terms` (C,), `block` (C,) and `atoms` (C, k)."""

    terms: Indices
    block: Indices
    atoms: Indices


class Local(NamedTuple):
    """The atoms (p,) that each block reads, its own atoms first, and the start of each block's atoms (b + 1,)."""

    atoms: Indices
    first: Indices


def _distinct(keys: Indices) -> Indices:
    """Return the distinct keys in ascending order; np.unique, which hashes the keys, is slower."""
    keys = np.sort(keys)
    return np.asarray(keys[np.append(True, keys[1:] != keys[:-1])[: len(keys)]])


def copies(particles: Indices, blocks: Blocks) -> Copies:
    """Return copies of terms of particles (T, k), ordered by block: one copy for each block that a term involves."""
    atoms = blocks.atom_of[particles]
    block, number, count = blocks.block_of[atoms], np.arange(len(atoms)), max(len(atoms), 1)
    crosses = (block != block[:, :1]).any(axis=1)
    of_several = _distinct((block[crosses] * count + number[crosses, None]).ravel())
    keys = np.sort(np.concatenate([block[~crosses, 0] * count + number[~crosses], of_several]))
    return Copies(keys % count, keys // count, atoms[keys % count])


def local(blocks: Blocks, found: list[Copies]) -> Local:
    """Return the atoms that each block reads: its own atoms, and atoms of other blocks that its terms involve."""
    n = len(blocks.particles)
    keys = [np.zeros(0, int)]
    for of_kind in found:
        foreign = blocks.block_of[of_kind.atoms] != of_kind.block[:, None]
        keys.append((of_kind.block[:, None] * n + of_kind.atoms)[foreign])
    partners = _distinct(np.concatenate(keys))
    block = np.concatenate([blocks.block_of, partners // n])
    order = np.argsort(block, kind="stable")  # a block's own atoms stay first
    atoms = np.concatenate([np.arange(n), partners % n])[order]
    return Local(atoms, np.searchsorted(block[order], np.arange(len(blocks) + 1)))


def places(found: Copies, blocks: Blocks, room: Local) -> Indices:
    """Return the index (C, k) of each atom of a term among the atoms that its block reads."""
    n, own = len(blocks.particles), np.diff(blocks.first_atom)
    block = np.repeat(np.arange(len(blocks)), np.diff(room.first))
    within = np.arange(len(room.atoms)) - room.first[block]
    partner = within >= own[block]
    keys, of_keys = (block * n + room.atoms)[partner], within[partner]
    wanted = found.block[:, None] * n + found.atoms
    there = np.searchsorted(keys, wanted)
    by_key = np.append(of_keys, 0)[np.minimum(there, len(of_keys))]
    inside = blocks.block_of[found.atoms] == found.block[:, None]
    return np.where(inside, found.atoms - blocks.first_atom[found.block][:, None], by_key)


def arrays(
    terms: Terms, blocks: Blocks, precision: type[np.floating], customs: Sequence[Custom] = ()
) -> tuple[dict[str, NDArray[Any]], dict[str, int]]:
    """Return the kernel's arrays of terms and blocks by name, and the constants with which the kernel is compiled."""
    kinds = kinds_of(terms, precision)
    found = {name: copies(kind.particles, blocks) for name, kind in kinds.items()}
    of_customs = [copies(custom.particles, blocks) for custom in customs]
    room = local(blocks, [*found.values(), *of_customs])
    constants = {"BLOCKS": len(blocks), "PLACES_IN_ALL": len(room.atoms), "HARMONICS": terms.of_torsions.shape[1]}
    constants["PLACES_OF_BLOCK"] = int(np.diff(room.first).max(initial=1))
    constants["OWN_OF_BLOCK"] = int(np.diff(blocks.first_atom).max(initial=1))
    members, numbers, exact = [np.zeros(0, int)], [np.zeros(0)], [np.zeros(0)]
    table = [blocks.first_cluster[:-1], np.diff(blocks.first_cluster), room.first[:-1], np.diff(room.first)]
    table.append(np.diff(blocks.first_atom))
    for name, kind in kinds.items():
        which, own = found[name], exact if name in EXACT else numbers
        constants |= {
            name.upper(): len(which.terms),
            f"MEMBERS_OF_{name.upper()}": sum(map(len, members)),
            f"NUMBERS_OF_{name.upper()}": sum(map(len, own)),
        }
        members += [places(which, blocks, room).T.ravel(), kind.others[:, which.terms].ravel()]
        own.append(kind.numbers[:, which.terms].ravel())
        first = np.searchsorted(which.block, np.arange(len(blocks) + 1))
        table += [first[:-1], first[1:]]
    constants["PATCHES"] = sum(map(len, exact))
    exact.append(terms.patches.ravel())
    parameters = expressions.parameters_of(customs)
    heads, starts, steps = list[Any](), list[Any](), list[Any]()
    for custom, which in zip(customs, of_customs, strict=True):
        head = [custom.particles.shape[1], len(which.terms), sum(map(len, members)), sum(map(len, exact))]
        members.append(places(which, blocks, room).T.ravel())
        exact.append(custom.numbers[:, which.terms].ravel())
        rows, values = expressions.rows(custom, list(parameters), sum(map(len, exact)))
        exact.append(values)
        heads += [*head, sum(map(len, steps)) // rows.shape[1], len(rows)]
        starts += np.searchsorted(which.block, np.arange(len(blocks) + 1)).tolist()
        steps.append(rows.ravel())
    constants |= {
        "CUSTOMS": len(customs),
        "STARTS_OF_CUSTOMS": len(heads),
        "STEPS_OF_CUSTOMS": len(heads) + len(starts),
    }
    made = {
        "blocks": np.stack(table, axis=1).astype(np.int32),
        "block_atoms": room.atoms.astype(np.int32),
        "members": np.concatenate(members).astype(np.int32),
        "constants": np.concatenate(numbers).astype(precision),
        "exact": np.concatenate(exact),
        "customs": np.concatenate([np.array(heads + starts, dtype=int), *steps]).astype(np.int32),
        "parameters": np.array([*parameters.values()], dtype=float),
    }
    return made, constants
