"""Types of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Real numbers.
Array = NDArray[np.float64]
#: Numbers of particles or bodies, or places in other arrays.
Indices = NDArray[np.intp]
