"""The splitting of an Ewald sum of dipoles for a given tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

from openmm_exactrb.potentials import compiled
from openmm_exactrb.potentials import ewald_errors as errors

Edges: TypeAlias = tuple[float, float, float]

#: Largest number of waves of a direct sum. So many waves take 100 MB, and 1 ms per dipole.
MOST_WAVES = 1_000_000
#: Largest number of mesh points along an edge; a cubic mesh of this size takes 2 GB.
MOST_POINTS = 512

# Times in ns: per pair in a row of all pairs, per pair found through cells, per wave and dipole, per mesh point, per
# dipole and point under its spline, and per mesh. The last number is the largest cutoff, relative to the shortest edge,
# at which cells are used.
_ROW, _CELL, _WAVE, _POINT, _SPLINE, _MESH, _WHOLE = 9.3, 12.0, 1.0, 15.0, 0.85, 2e5, 0.4

#: Smallest tolerance for which a mesh is chosen. Below this tolerance, the a priori error of a mesh is dominated by
#: roundoff.
LEAST_TOLERANCE = 2e-7

#: Additional numbers per spline beyond its order, which fill vector registers.
LANES = 4


class EwaldParameters(NamedTuple):
    """Parameters of an Ewald sum of dipoles; lengths in nm, their inverses in 1/nm."""

    method: str  #: "direct" (all waves) or "mesh" (smooth particle mesh Ewald)
    cutoff: float  #: cutoff of the energy of a pair
    switch: float  #: start of the switch of this energy
    alpha: float  #: inverse width of the Gaussians
    k_max: float  #: largest wave number of the direct sum, 0 for a mesh
    order: int  #: order of the splines of a mesh, 0 for the direct sum
    points: tuple[int, ...]  #: numbers of mesh points along the edges, () for the direct sum
    error: float  #: estimated error, relative as for `tolerance`, and at most the tolerance


def direct(n: int, edges: Edges, cutoff: float, switch: float, tolerance: float) -> EwaldParameters:
    """Return the parameters of the sum over all waves; raise ValueError if it needs more than `MOST_WAVES`.

    The truncation errors of the two sums are exp(-x²) with x = alpha switch, and exp(-y²) with y = k_max/(2 alpha),
    times powers of x or y and of a, where a is alpha times the distance between dipoles. The powers are those for
    random dipoles. The factors are the largest that were measured in liquids and gases of 8 to 256 dipoles. The
    tolerance is relative to the root mean square of forces and fields.
    """
    begin = max(switch, 1e-3 * cutoff)  # a start at 0 leads to the error below, not to a division by zero
    x = y = 3.0
    distance = mean_distance(n, edges)
    for _ in range(60):
        a = x * distance / begin
        x = math.log(max(a**2.5 * x**1.5 / tolerance, math.e)) ** 0.5
        y = math.log(max(0.7 * a**2.5 * y**1.5 / tolerance, 0.9 * a**3 * y / tolerance, math.e)) ** 0.5
    alpha = x / begin
    k_max = 2.0 * alpha * y
    waves = compiled.load("pairs").number_of_waves(edges, k_max)
    if waves > MOST_WAVES:
        raise ValueError(
            f"an Ewald sum with a switch at {begin:g} nm and a tolerance of {tolerance:g} needs {waves:.3g} waves, "
            f"more than {MOST_WAVES:g}: start the switch at a larger distance, or use a larger tolerance"
        )
    return EwaldParameters("direct", cutoff, switch, alpha, k_max, 0, (), tolerance)


def cost(n: int, edges: Edges, chosen: EwaldParameters) -> float:
    """Return the approximate time of an evaluation in ns, as measured on one core."""
    reach = chosen.cutoff / min(edges)
    neighbours = 4.0 / 3.0 * math.pi * chosen.cutoff**3 * n / math.prod(edges)
    pairs = n * (_ROW * n if reach > _WHOLE else _CELL * neighbours)
    if chosen.method == "direct":
        return pairs + n * _WAVE * float(compiled.load("pairs").number_of_waves(edges, chosen.k_max))
    return pairs + _POINT * math.prod(chosen.points) + n * _SPLINE * chosen.order**3 + _MESH


def meshes(
    n: int,
    edges: Edges,
    tolerance: float,
    cutoff: float | None = None,
    switch: float | None = None,
    order: int | None = None,
    points: tuple[int, ...] | None = None,
) -> Iterator[EwaldParameters]:
    """Yield the parameters of meshes of several sizes that meet a tolerance and have the given parameters."""
    distance, half, goal = mean_distance(n, edges), 0.5 * min(edges), tolerance / errors.SAFETY
    part = 0.75 if switch is None or cutoff is None else switch / cutoff
    for p in (8, 10) if order is None else (order,):
        least = math.inf
        for mesh in _sizes(edges, p) if points is None else (points,):
            if _POINT * math.prod(mesh) > least:
                break
            step = max(edge / many for edge, many in zip(edges, mesh, strict=True))
            if cutoff is None:
                alpha = errors.finest_splitting(step, p, distance, 0.7 * goal)
                end = errors.shortest_cutoff(alpha, part, distance, 0.7 * goal, half)
            else:
                end, alpha = cutoff, errors.widest_splitting(cutoff, part * cutoff, distance, 0.7 * goal)
            begin = part * end if switch is None or cutoff is not None else switch
            parts = errors.of_pairs(alpha, end, begin, distance), errors.of_mesh(alpha, step, p, distance)
            error = errors.SAFETY * math.hypot(*parts)
            if begin < end and (error <= tolerance or points is not None):
                found = EwaldParameters("mesh", end, begin, alpha, 0.0, p, mesh, error)
                yield found
                if cost(n, edges, found) > 1.3 * least:
                    break
                least = min(least, cost(n, edges, found))


def _sizes(edges: Edges, order: int) -> Iterator[tuple[int, ...]]:
    """Yield numbers of points along the edges that have fast transforms, in ascending order."""
    fast_size, shortest, many = compiled.load("mesh").fast_size, min(edges), order + LANES
    while many <= MOST_POINTS:
        many = fast_size(many)
        mesh = tuple(fast_size(many * edge / shortest) for edge in edges)
        if max(mesh) > MOST_POINTS:
            return
        yield mesh
        many += 1


def mean_distance(n: int, edges: Edges) -> float:
    """Return the mean distance (nm) of n dipoles in a box."""
    return math.pow(math.prod(edges) / n, 1.0 / 3.0)
