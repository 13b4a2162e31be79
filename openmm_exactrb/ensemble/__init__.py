"""Many independent runs on dask.distributed.

A `Job` is a function with its arguments. `run` and `as_completed` send jobs to worker processes, on this machine or on
a cluster, restart those of a worker that dies, and store every result in a folder, so that the same command continues
where it stopped.
"""

from openmm_exactrb.ensemble.execution import as_completed, run
from openmm_exactrb.ensemble.jobs import Job, Result, sweep

__all__ = ["Job", "Result", "as_completed", "run", "sweep"]
