"""The command ``exactrb``: run a molecular simulation, tune its scheme and step, and describe the installation.

`main` combines the subcommands `run`, `tune` and `info`. For `run`, `inputs` reads or creates the molecules, `setup`
creates the integrator and the barostat, `equilibration` provides the initial State and the step, and `analysis` prints
and draws the results.
"""
