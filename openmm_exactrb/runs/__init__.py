"""Runs that survive interruptions: checkpoints, and output files that a resumed run truncates to the last checkpoint.

`Run` in `run` is the public class. `identity` determines to which run a checkpoint belongs, `checkpoint` defines its
file, `outputs` manages the files of the reporters, and `signals` records requests to stop.
"""

from openmm_exactrb.runs.checkpoint import CHECKPOINT
from openmm_exactrb.runs.outputs import TOPOLOGY
from openmm_exactrb.runs.run import Run

__all__ = ["CHECKPOINT", "TOPOLOGY", "Run"]
