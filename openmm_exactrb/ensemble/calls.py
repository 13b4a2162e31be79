"""Carrying out recipes: those on disk are handed over, the others sent to workers and kept."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from openmm_exactrb.checks import whole
from openmm_exactrb.ensemble import workers as crew
from openmm_exactrb.ensemble.outcomes import Outcome
from openmm_exactrb.ensemble.recipes import Recipe
from openmm_exactrb.ensemble.store import Store


def run(
    recipes: Iterable[Recipe],
    folder: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> list[Outcome]:
    """Carry out recipes and return their outcomes in the same order; see `as_completed`."""
    recipes = list(recipes)
    outcomes = as_completed(recipes, folder, scheduler=scheduler, workers=workers, progress=progress)
    by_key = {outcome.recipe.key: outcome for outcome in outcomes}
    return [by_key[recipe.key] for recipe in recipes]


def as_completed(
    recipes: Iterable[Recipe],
    folder: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Iterator[Outcome]:
    """Carry out recipes and hand over their outcomes as they come, those on disk first.

    A recipe whose function raises is reported with its error and not tried again by this call; a later call tries it
    once more. The recipes of a worker process that dies are started again on another one; one that goes on killing its
    workers is reported too, in the end.
    Leaving the iterator early stops what is running.

    Parameters
    ----------
    recipes : iterable of Recipe
        All different.
    folder : path
        Where results are kept: one file of JSON for each finished recipe, which is there whole or not at all. Removing
        a file has its recipe done anew.
    scheduler : str, optional
        Address of a dask scheduler, such as "tcp://node:8786". Its workers need this package in the same version and
        the modules of the functions, and should have one thread each. Without it, worker processes are started on this
        machine.
    workers : int, optional
        Processes on this machine, each with one thread; one for each core unless given.
    progress : bool, optional
        Whether to show on stderr how far it is.

    Yields
    ------
    Outcome

    Raises
    ------
    TypeError, ValueError
        If recipes are none or given twice, or the options do not fit together. Before anything is started.
    ConnectionError
        If the scheduler does not answer, or goes away. What is finished is kept.

    Warns
    -----
    UserWarning
        If results in the folder were computed with another version of OpenMM; they are handed over as they are.

    Notes
    -----
    Each recipe is done by one thread from its arguments alone, so that results do not depend on the number of workers,
    on the order, or on what died meanwhile: `energies` gives the same bits on machines of one kind with the same
    packages.

    A script that calls this does so under ``if __name__ == "__main__":``, since workers import it.
    """
    recipes = _checked(recipes)
    if scheduler is not None and workers is not None:
        raise ValueError("workers are those of the scheduler: give one of scheduler and workers")
    if scheduler is not None and not isinstance(scheduler, str):
        raise TypeError(f"scheduler must be an address such as 'tcp://node:8786', not {scheduler!r}")
    if workers is not None:
        workers = whole(workers, "workers")
    crew.dask_distributed()
    return _outcomes(recipes, Store(Path(folder)), scheduler, workers, progress)


def _checked(recipes: Iterable[Recipe]) -> list[Recipe]:
    """Return recipes as a list, all different."""
    recipes = list(recipes)
    seen = set()
    for recipe in recipes:
        if not isinstance(recipe, Recipe):
            raise TypeError(f"recipes must be Recipe objects, not {recipe!r}")
        if recipe.key in seen:
            raise ValueError(f"the same recipe is given twice: {recipe!r}")
        seen.add(recipe.key)
    if not recipes:
        raise ValueError("there are no recipes")
    return recipes


def _outcomes(
    recipes: list[Recipe], store: Store, scheduler: str | None, workers: int | None, progress: bool
) -> Iterator[Outcome]:
    """Yield what is on disk, then what is computed."""
    with _progress(len(recipes), progress) as count:
        missing = []
        for recipe in recipes:
            outcome = store.read(recipe)
            if outcome is None:
                missing.append(recipe)
            else:
                count(outcome)
                yield outcome
        if not missing:
            return
        with crew.client_of(scheduler, min(workers or crew.cores(), len(missing))) as client:
            for outcome in crew.computed(client, missing):
                store.write(outcome)
                count(outcome)
                yield outcome


@contextmanager
def _progress(total: int, shown: bool) -> Iterator[Callable[[Outcome], None]]:
    """Show a bar on stderr; yield the function that counts an outcome."""
    from tqdm import tqdm

    failed = 0
    pause = 0.1 if sys.stderr.isatty() else 5.0
    with tqdm(total=total, desc="ensemble", unit="run", mininterval=pause, disable=not shown) as bar:

        def count(outcome: Outcome) -> None:
            nonlocal failed
            if outcome.error is not None:
                failed += 1
                bar.set_postfix(failed=failed, refresh=False)
            bar.update()

        yield count
