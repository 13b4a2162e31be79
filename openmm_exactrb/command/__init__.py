"""The command ``exactrb``: run a molecular simulation, tune its scheme and step, and describe the installation.

`main` combines the subcommands `run`, `tune` and `info`. For `run`, `inputs` reads or creates the molecules, `setup`
creates integrator and barostat, `equilibration` provides start and step, and `analysis` prints and draws the results.
"""
