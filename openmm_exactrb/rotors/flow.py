"""The type of the flows of the free rigid body, the check of their arguments, and the sorting of principal axes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array

#: flow(q, m, t) -> (q, m), component-first: q (4, N) scalar first, m (3, N) in the body frame, t scalar or (N,).
#: Some flows also take double-doubles, (2, 4, N) and (2, 3, N).
Rotation = Callable[[Array, Array, Array | float], tuple[Array, Array]]
_FLOAT = np.dtype(np.float64)


def fitting(inertia: Array, flow: Rotation, sums: bool) -> Rotation:
    """Return a flow that checks array lengths, because compiled code would write past the ends of short arrays.

    A ValueError is raised if the lengths differ. `sums` states whether the flow takes double-doubles.
    """
    seen = None  # shapes are the same at every step of a run

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
    """Raise ValueError if shapes do not agree on the number of bodies."""
    n, kinds = m[-1:], ((), (1,), (2,)) if sums else ((),)
    alike = any((q, m) == ((*kind, 4, *n), (*kind, 3, *n)) for kind in kinds)
    if not (alike and t in ((), (1,), n) and moments in ((3, 1), (3, *n))):
        raise ValueError(
            f"the shapes of q {q}, m {m}, t {t} and moments {moments} do not agree on the number N of bodies: use the "
            "shapes (4, N) for q, (3, N) for m, () or (N,) for t, and (3, 1) or (3, N) for moments"
        )


def ascending(inertia: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return the permutation that sorts moments (3, 1) or (3, N), its inverse, and its sign (1,) or (N,).

    An odd permutation is a reflection: momenta and vector parts of quaternions, which are pseudovectors, change sign.
    """
    order = np.argsort(inertia, axis=0, kind="stable")
    return order, np.argsort(order, axis=0), np.where((order[1] - order[0]) % 3 == 1, 1.0, -1.0)
