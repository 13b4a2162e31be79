"""The kernels for numba; importing them compiles them, or finds them in numba's cache."""
