"""The engine of kernels on the host: its propagator and its environment of substeps."""
