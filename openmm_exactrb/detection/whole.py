"""Positions of a System in which split molecules are joined along constraints and bonds, or to a known shape.

The positions define the shapes of the bodies passed as `bodies`. If neither constraints, bonds nor bodies with the same
masses determine how to join the parts of such a body, its positions are used unchanged, or a ValueError is raised if
there is evidence that the box has split the body.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.errors import ShapeWarning
from openmm_exactrb.mechanics.fit import RIGIDITY, congruent
from openmm_exactrb.mechanics.images import (
    Decided,
    braced,
    decided,
    half_width,
    image_gaps,
    joined,
    lattice,
)
from openmm_exactrb.mechanics.links import Links
from openmm_exactrb.mechanics.shortest_links import connected_within
from openmm_exactrb.openmm_access import parameters
from openmm_exactrb.openmm_access.parameters import TermRows
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array, Indices
from openmm_exactrb.support.warn import warn

# Two gaps differ if the ratio of the shorter to the longer is below this number.
_SHORTER = 1.0 - 1e-6
# A body counts as split if its parts fit together with a gap of at most this multiple of the longest gap within a part.
_FITTING = 2.0
# A gap below this fraction of `half_width` has no other image of similar length.
_CLEAR = 0.5
# Distances that differ by less than the first number (nm) count as equal. Shapes may differ by up to the second number
# (nm), because files contain rounded positions.
_COMMON, _ROUNDED = 1e-6, 2e-3
# Number of bodies that are compared to find their common distances.
_COMPARED = 4


def molecular_links(system: openmm.System, molecule: Indices) -> Links:
    """Return links along constraints and bonds, and further links within molecules.

    `molecule` (n_particles,) contains the index of each particle's molecule. Further links join each virtual site to a
    particle on which the site depends, and other separate parts of a molecule to its first particle, at the nearest
    image.
    """
    pairs, lengths = _with_bonds(system, parameters.constraints(system))
    n = len(molecule)
    sites = [(system.getVirtualSite(i).getParticle(0), i) for i in range(n) if system.isVirtualSite(i)]
    pairs = np.concatenate([pairs, np.array(sites, dtype=np.intp).reshape(-1, 2)])
    lengths = np.concatenate([lengths, np.full(len(sites), np.nan)])
    parts = np.unique(Links(pairs, lengths, n).component, return_index=True)[1]
    first = np.unique(molecule, return_index=True)[1][molecule]
    rest = np.column_stack([first, np.arange(n)])[parts[parts != first[parts]]]
    return Links(np.concatenate([pairs, rest]), np.concatenate([lengths, np.full(len(rest), np.nan)]), n)


def _with_bonds(system: openmm.System, held: TermRows) -> TermRows:
    """Return the particles (m, 2) of constraints and bonds, and their lengths (m,) in nm, nan if unknown."""
    pairs, lengths = [held[0]], [held[1]]
    for force in system.getForces():
        if isinstance(force, openmm.HarmonicBondForce | openmm.CustomBondForce):
            particles, numbers = parameters.terms(force)
            pairs.append(particles)
            known = isinstance(force, openmm.HarmonicBondForce)  # a formula may have no rest length
            lengths.append(numbers[:, 0] if known else np.full(len(particles), np.nan))
    return np.concatenate(pairs), np.concatenate(lengths)


def whole_positions(
    system: openmm.System, x: Array, masses: Array, named: list[Indices], box: Array | None, held: TermRows
) -> Array:
    """Return positions (n_particles, 3) in which constrained clusters and bodies named by the user are whole.

    ``held`` contains the constraints of the System.

    Raises
    ------
    ValueError
        If the box has split a named body, and the positions of its parts are ambiguous.

    Warns
    -----
    ShapeWarning
        If the box has probably split a named body.
    """
    if box is None:
        return x
    if not named:
        return joined(x, Links(*held, len(x)), box)
    (pairs, lengths), owner = _with_bonds(system, held), checks.owners(named, len(x))
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
    """Raise ValueError for a bond within a named body if no image has its length."""
    i, j = links.pairs.T
    (bad,) = np.nonzero(found.doubtful & (owner[i] >= 0) & (owner[i] == owner[j]))
    if not len(bad):
        return
    p, q = links.pairs[bad[0]]
    gap = x[q] - x[p]
    nearest = np.linalg.norm(gap - np.round(gap @ np.linalg.inv(box)) @ box)
    raise ValueError(
        f"particles {p} and {q} of body {owner[p]} are {np.linalg.norm(gap):.3g} nm apart as given, or {nearest:.3g} "
        "nm across the periodic box, but neither distance is the length of their bond: set the length of this bond in "
        "the HarmonicBondForce to their distance in the whole body"
    )


def _check_split_parts(links: Links, moved: NDArray[np.bool_], named: list[Indices], loose: list[int]) -> None:
    """Raise ValueError for a body of several parts if the box has split one part."""
    for number in loose:
        body = named[number]
        if moved[body].any():
            p, q = (body[np.argmax(links.component[body] == part)] for part in np.unique(links.component[body])[:2])
            raise ValueError(
                f"the periodic box has split body {number}, and neither bonds nor constraints join its particles {p} "
                f"and {q}: {_REMEDY}"
            )


_REMEDY = (
    "set positions in which the box splits no body, or join the particles of each body by bonds whose lengths are the "
    "distances within the body, such as bonds of a HarmonicBondForce with k = 0"
)


def _loose_whole(x: Array, masses: Array, bodies: list[Indices], numbers: list[int], box: Array, split: bool) -> Array:
    """Return positions in which bodies without links are whole, if bodies with the same masses define their shape.

    ``split`` states whether the box has split other molecules.
    """
    same: dict[bytes, list[int]] = {}
    for place, body in enumerate(bodies):
        same.setdefault(masses[body].tobytes(), []).append(place)
    y, doubtful = x, []
    for places in same.values():
        particles = np.stack([bodies[place] for place in places])
        X, known = _by_common_shape(x[particles], box)
        if not np.array_equal(X, x[particles]):
            y, split = y.copy() if y is x else y, True
            y[particles] = X
        doubtful += [(numbers[places[row]], X[row]) for row in np.flatnonzero(~known)]
    for number, X in doubtful:
        _say(number, X, box, split)
    return y


class _Gaps:
    """Gaps between the particles of bodies (n, k, 3), as given and across a box, and the bodies at nearest images."""

    def __init__(self, X: Array, box: Array) -> None:
        self._X, self._box = X, box
        inverse = np.linalg.inv(box)
        extents = np.ptp(X @ inverse, axis=1)
        # Other bodies are not split: images are farther from each other than the particles of a body.
        self._wide = np.asarray(extents.max(axis=1) > 0.5)
        images = ((1.0 - extents[self._wide]) / np.linalg.norm(inverse, axis=0)).min(axis=1)
        self._wide[self._wide] = ~connected_within(X[self._wide], _SHORTER * images)

    def given(self, within: float = np.inf) -> Array:
        """Return the gaps (n, k - 1) in the minimum spanning trees of the bodies; see `image_gaps`."""
        return image_gaps(self._X, None, within)[0]

    @cached_property
    def across(self) -> Array:
        """The longest gap (n,) in the minimum spanning tree of the nearest images of each body."""
        across = np.empty(len(self._X))
        across[self._wide] = self._nearest[0].max(axis=1)
        across[~self._wide] = image_gaps(self._X[~self._wide], None)[0].max(axis=1)
        return across

    @cached_property
    def near(self) -> Array:
        """The bodies (n, k, 3), joined along the trees of nearest images."""
        near = self._X.copy()
        near[self._wide] += self._nearest[1] @ self._box
        return near

    @cached_property
    def torn(self) -> NDArray[np.bool_]:
        """A mask (n,) of the bodies whose longest gap is shorter across the box."""
        torn = (self.near != self._X).any(axis=(1, 2))
        if torn.any():
            across = self.across[torn]
            torn[torn] = across < _SHORTER * image_gaps(self._X[torn], None, float(across.max()))[0].max(axis=1)
        return np.asarray(torn)

    @cached_property
    def _nearest(self) -> tuple[Array, Array]:
        return image_gaps(self._X[self._wide], self._box)


def _by_common_shape(X: Array, box: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return bodies (n, k, 3) of equal masses, with split bodies joined, and a mask (n,) of bodies confirmed by others.

    If images of the particles give all bodies a common shape, the bodies are joined to this shape. Otherwise bodies
    whose nearest images have the shape of a whole body are joined.
    """
    if len(X) == 1 or X.shape[1] == 1:
        return X, np.full(len(X), X.shape[1] == 1)
    gaps = _Gaps(X, box)
    confirmed, relative = np.ones(len(X), dtype=bool), X - X[:, :1]
    if congruent(X[:1], X).all():
        return X, ~gaps.torn if np.ptp(relative, axis=0).max() <= RIGIDITY else confirmed
    near, torn = gaps.near, gaps.torn
    clear = _CLEAR * half_width(box)
    if not torn.any() and (connected_within(X, np.full(len(X), clear)).all() or (gaps.given(clear) <= clear).all()):
        return X, confirmed
    apart = (relative - relative[0]) @ np.linalg.inv(box)
    if np.abs(apart - np.round(apart)).max() <= RIGIDITY / half_width(box):  # all have the same orientation
        longest = gaps.across[0]
        if longest > clear:
            raise ValueError(
                f"the shapes of bodies of {len(near[0])} particles with the same masses differ by widths of the "
                f"periodic box, and a gap of at least {longest:.3g} nm within a body makes it unclear which shape is "
                "whole: " + _REMEDY
            )
        return _joined_to(near[0], X, box), confirmed
    if congruent(near[:1], near).all():
        return near, confirmed
    common = _common_images(X, box)
    joint = _joined_to(common, X, box)
    if congruent(common[None], joint).all():
        return joint, confirmed
    whole = X[None, np.argmin(torn)]
    fits = torn & ~torn.all() & ~congruent(whole, X, _ROUNDED) & congruent(whole, near, _ROUNDED)
    return np.where(fits[:, None, None], near, X), fits | ~torn & congruent(whole, X, _ROUNDED)


def _common_images(X: Array, box: Array) -> Array:
    """Return the first body (k, 3), at images whose distances from its first particle also occur in other bodies."""
    shape, offered = np.array(X[0]), lattice(2) @ box
    for place in range(1, len(shape)):
        gaps = (X[:_COMPARED, place] - X[:_COMPARED, 0])[:, None] + offered
        lengths = np.linalg.norm(gaps, axis=2)
        missed = np.abs(lengths[0, :, None] - lengths[1:, None]).min(axis=2).max(axis=0)
        if missed.min() > _COMMON:
            return np.asarray(X[0])
        shape[place] = X[0, 0] + gaps[0, np.argmin(missed)]
    return shape


def _joined_to(shape: Array, X: Array, box: Array) -> Array:
    """Return bodies (n, k, 3) at the images that match a shape (k, 3); unchanged if several images match."""
    n, k, _ = X.shape
    (within,) = braced(shape[None])
    lengths = np.linalg.norm(shape[within[:, 0]] - shape[within[:, 1]], axis=1)
    pairs = (np.arange(n)[:, None, None] * k + within).reshape(-1, 2)
    try:
        y = joined(X.reshape(-1, 3), Links(pairs, np.tile(lengths, n), n * k), box)
    except ValueError:
        return X
    return np.asarray(y.reshape(X.shape))


def _say(number: int, X: Array, box: Array, split: bool) -> None:
    """Raise ValueError or warn if the periodic box may have split a body (k, 3)."""
    gaps = _Gaps(X[None], box)
    torn, clear, in_cell = bool(gaps.torn[0]), _CLEAR * half_width(box), _in_cell(X, box)
    if not torn and not (split and in_cell and np.linalg.norm(np.ptp(X, axis=0)) > clear):
        return
    (steps,), (across,) = gaps.given(), gaps.across
    given = steps.max(initial=0.0)
    if split and (torn or across > clear):
        raise ValueError(
            f"the periodic box has split molecules, and the shape of body {number} is ambiguous, because the gap of "
            f"{given:.3g} nm between its particles may be {across if torn else 4.0 * clear - given:.3g} nm across the "
            f"box: {_REMEDY}"
        )
    fitting = across <= _FITTING * steps[steps <= across * (1.0 + 1e-6)].max(initial=0.0)
    likely = (in_cell or given > 4.0 * clear) and (len(X) > 2 or across < clear)
    if torn and (fitting or likely):
        warn(
            f"body {number} has a gap of {given:.3g} nm between its particles as given, or of {across:.3g} nm across "
            f"the periodic box, and the positions are used as given: if the box has split this body, {_REMEDY}",
            ShapeWarning,
        )


def _in_cell(X: Array, box: Array) -> bool:
    """Return whether particles (k, 3) are individually wrapped into a cell with its corner or its centre at 0."""
    place = X @ np.linalg.inv(box)
    return any(((place > low - 1e-3) & (place < low + 1.0 + 1e-3)).all() for low in (0.0, -0.5))
