"""What flows of the free rigid body share: their type, and the order of the axes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb import checks

Array = NDArray[np.float64]

#: flow(q, m, t) -> (q, m), component-first: q (4, N) scalar first, m (3, N) in the body frame, t scalar or (N,).
#: Some take sums high + low too, (2, 4, N) and (2, 3, N).
Flow = Callable[[Array, Array, Array | float], tuple[Array, Array]]
_FLOAT = np.dtype(np.float64)


def fitting(inertia: Array, flow: Flow, sums: bool) -> Flow:
    """Return a flow that refuses arrays which are not of one number of bodies: compiled code would pass their ends.

    Parameters
    ----------
    inertia : (3, 1) or (3, N) array
    flow : callable
        Is handed q, m and t as floats.
    sums : bool
        Whether it takes sums too.
    """
    seen = None  # a run hands over arrays of the same shapes at every step

    def fitted(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
        nonlocal seen
        if not isinstance(t, float):
            t = checks.array(t, "t")
        shapes = q.shape, m.shape, () if isinstance(t, float) else t.shape
        if shapes != seen:
            _check_one_number(inertia.shape, *shapes, sums)
            seen = shapes
        if not q.dtype == m.dtype == _FLOAT:
            q, m = checks.array(q, "q"), checks.array(m, "m")
        return flow(q, m, t)

    return fitted


def _check_one_number(
    moments: tuple[int, ...], q: tuple[int, ...], m: tuple[int, ...], t: tuple[int, ...], sums: bool
) -> None:
    """Refuse shapes that are not of one number of bodies."""
    n, kinds = m[-1:], ((), (1,), (2,)) if sums else ((),)
    alike = any((q, m) == ((*kind, 4, *n), (*kind, 3, *n)) for kind in kinds)
    if not (alike and t in ((), (1,), n) and moments in ((3, 1), (3, *n))):
        raise ValueError(
            f"q {q}, m {m}, t {t} and moments {moments} are not of one number N of bodies: "
            "give q (4, N), m (3, N), and t and moments one for all or one a body"
        )


def ascending(inertia: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return how to bring bodies to ascending principal axes and back.

    Parameters
    ----------
    inertia : (3, 1) or (3, N) array

    Returns
    -------
    order, back : arrays of int of the same shape
        Places of the axes in ascending order, and their inverse.
    handedness : (1,) or (N,) array
        -1 for an odd permutation, which is a reflection: momenta and vector parts of quaternions are pseudovectors and
        change their sign with it. Else 1.
    """
    order = np.argsort(inertia, axis=0, kind="stable")
    return order, np.argsort(order, axis=0), np.where((order[1] - order[0]) % 3 == 1, 1.0, -1.0)
