"""The command ``exactrb``: run a molecular simulation, tune its scheme and step, say what is installed.

Each subcommand is a file with a function that adds its options to a parser and one that carries them out; `main` joins
them and tells in one line what goes wrong. Of `run`, the command that simulates, `boxes` reads or makes what moves,
`ensembles` chooses who moves it, `prepared` brings it to a start, `progress` tells how far it is, and `outcome` prints
and draws what came of it.
"""
