"""Where a run comes from, for records that grow over many commands."""

from __future__ import annotations

import os
import subprocess

import openmm

from benchmarks.common.records import ROOT

#: The columns of `provenance` in records, which pages do not show.
PROVENANCE = "openmm", "commit", "load"


def commit() -> str:
    """Return the commit that is checked out, abbreviated."""
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def provenance() -> dict[str, str]:
    """Return the version of OpenMM, the commit and the load of the machine."""
    return dict(zip(PROVENANCE, (openmm.__version__, commit(), f"{os.getloadavg()[0]:.1f}"), strict=True))
