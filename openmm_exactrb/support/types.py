"""Types of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Real numbers.
Array = NDArray[np.float64]
#: Indices of particles or bodies, or of elements of other arrays.
Indices = NDArray[np.intp]
