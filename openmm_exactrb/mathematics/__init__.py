"""Mathematical functions that need only NumPy and SciPy: elliptic functions, compensated sums and quaternions."""
