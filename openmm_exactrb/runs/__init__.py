"""Runs that survive interruptions: checkpoints, and output files that a resumed run truncates to the last checkpoint.

`Run` in `run` is the public class. `identity` determines which run a checkpoint belongs to, `checkpoint` is the file,
`outputs` are the files of the reporters, `lock` keeps other processes out of the folder, and `signals` records requests
to stop.
"""

from openmm_exactrb.runs.checkpoint import CHECKPOINT
from openmm_exactrb.runs.outputs import TOPOLOGY
from openmm_exactrb.runs.run import Run

__all__ = ["CHECKPOINT", "TOPOLOGY", "Run"]
