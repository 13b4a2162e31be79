"""The command ``exactrb``: run a molecular simulation, tune its scheme and step, print what is installed.

`run`, `tune` and `info` are subcommands, which `main` joins. Of `run`, `inputs` reads or creates the molecules, `setup`
makes integrator and barostat, `equilibration` provides start and step, and `analysis` prints and draws the results.
"""
