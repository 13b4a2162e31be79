"""Mechanics of rigid bodies and constrained clusters, without OpenMM: states and their free motion."""
