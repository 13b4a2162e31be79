"""The kernels that are written in numpy."""
