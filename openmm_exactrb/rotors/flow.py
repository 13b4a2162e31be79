"""What flows of the free rigid body share: their type, and the order of the axes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: flow(q, m, t) -> (q, m), component-first: q (4, N) scalar first, m (3, N) in the body frame, t scalar or (N,).
#: Some take sums high + low too, (2, 4, N) and (2, 3, N).
Flow = Callable[[Array, Array, Array | float], tuple[Array, Array]]


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
