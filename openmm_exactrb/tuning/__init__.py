"""The cheapest scheme and step for an energy error on a user's own system.

`tune` in `advice` has three layers. Measurement: `initial_state` reads the arguments, `preparation` brings the system
to a temperature, `benchmark` runs the methods within the `budget`, `error` extrapolates their energy errors, and
`measurements` keeps them. `search` decides what to measure. `result` is the answer, as an object and text.
"""

from openmm_exactrb.tuning.advice import tune
from openmm_exactrb.tuning.benchmark import CANDIDATES
from openmm_exactrb.tuning.measurements import Point
from openmm_exactrb.tuning.result import Choice, Tuning, UnreachableError

__all__ = ["CANDIDATES", "Choice", "Point", "Tuning", "UnreachableError", "tune"]
