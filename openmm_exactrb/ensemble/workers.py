"""Worker processes of dask.distributed, which call the functions of jobs."""

from __future__ import annotations

import json
import logging
import pickle
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cloudpickle
import dask
import distributed
import numpy as np
from dask.system import CPU_COUNT

from openmm_exactrb.ensemble.jobs import Job, Result, versions
from openmm_exactrb.support.messages import shown

#: Seconds to wait for a scheduler to answer.
TIMEOUT = 20.0

_LOCAL = {
    # A worker holds one job at a time, so that the death of a worker is attributed to the job that caused it.
    "distributed.scheduler.worker-saturation": 1.0,
    # LocalCluster abandons a worker that dies twice within this time, and waits forever if it was the last worker.
    "distributed.deploy.lost-worker-timeout": "7 days",
}


def completed(client: distributed.Client, jobs: list[Job]) -> Iterator[Result]:
    """Send jobs to the workers, and yield their results as they complete."""
    # Pickled here, since dask never finishes a task whose module a worker cannot import.
    pickled = [cloudpickle.dumps(job) for job in jobs]
    futures = client.map(perform, pickled, wanted=versions(), pure=False)
    job_of = {future.key: job for future, job in zip(futures, jobs, strict=True)}
    try:
        for future in distributed.as_completed(futures, loop=client.loop):
            yield Result(job_of[future.key], **_fields(future))
            future.release()
    finally:
        client.cancel([future for future in futures if not future.done()])


def _fields(future: distributed.Future) -> dict[str, Any]:
    """Return the fields of the `Result` that a future provides."""
    try:
        return dict(future.result())
    except distributed.CancelledError as error:
        raise ConnectionError(
            "the connection to the scheduler was lost, but stored results are kept: repeat the call to continue"
        ) from error
    except distributed.KilledWorker:
        return {
            "error": "KilledWorker: every worker process that started it died, because it crashed or ran out of memory"
        }
    except Exception as error:  # raised by dask: `perform` catches exceptions of the function
        return {"error": f"{type(error).__name__}: {error}"}


def perform(pickled: bytes, wanted: list[str]) -> dict[str, Any]:
    """Call the function of a job on a worker, and return the fields of its result."""
    began = time.perf_counter()
    try:
        if versions() != wanted:
            own, needed = (" with OpenMM ".join(both) for both in (versions(), wanted))
            raise RuntimeError(
                f"this worker has openmm-exactrb {own}, but the jobs need openmm-exactrb {needed}: start the workers "
                "in the Python environment that creates the jobs"
            )
        job = pickle.loads(pickled)
        fields = {"value": _as_from_json(job.function(**job.arguments))}
    except (Exception, SystemExit) as error:
        fields = {"error": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
    return {**fields, "seconds": time.perf_counter() - began}


def _as_from_json(value: Any) -> Any:
    """Return a value as JSON would return it, so that new results equal stored ones."""

    def listed(part: Any) -> Any:
        if isinstance(part, (np.ndarray, np.generic)):
            return part.tolist()
        raise TypeError(f"a result must be numbers, text, lists, mappings or numpy arrays, not {shown(part)}")

    return json.loads(json.dumps(value, default=listed))


@contextmanager
def client_of(scheduler: str | None, workers: int | None, jobs: int) -> Iterator[distributed.Client]:
    """Connect to a scheduler, or start one on this machine with at most one worker for each job."""
    if scheduler is None:
        with (
            dask.config.set(_LOCAL),
            _cluster(min(workers or CPU_COUNT, jobs)) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield client
        return
    try:
        client = distributed.Client(scheduler, timeout=TIMEOUT, set_as_default=False)
    except (OSError, TypeError, ValueError) as error:
        raise ConnectionError(
            f"no dask scheduler answers at {scheduler!r} ({error}): check the address, or start a scheduler"
        ) from error
    with client:
        yield client


def _cluster(workers: int) -> distributed.LocalCluster:
    options = {"threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": logging.ERROR}
    try:
        return distributed.LocalCluster(n_workers=workers, **options)
    except RuntimeError as error:
        raise RuntimeError(
            f"a worker process exited at startup ({error}): if memory was short, use fewer workers; in a script, put "
            "this call in the block 'if __name__ == \"__main__\":'"
        ) from error
