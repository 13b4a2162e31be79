"""What every flow of the free rigid body is: the type that the registry and its files share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: flow(q, m, t) -> (q, m), component-first: q (4, N) scalar first, m (3, N) in the body frame, t scalar or (N,).
#: Some take sums high + low too, (2, 4, N) and (2, 3, N).
Flow = Callable[[Array, Array, Array | float], tuple[Array, Array]]
