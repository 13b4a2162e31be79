"""The command ``exactrb``: run a molecular simulation, tune its scheme and step, print what is installed.

Each subcommand is a module with a function that adds its options to a parser and one that executes it; `main` joins
them and prints errors in one line. Of `run`, `inputs` reads or creates the molecules, `setup` makes integrator and
barostat, `equilibration` provides start and step, and `analysis` prints and draws the results.
"""
