"""The kernels for numba; importing them compiles them, or finds them in numba's cache."""

from numba.extending import register_jitable

from openmm_exactrb import compensated, elliptic, quaternions
from openmm_exactrb.kernels.plain import exact

# Formulas that compiled code calls as they are.
for _formula in (
    compensated.two_sum,
    compensated.two_difference,
    compensated.two_product,
    compensated.halves,
    compensated.times,
    compensated.times_squared,
    elliptic.sine_short,
    exact.separatrix_difference,
    quaternions.matrix_entries,
    quaternions.product,
):
    register_jitable(inline="always")(_formula)
