"""Many independent runs with dask.distributed.

A `Job` is a function with its arguments. `run` and `as_completed` send jobs to worker processes, on this machine or on
a cluster, restart the jobs of a worker that dies, and store the result of every successful job in a folder. A script
that is interrupted and run again therefore executes only the jobs without results.
"""

from openmm_exactrb.ensemble.execution import as_completed, run
from openmm_exactrb.ensemble.jobs import Job, Result, sweep

__all__ = ["Job", "Result", "as_completed", "run", "sweep"]
