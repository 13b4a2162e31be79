"""Reporters for openmm.app.Simulation."""
