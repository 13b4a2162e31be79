"""Flows of the free rigid body under one interface.

A flow is one file with a function ``rotor(inertia) -> flow`` and one line in `ROTORS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from openmm_exactrb.rotors import euler, exact, mclachlan_reich, moser_veselov, quaternion, rotation
from openmm_exactrb.rotors.euler import ThirdKind
from openmm_exactrb.rotors.flow import Array, Flow
from openmm_exactrb.rotors.moser_veselov import NotConvergedWarning
from openmm_exactrb.sums import exactly

__all__ = ["ROTORS", "Flow", "NotConvergedWarning", "Rotor", "free_rotor", "rotor", "rotor_of_sums"]


#: Between them a moment and its reciprocal are normal numbers.
SMALLEST_MOMENT, LARGEST_MOMENT = 1e-307, 1e307
#: The largest ratio of the moments of a body: beyond it formulas lose the smallest one.
WIDEST = 1e15


@dataclass(frozen=True)
class Rotor:
    """A way to advance free rigid bodies.

    Attributes
    ----------
    name : str
    order : int or None
        Order in the step; None if exact.
    factory : callable
        factory(inertia) -> flow, with component-first inertia (3, 1) or (3, N).
    reference : str
    keeps_energy : bool
        Whether the kinetic energy is kept to roundoff; if not, to the order of the flow.
    largest_angle : float
        Every body takes a step of h norm(m)/min(I) up to this; beyond it the flow may have no answer.
    sums : bool
        Whether the flow takes sums high + low of `openmm_exactrb.sums` too, and then rounds next to nothing.
    """

    name: str
    order: int | None
    factory: Callable[[Array], Flow]
    reference: str
    keeps_energy: bool = True
    largest_angle: float = math.inf
    sums: bool = False


def _with_gauss(factory: Callable[[Array, ThirdKind], Flow], points: int) -> Callable[[Array], Flow]:
    """Return the factory of flows with Gauss's rule in place of the exact integral."""
    return lambda inertia: factory(inertia, euler.gauss(points))


_HAIRER_VILMART = "Hairer and Vilmart (2006), doi:10.1088/0305-4470/39/42/006"
_PAPER = "Celledoni, Fassò, Säfström and Zanna, doi:10.1137/070704393"

#: All flows by name. "exact" is compiled where numba is installed; the two after it say which one to take.
ROTORS: Mapping[str, Rotor] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            Rotor("exact", None, exact.fastest_rotor, _PAPER, sums=True),
            Rotor("exact_numpy", None, exact.rotor, _PAPER, sums=True),
            Rotor("exact_compiled", None, exact.compiled_rotor, _PAPER, sums=True),
            Rotor("rotation", None, rotation.rotor, f"{_PAPER}, section 2.2"),
            Rotor("quaternion_a", None, quaternion.kosenko, f"{_PAPER}, equation (38)"),
            Rotor("quaternion_b", None, quaternion.moving_frame, f"{_PAPER}, section 2.4 (b)"),
            Rotor("quaternion_c", None, quaternion.van_zon_schofield, f"{_PAPER}, section 2.4 (c)"),
            *(
                Rotor(f"rotation_gauss{2 * p}", 2 * p, _with_gauss(rotation.rotor, p), f"{_PAPER}, equation (39)")
                for p in (3, 4, 5)
            ),
            *(
                Rotor(f"quaternion_gauss{2 * p}", 2 * p, _with_gauss(quaternion.kosenko, p), f"{_PAPER}, equation (39)")
                for p in (3, 4, 5)
            ),
            *(Rotor(f"dmv{n}", n, moser_veselov.rotor(n), _HAIRER_VILMART, largest_angle=1.0) for n in (6, 8, 10)),
            Rotor(
                "mclachlan_reich",
                2,
                mclachlan_reich.rotor,
                "Dullweber, Leimkuhler and McLachlan (1997), doi:10.1063/1.474310",
                keeps_energy=False,
            ),
        )
    }
)


def rotor(name: str, inertia: ArrayLike) -> Flow:
    """Prepare the flow of free bodies.

    Parameters
    ----------
    name : str
        A key of `ROTORS`.
    inertia : (3,) or (N, 3) array_like
        Principal moments of inertia in any order: one body's for all, or one row a body.

    Returns
    -------
    flow : callable
        flow(q, m, t) -> (q, m), with component-first q (4, N), m (3, N), and t a scalar or (N,).

    Raises
    ------
    ValueError
        If there is no such rotor, or moments are not positive and finite, not of this shape, below
        ``SMALLEST_MOMENT``, above ``LARGEST_MOMENT``, or further apart than ``WIDEST``.

    Notes
    -----
    I1 + I2 >= I3, as the moments of all masses have it, is not asked for: the equations do not need it.
    """
    if name not in ROTORS:
        raise ValueError(f"unknown rotor {name!r}: choose one of {', '.join(ROTORS)}")
    moments = np.asarray(inertia, dtype=np.float64)
    if moments.ndim not in (1, 2) or moments.shape[-1] != 3:
        raise ValueError(f"inertia must have the shape (3,) or (N, 3), not {moments.shape}")
    if not (np.isfinite(moments).all() and (moments > 0.0).all()):
        raise ValueError("inertia must be positive and finite: give the three principal moments of each body")
    least, largest = moments.min(axis=-1), moments.max(axis=-1)
    if (least < np.maximum(SMALLEST_MOMENT, largest / WIDEST)).any() or (largest > LARGEST_MOMENT).any():
        raise ValueError(
            f"inertia must lie between {SMALLEST_MOMENT:g} and {LARGEST_MOMENT:g}, the moments of a body within a "
            f"factor {WIDEST:g}: use other units, or treat the body as linear"
        )
    return ROTORS[name].factory(np.ascontiguousarray(np.atleast_2d(moments).T))


def rotor_of_sums(name: str, inertia: ArrayLike) -> Flow:
    """Prepare the flow of free bodies whose attitudes (2, 4, N) and momenta (2, 3, N) are sums high + low.

    Parameters and errors are those of `rotor`. Flows without ``Rotor.sums`` round what they return to the high part.
    """
    flow = rotor(name, inertia)
    if ROTORS[name].sums:
        return flow

    def rounding(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
        q1, m1 = flow(q[0], m[0], t)
        return exactly(q1), exactly(m1)

    return rounding


def free_rotor(
    inertia: ArrayLike, q0: ArrayLike, m0: ArrayLike, t: ArrayLike, method: str = "exact"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Advance free rigid bodies by the time t.

    Solves mdot = m x I^-1 m, qdot = q (0, I^-1 m)/2: equations (1) and (19) of the paper.

    Parameters
    ----------
    inertia : (3,) or (N, 3) array_like
        Principal moments of inertia, in any order.
    q0 : (4,) or (N, 4) array_like
        Attitudes, scalar first, which turn body coordinates into space coordinates. They are normalised.
    m0 : (3,) or (N, 3) array_like
        Angular momenta in the body frame; zero is allowed.
    t : float or (N,) array_like
        Time, of any sign and size.
    method : str, optional
        A key of `ROTORS`.

    Returns
    -------
    q1 : (4,) or (N, 4) array
    m1 : (3,) or (N, 3) array
        New arrays; those handed in are not changed. A body with a number that is not finite becomes nan,
        its neighbours are not touched.

    Warns
    -----
    NotConvergedWarning
        If a step is too long for some bodies, which are then nan; only flows whose `largest_angle` is finite.

    Raises
    ------
    ValueError
        If shapes do not fit together, the method is unknown, moments are not positive, or an attitude is zero.

    Examples
    --------
    >>> q, m = free_rotor([1.0, 1.88, 2.88], [1, 0, 0, 0], [0.3, 0.2, 0.1], 5.0)
    >>> bool(abs(m @ m - 0.14) < 1e-15)
    True
    """
    inertia, q, m, t = (np.asarray(a, dtype=np.float64) for a in (inertia, q0, m0, t))
    if q.shape[-1:] != (4,) or m.shape[-1:] != (3,):
        raise ValueError(f"q0 must have the shape (N, 4) and m0 (N, 3), not {q.shape} and {m.shape}")
    try:
        shape = np.broadcast_shapes(inertia.shape[:-1], q.shape[:-1], m.shape[:-1], t.shape)
    except ValueError:
        raise ValueError(
            f"inertia {inertia.shape}, q0 {q.shape}, m0 {m.shape} and t {t.shape} are not of one number of bodies"
        ) from None
    if len(shape) > 1:
        raise ValueError(f"bodies must be listed along one axis, not along {len(shape)}")
    n = int(np.prod(shape))
    flow = rotor(method, inertia)
    attitudes = _normalised(_columns(q, n, 4))
    with np.errstate(all="ignore"):  # what is not finite stays in its own body
        q1, m1 = flow(attitudes, _columns(m, n, 3), np.broadcast_to(t, (n,)))
    return np.ascontiguousarray(q1.T).reshape(*shape, 4), np.ascontiguousarray(m1.T).reshape(*shape, 3)


def _columns(rows: Array, n: int, k: int) -> Array:
    """Return (n, k) or (k,) rows as contiguous columns (k, n)."""
    return np.ascontiguousarray(np.broadcast_to(rows, (n, k)).T)


def _normalised(q: Array) -> Array:
    """Return attitudes of norm one; those that are already are not touched."""
    largest = np.abs(q).max(axis=0, initial=0.0)
    if (largest == 0.0).any():
        raise ValueError("an attitude q0 is zero: quaternions must have a direction, (1, 0, 0, 0) turns nothing")
    norm = np.sqrt(np.einsum("in,in->n", q, q))
    off = ~(np.abs(norm - 1.0) < 1e-12)
    if not off.any():
        return q
    with np.errstate(invalid="ignore"):
        scaled = q / np.where(off, largest, 1.0)
        return scaled / np.where(off, np.sqrt(np.einsum("in,in->n", scaled, scaled)), 1.0)
