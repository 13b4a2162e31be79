"""The checkpoint file: a state, and the lengths of all output files at it, whole or not at all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from openmm_exactrb.files import written_whole

#: Name of the file.
CHECKPOINT = "checkpoint"
#: What a file begins with: another format is refused.
FORMAT = b"4"

_MAGIC = b"openmm-exactrb checkpoint"


class Checkpoint(NamedTuple):
    """What a checkpoint file holds.

    Attributes
    ----------
    step, first : int
        Where it was written, and where the run began.
    wall : float
        Seconds that the run took up to here.
    timings : dict
        Of the integrator, by name.
    files : dict
        Length and first bytes, in hexadecimal, of each output file.
    chapters : list of dict
        What tells the run apart, by name: of each stretch of it that had other settings than the one before.
    state : bytes
        OpenMM's checkpoint.
    """

    step: int
    first: int
    wall: float
    timings: dict[str, float]
    files: dict[str, tuple[int, str]]
    chapters: list[dict[str, str]]
    state: bytes

    @property
    def identity(self) -> dict[str, str]:
        """What tells the last chapter apart, which is the one to go on with."""
        return self.chapters[-1]

    def chapter_of(self, identity: Mapping[str, str], after: int, file: Path) -> int:
        """Return which chapter a run is in: the one that it was in before, or the next one.

        Parameters
        ----------
        identity : mapping
            Of the run.
        after : int
            The chapter that it was in.
        file : path
            Of this checkpoint, for the message.

        Raises
        ------
        ValueError
            If it is neither.
        """
        possible = self.chapters[after : after + 2]
        if identity not in possible:
            nearest = min(possible, key=lambda there: len(list(differences(there, identity))))
            refuse_others(nearest, identity, file)
        return after + possible.index(dict(identity))

    def refuse_cut_files(self, folder: Path) -> None:
        """Raise ValueError if an output file is shorter than it was."""
        for name, (length, _) in self.files.items():
            other = folder / name
            found = other.stat().st_size if other.exists() else 0
            if found < length:
                raise ValueError(f"{other} has {found} bytes, but had {length} at the checkpoint: it was changed since")


def refuse_others(
    there: Mapping[str, str], here: Mapping[str, str], file: Path, names: Collection[str] | None = None
) -> None:
    """Raise ValueError if a run is not the one of a checkpoint.

    Parameters
    ----------
    there, here : mapping
        What tells the run of the checkpoint apart, and the one that is to go on.
    file : path
        Of the checkpoint, for the message.
    names : collection of str, optional
        What is looked at; everything unless given.
    """
    for name, was, now in differences(there, here):
        if names is None or name in names:
            raise ValueError(f"{file} is of another run: {name} is {was} in it, but {now} now")


def differences(there: Mapping[str, str], here: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    """Yield the names by which two runs differ, each with what it is there and here."""
    for name in {**there, **here}:
        was, now = there.get(name, "not there"), here.get(name, "not there")
        if was != now:
            yield name, was, now


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
