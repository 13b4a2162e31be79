"""Many independent runs on dask.distributed.

A `Recipe` is a function and its arguments. `run` and `as_completed` send recipes to worker processes, on this machine
or on a cluster, start those of a worker that dies again, and keep every finished one in a folder, so that the same
command goes on where it stopped.

Recipes are in `recipes`, the texts that their keys are made of in `names`, what became of them in `outcomes`, the
folder in `store`, the processes in `workers`, `run` and `as_completed` in `calls`, and `energies` in `dynamics`.
"""

from openmm_exactrb.ensemble.calls import as_completed, run
from openmm_exactrb.ensemble.dynamics import energies
from openmm_exactrb.ensemble.outcomes import Outcome
from openmm_exactrb.ensemble.recipes import Recipe, sweep

__all__ = ["Outcome", "Recipe", "as_completed", "energies", "run", "sweep"]

# Keys of recipes hold this name: with another one the results that people have on disk would not be found.
energies.__module__ = __name__
