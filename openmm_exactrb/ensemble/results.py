"""Results of jobs, and the files that store them."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from openmm_exactrb.ensemble.jobs import Job
from openmm_exactrb.files import written_whole


@dataclass(frozen=True)
class Result:
    """The result of a job.

    Attributes
    ----------
    job : Job
    value : object
        The return value of its function, as JSON holds it; None if it failed.
    error, traceback : str or None
        Of the exception if it failed.
    seconds : float
        Wall time of the call, on its worker.
    cached : bool
        Whether it was read from disk.
    """

    job: Job
    value: Any = None
    error: str | None = None
    traceback: str | None = None
    seconds: float = 0.0
    cached: bool = False


def read(job: Job, folder: Path) -> Result | None:
    """Return the stored result of a job; None if there is none, or its file is damaged."""
    try:
        record = json.loads(_file(job, folder).read_text("utf-8"))
        return Result(job, record["value"], seconds=record["seconds"], cached=True)
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None


def write(result: Result, folder: Path) -> None:
    """Store a result."""
    record = {"job": repr(result.job), "seconds": result.seconds, "value": result.value}
    # Another process may be finishing the same job.
    with written_whole(_file(result.job, folder), part=f".{os.getpid()}.part") as file:
        file.write(json.dumps(record, indent=1) + "\n")


def _file(job: Job, folder: Path) -> Path:
    return folder / f"{job.key}.json"
