"""The kernels for numba; importing a module compiles its kernels, or loads them from numba's cache."""
