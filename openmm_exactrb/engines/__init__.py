"""Engines: each carries out the sequence of a scheme in a Context of OpenMM."""
