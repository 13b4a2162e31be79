"""Limits of the exact flow; names in capitals are also macros of the kernel texts."""

#: The largest b G h of a short step, for which the series are exact to roundoff.
SHORT = 0.3
#: The largest number of short steps in a drift of the kernels; a body that needs more has diverged.
MOST_PARTS = 10000.0
