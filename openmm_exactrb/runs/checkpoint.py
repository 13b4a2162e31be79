"""The checkpoint file, which is written atomically: a state and the lengths of all output files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from openmm_exactrb.engines.catalogue import named
from openmm_exactrb.support.files import written_whole

#: Name of the file.
CHECKPOINT = "checkpoint"
#: Version of the file format; files of other versions raise an error.
FORMAT = b"5"
_MAGIC = b"openmm-exactrb checkpoint"


class Checkpoint(NamedTuple):
    """The content of a checkpoint file."""

    #: Step number of the checkpoint, and of the start of the run.
    step: int
    first: int
    #: Wall time in s of the run until the checkpoint.
    wall: float
    #: Timings of the integrator, by name.
    timings: dict[str, float]
    #: Length and first bytes, in hexadecimal, of each output file.
    files: dict[str, tuple[int, str]]
    #: Values that must be the same for the run to be resumed, by name.
    identity: dict[str, str]
    #: OpenMM's checkpoint.
    state: bytes

    def check_same_run(self, identity: Mapping[str, str], file: Path) -> None:
        """Raise ValueError if the identity of the run differs from that of the checkpoint."""
        for name in {**self.identity, **identity}:
            was, now = self.identity.get(name, "not there"), identity.get(name, "not there")
            was = named(was) if name == "integrator engine" else was
            if was != now:
                raise ValueError(
                    f"{file} belongs to another run, in which {name} was {was}, but now it is {now}: restore this "
                    "value, use another folder, or overwrite the run (overwrite=True or --overwrite)"
                )

    def check_cut_files(self, folder: Path) -> None:
        """Raise ValueError if an output file is shorter than it was at the checkpoint."""
        for name, (length, _) in self.files.items():
            file = folder / name
            found = file.stat().st_size if file.exists() else 0
            if found < length:
                raise ValueError(
                    f"{file} has {found} bytes, but had {length} at the checkpoint: restore the file, or overwrite "
                    "the run (overwrite=True or --overwrite)"
                )


def write(file: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint: a line with format and checksum, a line of JSON, and OpenMM's checkpoint."""
    about = json.dumps({name: value for name, value in checkpoint._asdict().items() if name != "state"})
    body = about.encode() + b"\n" + checkpoint.state
    with written_whole(file, "wb") as out:
        out.write(b" ".join([_MAGIC, FORMAT, hashlib.sha256(body).hexdigest().encode()]) + b"\n" + body)


def read(file: Path) -> Checkpoint:
    """Read a checkpoint; raise ValueError if it is damaged or has another format."""
    head, _, body = file.read_bytes().partition(b"\n")
    words = head.rsplit(b" ", 2)
    if len(words) == 3 and words[0] == _MAGIC and words[1] != FORMAT:
        raise ValueError(
            f"{file} was written by another version of openmm-exactrb, in format {words[1].decode(errors='replace')!r} "
            f"instead of {FORMAT.decode()!r}: resume the run with that version"
        )
    if words != [_MAGIC, FORMAT, hashlib.sha256(body).hexdigest().encode()]:
        raise ValueError(
            f"{file} is damaged or is not a checkpoint: use another folder, or overwrite the run (overwrite=True or "
            "--overwrite)"
        )
    about, _, state = body.partition(b"\n")
    return Checkpoint(**json.loads(about), state=state)
