"""The command ``exactrb``: run a simulation or a script, tune a scheme and step, and describe the installation.

`main` combines the subcommands `run`, `exec`, `tune` and `info`. For `run`, `inputs` reads or creates the molecules,
`setup` creates the integrator and the barostat, `equilibration` provides the initial State and the step, and `analysis`
prints and draws the results.
"""
