"""Flexible molecules on a device: blocks of clusters, tables of terms, and launches of inner steps."""
