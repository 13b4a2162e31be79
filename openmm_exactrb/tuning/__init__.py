"""The search for the cheapest scheme and step size that reach a given energy error on a user's own system.

`tune` in `advice` combines measurement, search and result. For measurement, `initial_state` reads the arguments,
`preparation` brings the system to a temperature, `benchmark` runs the methods within the `budget`, `error` extrapolates
their energy errors, and `measurements` stores these errors. `search` decides which methods and steps are measured.
`result` contains the answer, as an object and as text.
"""

from openmm_exactrb.errors import UnreachableError
from openmm_exactrb.tuning.advice import tune
from openmm_exactrb.tuning.benchmark import CANDIDATES
from openmm_exactrb.tuning.measurements import Point
from openmm_exactrb.tuning.result import Choice, Tuning

__all__ = ["CANDIDATES", "Choice", "Point", "Tuning", "UnreachableError", "tune"]
