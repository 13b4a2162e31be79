"""Runs that survive accidents: checkpoints, and output files that are cut back to them before a run goes on.

`Run` in `run` is what a user makes. The others do one thing each: `options` are those of a command line, `identity` is
what must be the same for a run to be resumed, `checkpoint` is the file that it is resumed from, `outputs` are the files
that grow, `lock` keeps other processes out of the folder, and `signals` notes who wants the run to end.
"""

from openmm_exactrb.runs.checkpoint import CHECKPOINT
from openmm_exactrb.runs.outputs import TOPOLOGY
from openmm_exactrb.runs.run import Run

__all__ = ["CHECKPOINT", "TOPOLOGY", "Run"]
