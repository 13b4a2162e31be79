"""Engines: what carries the steps of an integrator out in its Context."""
