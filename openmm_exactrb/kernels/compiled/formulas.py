"""Formulas in numpy that compiled code calls unchanged."""

from numba.extending import register_jitable

from openmm_exactrb.kernels.build import inlined
from openmm_exactrb.kernels.plain import exact
from openmm_exactrb.mathematics import compensated, elliptic, quaternions

two_sum = inlined(compensated.two_sum)
two_difference = inlined(compensated.two_difference)
sine_short = inlined(elliptic.sine_short)
matrix_entries = inlined(quaternions.matrix_entries)
product = inlined(quaternions.product)
separatrix_difference = inlined(exact.separatrix_difference)

for _callee in (
    compensated.halves,
    compensated.two_product,
    compensated.two_difference,
    compensated.times,
    compensated.times_squared,
):
    register_jitable(error_model="numpy")(_callee)
