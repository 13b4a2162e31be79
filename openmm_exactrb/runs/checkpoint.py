"""The checkpoint file: a state, and the lengths of all output files at it, whole or not at all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from openmm_exactrb.files import written_whole

#: Name of the file.
CHECKPOINT = "checkpoint"
#: What a file begins with: another format is refused.
FORMAT = b"3"

_MAGIC = b"openmm-exactrb checkpoint"


class Checkpoint(NamedTuple):
    """What a checkpoint file holds.

    Attributes
    ----------
    step : int
    wall : float
        Seconds that the run took up to here.
    timings : dict
        Of the integrator, by name.
    files : dict
        Length and first bytes, in hexadecimal, of each output file.
    identity : dict
        What must be the same for the run to be resumed, by name.
    state : bytes
        OpenMM's checkpoint.
    """

    step: int
    wall: float
    timings: dict[str, float]
    files: dict[str, tuple[int, str]]
    identity: dict[str, str]
    state: bytes

    def refuse_others(self, identity: Mapping[str, str], file: Path) -> None:
        """Raise ValueError if a run is not the one of this checkpoint, or files of it were cut since.

        Parameters
        ----------
        identity : mapping
            Of the run that is to go on.
        file : path
            Of this checkpoint; the other files lie beside it.
        """
        for name in {**self.identity, **identity}:
            there, here = self.identity.get(name, "not there"), identity.get(name, "not there")
            if there != here:
                raise ValueError(f"{file} is of another run: {name} is {there} in it, but {here} now")
        for name, (length, _) in self.files.items():
            other = file.with_name(name)
            found = other.stat().st_size if other.exists() else 0
            if found < length:
                raise ValueError(f"{other} has {found} bytes, but had {length} at the checkpoint: it was changed since")


def write(file: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint: a line with format and checksum, a line of JSON, the state of OpenMM."""
    about = json.dumps({name: value for name, value in checkpoint._asdict().items() if name != "state"})
    body = about.encode() + b"\n" + checkpoint.state
    with written_whole(file, "wb") as out:
        out.write(b" ".join([_MAGIC, FORMAT, hashlib.sha256(body).hexdigest().encode()]) + b"\n" + body)


def read(file: Path, overwrite: str = "overwrite=True") -> Checkpoint:
    """Read a checkpoint, if it is whole.

    Parameters
    ----------
    file : path
    overwrite : str, optional
        What a user is told to add in order to begin anew.

    Raises
    ------
    ValueError
        If it is damaged or of another format.
    """
    head, _, body = file.read_bytes().partition(b"\n")
    words = head.rsplit(b" ", 2)
    if len(words) != 3 or words[0] != _MAGIC:
        raise ValueError(f"{file} is no checkpoint, or a damaged one: begin anew in another folder or with {overwrite}")
    if words[1] != FORMAT:
        raise ValueError(f"{file} was written by another version of openmm-exactrb, in format {words[1].decode()}")
    if words[2] != hashlib.sha256(body).hexdigest().encode():
        raise ValueError(f"{file} is truncated or damaged: begin anew in another folder or with {overwrite}")
    about, _, state = body.partition(b"\n")
    return Checkpoint(**json.loads(about), state=state)
