"""The engine of kernels on the host: the propagator and what substeps are bound to."""
