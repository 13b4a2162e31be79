"""Advice for a user's own system: which scheme and step, at which energy error and cost.

`tune` in `advice` is what a user calls, and ``python -m openmm_exactrb.tuning`` the same from a shell. It goes one way:
`start` reads what was given, `thermal` brings it to a temperature, `scales` says how large and fast the system is; a
`bench` runs `movers` from there, and `error` says what to expect of longer runs; `measurements` keeps points, `search`
decides which to take, `curves` lie through them; of the `record` come `answers`, `text` and a `picture`, and a `result`
is all of it. `proposals` is beside them: settings of hybrid Monte Carlo by what progress costs.
"""

from openmm_exactrb.tuning.advice import CANDIDATES, tune
from openmm_exactrb.tuning.answers import UnreachableError
from openmm_exactrb.tuning.curves import Point
from openmm_exactrb.tuning.proposals import PROPOSERS, Proposal, progress, tune_proposals
from openmm_exactrb.tuning.record import Choice, Record
from openmm_exactrb.tuning.result import Tuning

__all__ = [
    "CANDIDATES",
    "PROPOSERS",
    "Choice",
    "Point",
    "Proposal",
    "Record",
    "Tuning",
    "UnreachableError",
    "progress",
    "tune",
    "tune_proposals",
]
