"""The cheapest scheme and step for an energy error on a user's own system.

`tune` in `advice` is built in three layers. Measurement: `initial_state` reads the arguments, `equilibrium` brings the
system to a temperature and tells its characteristic times, `benchmark` runs the methods of `candidates`, `error`
extrapolates their energy errors, and `measurements` keeps them. `search` decides what to measure. `result` is the
answer, as an object, text and a `picture`.
"""

from openmm_exactrb.tuning.advice import tune
from openmm_exactrb.tuning.candidates import CANDIDATES
from openmm_exactrb.tuning.measurements import Point
from openmm_exactrb.tuning.result import Choice, Tuning, UnreachableError

__all__ = ["CANDIDATES", "Choice", "Point", "Tuning", "UnreachableError", "tune"]
