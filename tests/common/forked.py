"""Processes that are forked from one which has imported what is slow to import: they start in a tenth of the time."""

import multiprocessing

# Nothing of this project: each process imports what it tests, with its own settings.
PRELOADED = ["distributed", "matplotlib.pyplot", "numba", "openmm.app", "pytest", "tqdm"]

START = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"  # on Windows
FORKED = multiprocessing.get_context(START)


def preload():
    """Name what the process imports that others are forked from."""
    if START == "forkserver":
        FORKED.set_forkserver_preload(PRELOADED)


preload()
