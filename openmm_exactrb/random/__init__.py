"""Counter-based random numbers, in NumPy and in the kernels."""
