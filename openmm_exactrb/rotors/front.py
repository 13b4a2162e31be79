"""The public function `free_rotor`, which rotates any number of free rigid bodies with any rotor."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from openmm_exactrb.rotors.registry import Rotor, rotor
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array


def free_rotor(
    inertia: ArrayLike, q0: ArrayLike, m0: ArrayLike, t: ArrayLike, method: str | Rotor = "exact"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Advance free rigid bodies by the time t.

    The equations of motion are mdot = m x I^-1 m and qdot = q (0, I^-1 m)/2, equations (1) and (19) of Celledoni et al.
    (doi:10.1137/070704393).

    Parameters
    ----------
    inertia : (3,) or (N, 3) array_like
        Principal moments of inertia, in any order.
    q0 : (4,) or (N, 4) array_like
        Orientation quaternions, scalar first, which map body coordinates to space coordinates. The function normalises
        them.
    m0 : (3,) or (N, 3) array_like
        Angular momenta in the body frame; zero is allowed.
    t : float or (N,) array_like
        Time, of any sign and magnitude.
    method : str or Rotor, optional
        A key of `ROTORS`, or a `Rotor` of your own.

    Returns
    -------
    q1 : (4,) or (N, 4) array
    m1 : (3,) or (N, 3) array
        Orientations and momenta after the time t, in new arrays. The results of a body with a non-finite number are
        nan; other bodies are not affected.

    Warns
    -----
    NotConvergedWarning
        If a step is too long for some bodies, whose results are nan. Only rotors with a finite `largest_angle` issue
        this warning.

    Raises
    ------
    ValueError
        If the arguments are not real numbers, shapes do not match, the method is unknown, moments are not positive, or
        a quaternion is zero.

    Examples
    --------
    >>> q, m = free_rotor([1.0, 1.88, 2.88], [1, 0, 0, 0], [0.3, 0.2, 0.1], 5.0)
    >>> bool(abs(m @ m - 0.14) < 1e-15)
    True
    """
    inertia, q, m, t = map(checks.array, (inertia, q0, m0, t), ("inertia", "q0", "m0", "t"))
    if q.shape[-1:] != (4,) or m.shape[-1:] != (3,):
        raise ValueError(f"q0 must have the shape (4,) or (N, 4), and m0 (3,) or (N, 3), not {q.shape} and {m.shape}")
    try:
        shape = np.broadcast_shapes(inertia.shape[:-1], q.shape[:-1], m.shape[:-1], t.shape)
    except ValueError:
        raise ValueError(
            f"the shapes of inertia {inertia.shape}, q0 {q.shape}, m0 {m.shape} and t {t.shape} do not agree on the "
            "number N of bodies: use the shapes (N, 3), (N, 4), (N, 3) and (N,), each without N for one body"
        ) from None
    if len(shape) > 1:
        raise ValueError(
            f"inertia, q0, m0 and t must have one axis of bodies, not {len(shape)}: reshape them, for example q0 to "
            "(N, 4)"
        )
    n = int(np.prod(shape))
    flow = rotor(method, inertia)
    attitudes = _normalised(_columns(q, n, 4))
    with np.errstate(all="ignore"):  # non-finite numbers affect only their own body
        q1, m1 = flow(attitudes, _columns(m, n, 3), np.broadcast_to(t, (n,)))
    return np.ascontiguousarray(q1.T).reshape(*shape, 4), np.ascontiguousarray(m1.T).reshape(*shape, 3)


def _columns(rows: Array, n: int, k: int) -> Array:
    """Return rows (n, k) or (k,) as contiguous columns (k, n)."""
    return np.ascontiguousarray(np.broadcast_to(rows, (n, k)).T)


def _normalised(q: Array) -> Array:
    """Return quaternions (4, N) of norm one; quaternions that already have this norm are unchanged."""
    largest = np.abs(q).max(axis=0, initial=0.0)
    if (largest == 0.0).any():
        raise ValueError("a quaternion of q0 is zero: use (1, 0, 0, 0) for no rotation")
    norm = np.sqrt(np.einsum("in,in->n", q, q))
    off = ~(np.abs(norm - 1.0) < 1e-12)
    if not off.any():
        return q
    with np.errstate(invalid="ignore"):
        scaled = q / np.where(off, largest, 1.0)
        return scaled / np.where(off, np.sqrt(np.einsum("in,in->n", scaled, scaled)), 1.0)
