"""Clusters of particles with distance constraints: their graphs, their geodesics, and the kernels that follow these."""
