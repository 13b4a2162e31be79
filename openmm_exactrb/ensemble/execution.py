"""Execution of jobs: stored results are read, the other jobs are sent to workers, and their results are stored."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from openmm_exactrb.ensemble.jobs import Job, Result
from openmm_exactrb.support.checks import whole
from openmm_exactrb.support.files import written_whole
from openmm_exactrb.support.messages import shown


def run(jobs: Iterable[Job], folder: str | os.PathLike[str], **options: Any) -> list[Result]:
    """Execute jobs and return their results in the same order; options are those of `as_completed`."""
    jobs = list(jobs)
    results = {result.job: result for result in as_completed(jobs, folder, **options)}
    return [results[job] for job in jobs]


def as_completed(
    jobs: Iterable[Job],
    folder: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Iterator[Result]:
    """Execute jobs and yield their results as the jobs complete, stored results first.

    A job whose function raises an exception, or that repeatedly kills its workers, yields a result with the error. A
    later call tries the job again. Jobs of a worker process that dies are restarted on another worker. Closing the
    iterator cancels the remaining jobs.

    Parameters
    ----------
    jobs : iterable of Job
        The jobs; equal jobs are executed once.
    folder : path
        Folder with one JSON file for each successful job. Delete a file to have its job executed again.
    scheduler : str, optional
        Address of a dask scheduler, such as "tcp://node:8786". Its workers must have one thread each, the same version
        of this package, and the modules of the functions. By default, worker processes are started on this machine.
    workers : int, optional
        Number of processes on this machine, each with one thread; by default one process per core.
    progress : bool, optional
        Whether to show a progress bar on stderr.

    Yields
    ------
    Result

    Raises
    ------
    TypeError, ValueError
        If a job is not a `Job`, or both scheduler and workers are given. No job is started in this case.
    ConnectionError
        If the scheduler does not answer, or the connection to it is lost. Earlier results are stored.

    Notes
    -----
    In a script, call this function under ``if __name__ == "__main__":``, because workers import the script and
    would repeat the call.
    """
    distinct = list(dict.fromkeys(jobs))
    for job in distinct:
        if not isinstance(job, Job):
            raise TypeError(f"jobs must be Job objects, not {shown(job)}")
    if scheduler is not None and workers is not None:
        raise ValueError(
            "scheduler= and workers= are mutually exclusive, because a scheduler has its own workers: omit one of "
            "these arguments"
        )
    if workers is not None:
        workers = whole(workers, "workers")
    try:
        import distributed  # noqa: F401
        from tqdm import tqdm
    except ImportError as error:
        raise ImportError(
            f"ensembles need dask and tqdm ({error}): run `python -m pip install 'dask[distributed]' tqdm`"
        ) from error
    Path(folder).mkdir(parents=True, exist_ok=True)
    results = _results(distinct, Path(folder), scheduler, workers)
    pause = 0.1 if sys.stderr.isatty() else 5.0
    return iter(tqdm(results, "ensemble", len(distinct), unit="run", mininterval=pause, disable=not progress))


def _results(jobs: list[Job], folder: Path, scheduler: str | None, workers: int | None) -> Iterator[Result]:
    """Yield stored results, then execute the other jobs and yield their results."""
    stored = {job: stored_result(job, folder) for job in jobs}
    yield from (result for result in stored.values() if result is not None)
    missing = [job for job, result in stored.items() if result is None]
    if not missing:
        return
    from openmm_exactrb.ensemble.workers import client_of, completed  # slow to import

    with client_of(scheduler, workers, len(missing)) as client:
        for result in completed(client, missing):
            if result.error is None:
                _store(result, folder)
            yield result


def stored_result(job: Job, folder: Path) -> Result | None:
    """Return the result of a job from its file in a folder; None if the file is missing or damaged."""
    try:
        record = json.loads((folder / f"{job.key}.json").read_text(encoding="utf-8"))
        return Result(job, record["value"], seconds=record["seconds"], cached=True)
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None


def _store(result: Result, folder: Path) -> None:
    record = {"job": repr(result.job), "seconds": result.seconds, "value": result.value}
    # Another process may be finishing the same job.
    with written_whole(folder / f"{result.job.key}.json", part=f".{os.getpid()}.part") as file:
        file.write(json.dumps(record, indent=1) + "\n")
