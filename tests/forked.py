"""Processes that are forked from one which has imported what is slow to import: they start in a tenth of the time."""

import multiprocessing

# Nothing of this project: each process imports what it tests, with its own settings.
PRELOADED = ["distributed", "matplotlib.pyplot", "numba", "openmm.app", "pytest", "tqdm"]

FORKED = multiprocessing.get_context("forkserver")
FORKED.set_forkserver_preload(PRELOADED)
