"""Where a run comes from, for records that grow over many commands."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterable, Mapping

import openmm

import openmm_exactrb as rb
from benchmarks.common.records import ROOT

#: The columns of `provenance` in records, which pages do not show.
PROVENANCE = "openmm", "commit", "load"
#: The columns of `of_run`.
OF_RUN = "engine", "platform", "openmm", "commit"


def commit() -> str:
    """Return the commit that is checked out, abbreviated."""
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def provenance() -> dict[str, str]:
    """Return the version of OpenMM, the commit and the load of the machine."""
    return dict(zip(PROVENANCE, (openmm.__version__, commit(), f"{os.getloadavg()[0]:.1f}"), strict=True))


def of_run(context: openmm.Context) -> dict[str, str]:
    """Return the engine of a Context that has made steps, its platform, the version of OpenMM and the commit.

    The engine is "openmm" for integrators of OpenMM.
    """
    integrator = context.getIntegrator()
    engine = integrator.getEngine() if isinstance(integrator, rb.ExactRigidBodyIntegrator) else "openmm"
    found = engine, context.getPlatform().getName(), openmm.__version__, commit()
    return dict(zip(OF_RUN, found, strict=True))


def of_runs(origins: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Return `of_run` for a row that several runs share; where they differ, the values are joined by spaces."""
    origins = list(origins)
    return {name: " ".join(dict.fromkeys(origin[name] for origin in origins)) for name in OF_RUN}
