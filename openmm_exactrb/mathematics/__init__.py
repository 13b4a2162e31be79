"""Mathematical functions that need only NumPy: elliptic functions, compensated sums and quaternions."""
