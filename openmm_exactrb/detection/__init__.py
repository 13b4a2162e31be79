"""Detection of the rigid bodies and constrained clusters of a System, and their shapes."""
