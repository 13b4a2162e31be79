"""Flexible molecules by the native engine: blocks of clusters, tables of terms, and launches of inner steps."""
