"""Positions of a System with its molecules whole: joined along constraints and bonds, or to a shape that is known.

Bodies that a user named have the shape of their positions. Where nothing joins their parts, positions are taken as they
are; ValueError where something shows that the box has split them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.mathematics.quaternions import matrix, turned
from openmm_exactrb.mechanics.fit import RIGIDITY, ShapeWarning, best_attitudes
from openmm_exactrb.mechanics.images import Decided, decided, image_gaps, joined
from openmm_exactrb.mechanics.links import Links, shortest_tree
from openmm_exactrb.openmm_access import parameters
from openmm_exactrb.support.warn import warn

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Gaps differ if one is shorter than this part of the other.
_SHORTER = 1.0 - 1e-6
# A body counts as split if its parts fit together with a gap of at most this many times the longest within them.
_FITTING = 2.0


#: Pairs of particles (m, 2) and their distances (m,) in nm.
Constraints = tuple[Indices, Array]


def constraints(system: openmm.System) -> Constraints:
    """Return the particles (m, 2) of the constraints of a System, and their lengths (m,) in nm."""
    pairs, lengths = parameters.constraints(system)
    return pairs, lengths[:, 0]


def molecular_links(system: openmm.System, molecule: Indices) -> Links:
    """Return the constraints and bonds of a System, and what else joins particles (n_particles,) of one molecule.

    That is nearest images to a particle that a virtual site depends on, or to the first of the molecule.
    """
    pairs, lengths = _with_bonds(system, constraints(system))
    n = len(molecule)
    sites = [(system.getVirtualSite(i).getParticle(0), i) for i in range(n) if system.isVirtualSite(i)]
    pairs = np.concatenate([pairs, np.array(sites, dtype=np.intp).reshape(-1, 2)])
    lengths = np.concatenate([lengths, np.full(len(sites), np.nan)])
    parts = np.unique(Links(pairs, lengths, n).component, return_index=True)[1]
    first = np.unique(molecule, return_index=True)[1][molecule]
    rest = np.column_stack([first, np.arange(n)])[parts[parts != first[parts]]]
    return Links(np.concatenate([pairs, rest]), np.concatenate([lengths, np.full(len(rest), np.nan)]), n)


def _with_bonds(system: openmm.System, held: Constraints) -> Constraints:
    """Return the particles (m, 2) of constraints and bonds, and their lengths (m,) in nm or nan."""
    pairs, lengths = zip(held, *_bonds(system), strict=True)
    return np.concatenate(pairs), np.concatenate(lengths)


def _bonds(system: openmm.System) -> Iterator[Constraints]:
    """Yield the particles of the bonds of forces, and their lengths at rest in nm: nan of those by a formula."""
    for force in system.getForces():
        if isinstance(force, openmm.HarmonicBondForce):
            particles, numbers = parameters.terms(force)
            yield particles, numbers[:, 0]
        elif isinstance(force, openmm.CustomBondForce):
            particles, _ = parameters.terms(force)
            yield particles, np.full(len(particles), np.nan)


def whole_positions(
    system: openmm.System, x: Array, masses: Array, named: list[Indices], box: Array | None, held: Constraints
) -> Array:
    """Return positions (n_particles, 3) with clusters of constraints whole, and the bodies that a user named.

    ``held`` are the constraints of the System.

    Raises
    ------
    ValueError
        If the box has split a named body, and it is not known where its parts belong.

    Warns
    -----
    ShapeWarning
        If a named body may well be one that the box has split.
    """
    if box is None:
        return x
    if not named:
        return joined(x, Links(*held, len(x)), box)
    pairs, lengths = _with_bonds(system, held)
    owner = np.full(len(x), -1)
    for number, particles in enumerate(named):
        owner[particles] = number
    within = (owner[pairs] >= 0).all(axis=1) & (owner[pairs[:, 0]] == owner[pairs[:, 1]])
    links = Links(pairs, lengths, len(x), last=~within)
    found = decided(x, links, box)
    _check_doubtful_bonds(x, links, found, owner, box)
    y = joined(x, links, box, found)
    loose = [number for number, body in enumerate(named) if len(np.unique(links.component[body])) > 1]
    if not loose:
        return y
    split = y is not x
    if split:
        _check_split_parts(links, np.asarray((np.abs(y - x) > 0.0).any(axis=1)), named, loose)
    return _loose_whole(y, masses, [named[number] for number in loose], loose, box, split)


def _check_doubtful_bonds(x: Array, links: Links, found: Decided, owner: Indices, box: Array) -> None:
    """Raise ValueError for a bond within a named body of which no image has the length."""
    i, j = links.pairs.T
    (bad,) = np.nonzero(found.doubtful & (owner[i] >= 0) & (owner[i] == owner[j]))
    if not len(bad):
        return
    p, q = links.pairs[bad[0]]
    gap = x[q] - x[p]
    nearest = np.linalg.norm(gap - np.round(gap @ np.linalg.inv(box)) @ box)
    raise ValueError(
        f"particles {p} and {q} of body {owner[p]} are {np.linalg.norm(gap):.3g} nm apart as they are given and "
        f"{nearest:.3g} nm across the periodic box, and the length of their bond is neither: set the length in the "
        f"HarmonicBondForce to the distance in the body"
    )


def _check_split_parts(links: Links, moved: NDArray[np.bool_], named: list[Indices], loose: list[int]) -> None:
    """Raise ValueError for a body of several parts, one of which was split."""
    for number in loose:
        body = named[number]
        if moved[body].any():
            p, q = (body[np.argmax(links.component[body] == part)] for part in np.unique(links.component[body])[:2])
            raise ValueError(
                f"the periodic box has split body {number}, and neither bonds nor constraints join its particles {p} "
                f"and {q}: {_REMEDY}"
            )


_REMEDY = (
    "set positions in which it is whole, or join its particles by bonds of their lengths, such as those of a "
    "HarmonicBondForce with k = 0"
)


def _loose_whole(x: Array, masses: Array, bodies: list[Indices], numbers: list[int], box: Array, split: bool) -> Array:
    """Return positions with those bodies whole that nothing joins, where another of their masses shows their shape.

    ``split`` is whether the box has split other molecules.
    """
    same: dict[bytes, list[int]] = {}
    for place, body in enumerate(bodies):
        same.setdefault(masses[body].tobytes(), []).append(place)
    y = x
    for places in same.values():
        particles = np.stack([bodies[place] for place in places])
        X, shifts, fits = x[particles], np.zeros((*particles.shape, 3)), np.zeros(len(particles), dtype=bool)
        wide = np.ptp(X @ np.linalg.inv(box), axis=1).max(axis=1) > 0.5
        gaps = np.zeros((2, len(X)))
        gaps[0, wide], _ = image_gaps(X[wide], None)
        gaps[1, wide], shifts[wide] = image_gaps(X[wide], box)
        torn = gaps[1] < _SHORTER * gaps[0]
        if not torn.any():
            continue
        Y = X + np.where(torn[:, None, None], shifts, 0.0) @ box
        if not torn.all():
            shape = X[np.argmin(torn)]
            fits = torn & ~_congruent(shape, X) & _congruent(shape, Y)
        for row in np.flatnonzero(torn & ~fits):
            _say(numbers[places[row]], X[row], gaps[:, row], split)
        if fits.any():
            y = y.copy() if y is x else y
            y[particles[fits]] = Y[fits]
    return y


def _congruent(shape: Array, X: Array) -> NDArray[np.bool_]:
    """Return which bodies (n, k, 3) have a shape (k, 3) within `RIGIDITY`."""
    sites, relative = (a - a.mean(axis=-2, keepdims=True) for a in (shape[None], X))
    attitudes = matrix(best_attitudes(np.ones(len(shape)), sites, relative)).transpose(2, 0, 1)
    missed = relative - turned(np.ascontiguousarray(attitudes), sites)
    return np.asarray(np.sqrt((missed**2).sum(axis=2).max(axis=1)) <= RIGIDITY)


def _say(number: int, X: Array, gaps: Array, split: bool) -> None:
    """Raise ValueError, or warn, of a body that the periodic box may have split."""
    given, across = gaps
    if split:
        raise ValueError(
            f"the periodic box has split molecules, and body {number} has a gap of {given:.3g} nm that is "
            f"{across:.3g} nm across the box, so that its shape is ambiguous: {_REMEDY}"
        )
    steps = _steps(X)
    inner = steps[steps <= across * (1.0 + 1e-6)]
    if len(inner) and across <= _FITTING * inner.max():
        warn(
            f"body {number} has a gap of {given:.3g} nm and is taken as it is given, but would have no gap if the "
            f"periodic box had split it: if so, {_REMEDY}",
            ShapeWarning,
        )


def _steps(X: Array) -> Array:
    """Return the steps (k - 1,) on the way through a body (k, 3)."""
    return np.asarray(np.linalg.norm(np.diff(X[shortest_tree(X[None])], axis=1)[:, 0], axis=1))
