"""Benchmarks of the project, in one folder for each topic; README.md lists them."""
