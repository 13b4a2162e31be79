"""Limits of the power series of geodesics; names in capitals are also macros of the kernel texts."""

#: The largest number of orders of the multipliers in a drift; a step that needs more orders is halved.
GRAPH_ORDERS = 30
#: The same for stars in the kernels, where the series are in registers.
ORDERS = 12
#: A series ends when two successive terms are below this fraction of its first term.
SETTLED = 1e-16
#: The largest number of times that a step is halved; the results of a cluster that needs more halvings are nan.
HALVINGS = 12
#: The smallest part of a step.
SHORTEST = 0.5**HALVINGS
