"""Compilation by numba, and loops in several threads."""
