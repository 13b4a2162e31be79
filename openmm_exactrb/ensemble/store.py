"""Results on disk: a folder with one file for each finished recipe."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import openmm

from openmm_exactrb.ensemble.outcomes import Outcome
from openmm_exactrb.ensemble.recipes import Recipe, package_version
from openmm_exactrb.files import written_whole


@dataclass(frozen=True)
class Store:
    """A folder with one file for each finished recipe.

    Attributes
    ----------
    folder : path
        Made if it is not there.
    """

    folder: Path

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)

    def read(self, recipe: Recipe) -> Outcome | None:
        """Return the outcome of a recipe if it is here; what is not readable is not here.

        Warns
        -----
        UserWarning
            If it was computed with other versions of this package or OpenMM.
        """
        try:
            record = json.loads(self._file(recipe).read_text("utf-8"))
            outcome = Outcome(recipe, record["result"], seconds=record["seconds"], kept=True)
            there = {name: record["versions"][name] for name in _versions()}
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None
        self._compare(there, _versions())
        return outcome

    def write(self, outcome: Outcome) -> None:
        """Keep an outcome, unless it is a failure."""
        if outcome.error is not None:
            return
        record = {
            "recipe": repr(outcome.recipe),
            "versions": _versions(),
            "seconds": outcome.seconds,
            "result": outcome.result,
        }
        # Another process may be finishing the same recipe.
        with written_whole(self._file(outcome.recipe), part=f".{os.getpid()}.part") as file:
            file.write(json.dumps(record, indent=1) + "\n")

    def _compare(self, there: dict[str, str], here: dict[str, str]) -> None:
        """Warn of results of other versions: in the same words for all of them, which Python shows once."""
        other = [name for name in here if there[name] != here[name]]
        if other:
            theirs, ours = (" and ".join(f"{name} {of[name]}" for name in other) for of in (there, here))
            warnings.warn(
                f"results in {self.folder} are of {theirs}, and this is {ours}: they are handed over as they are; take "
                "another folder to have them computed anew",
                stacklevel=3,
            )

    def _file(self, recipe: Recipe) -> Path:
        return self.folder / f"{recipe.key}.json"


def _versions() -> dict[str, str]:
    """Return the versions of what computes here."""
    return {"openmm-exactrb": package_version(), "openmm": openmm.Platform.getOpenMMVersion()}
