"""The host engine: its propagator, and the environment to which substeps are bound."""
