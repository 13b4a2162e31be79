"""Corrections to OpenMM's trajectory reporters: the step of the first frame, and a check for lost frames.

Both corrections use private members of these reporters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from openmm import app


def begin_with_the_start(reporter: Any, simulation: Any, first: int, interval: int, append: bool) -> None:
    """Label the first frame of a trajectory with step `first`; OpenMM's reporters use a step one interval later."""
    about = simulation.integrator.getStepSize(), first, interval, append
    if isinstance(reporter, app.DCDReporter):
        reporter._dcd = app.DCDFile(reporter._out, _topology(reporter, simulation), *about)
    if isinstance(reporter, app.XTCReporter):
        reporter._xtc = app.XTCFile(reporter._fileName, _topology(reporter, simulation), *about)


def _topology(reporter: Any, simulation: Any) -> app.Topology:
    """Return the Topology of the atoms that a reporter writes."""
    if reporter._atomSubset is None:
        return simulation.topology
    topology, atoms = app.Topology(), list(simulation.topology.atoms())
    topology.setPeriodicBoxVectors(simulation.topology.getPeriodicBoxVectors())
    residue = topology.addResidue("", topology.addChain())
    for index in reporter._atomSubset:
        topology.addAtom(atoms[index].name, atoms[index].element, residue)
    return topology


def check_lost_frames(reporter: Any, file: Path) -> None:
    """Raise OSError if an XTC file lacks frames, because OpenMM ignores errors when writing frames."""
    if not isinstance(reporter, app.XTCReporter) or reporter._xtc._modelCount == 0:
        return
    written = reporter._xtc._modelCount
    try:
        found = reporter._xtc._getNumFrames()
    except Exception:  # any error that a truncated frame causes
        found = None
    if found != written:
        raise OSError(f"{file} does not contain all {written} frames that were written: check whether the disk is full")
