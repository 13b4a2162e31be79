"""Where a run comes from, for records that grow over many commands."""

from __future__ import annotations

import subprocess

from benchmarks.common.records import ROOT


def commit() -> str:
    """Return the commit that is checked out, abbreviated."""
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
