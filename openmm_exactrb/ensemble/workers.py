"""Worker processes of dask.distributed: recipes are sent to them, and what comes back becomes an Outcome."""

from __future__ import annotations

import logging
import pickle
import time
import traceback
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from openmm_exactrb.ensemble.names import refuse_other_files
from openmm_exactrb.ensemble.outcomes import Outcome, plain
from openmm_exactrb.ensemble.recipes import Recipe, package_version

#: Seconds to wait for a scheduler to answer.
PATIENCE = 20.0

# All that is known of a recipe whose workers died; what its function raises is reported by `perform`.
_DEADLY = {"error": "KilledWorker: every process that began it died, by a crash, for memory, or by somebody's hand"}


def computed(client: Any, recipes: list[Recipe]) -> Iterator[Outcome]:
    """Send recipes to the workers and yield outcomes as they come."""
    suspects = []
    for recipe, fields in _done(client, recipes):
        if fields is _DEADLY:
            suspects.append(recipe)
        else:
            yield Outcome(recipe, **fields)
    # The scheduler gave these up, since several workers died that held them. They may have waited there while another
    # one killed the worker: each has its last chance alone.
    for suspect in suspects:
        for recipe, fields in _done(client, [suspect]):
            yield Outcome(recipe, **fields)


def _done(client: Any, recipes: list[Recipe]) -> Iterator[tuple[Recipe, dict[str, Any]]]:
    """Send recipes to the workers and yield the fields of their outcomes as they come."""
    call = uuid.uuid4().hex  # another call on the same scheduler may hold futures of the same recipes
    keys = [f"exactrb-{recipe.key}-{call}" for recipe in recipes]
    parcels = [packed(recipe) for recipe in recipes]
    futures = client.map(perform, parcels, [package_version()] * len(recipes), key=keys, pure=False)
    recipe_of = dict(zip(keys, recipes, strict=True))
    try:
        for future in dask_distributed().as_completed(futures, loop=client.loop):
            yield recipe_of[future.key], _received(future)
            future.release()
    finally:
        client.cancel([future for future in futures if not future.done()])


def _received(future: Any) -> dict[str, Any]:
    """Return the fields of an outcome; wait, if it was lost with its worker and is computed anew."""
    distributed = dask_distributed()
    try:
        fields: dict[str, Any] = future.result()
    except distributed.CancelledError as error:
        raise ConnectionError(
            "the scheduler has gone: what is finished is kept, the same call goes on there"
        ) from error
    except distributed.KilledWorker:
        return _DEADLY
    except Exception as error:  # what the function raises, `perform` reports; this is dask's own
        return {"error": f"{type(error).__name__}: {error}"}
    return fields


def packed(recipe: Recipe) -> bytes:
    """Pickle a recipe; only `perform` unpacks it, since a worker that cannot import its module would hang."""
    import cloudpickle

    return bytes(cloudpickle.dumps(recipe))


def perform(parcel: bytes, wanted: str) -> dict[str, Any]:
    """Call the function of a recipe, on a worker; return the fields of its Outcome."""
    began = time.perf_counter()
    try:
        if package_version() != wanted:
            raise RuntimeError(f"this worker has openmm-exactrb {package_version()}, the recipes come from {wanted}")
        recipe = pickle.loads(parcel)
        refuse_other_files(recipe.files)
        report = {"result": plain(recipe.function(**recipe.arguments))}
    except (Exception, SystemExit) as error:
        report = {"error": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
    return {**report, "seconds": time.perf_counter() - began}


@contextmanager
def client_of(scheduler: str | None, workers: int) -> Iterator[Any]:
    """Connect to a scheduler, or start one with workers on this machine."""
    distributed = dask_distributed()
    if scheduler is None:
        with (
            _patient(),
            _cluster(workers) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield client
        return
    try:
        client = distributed.Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f"no dask scheduler answers at {scheduler!r}: {error}") from error
    with client:
        yield client


def _cluster(workers: int) -> Any:
    """Start a scheduler with workers on this machine."""
    try:
        return dask_distributed().LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.ERROR
        )
    except RuntimeError as error:
        raise RuntimeError(
            f"a worker process ended while it started ({error}): it was killed, for memory perhaps, or the script "
            "lacks an if __name__ == '__main__'. What is finished is kept, and the same call goes on there"
        ) from error


def _patient() -> Any:
    """Have a LocalCluster wait for its workers to come back, however long.

    It dismisses, for good, one that is away at the moment when an earlier death of it is 15 s old, even if it is just
    starting again; the last one dismissed would leave the ensemble waiting for ever.
    """
    import dask

    return dask.config.set({"distributed.deploy.lost-worker-timeout": "7 days"})


def dask_distributed() -> Any:
    """Import dask.distributed, which is not needed for anything else."""
    try:
        import distributed
        import tqdm  # noqa: F401
    except ImportError as error:
        raise ImportError(f"ensembles need dask ({error}): python -m pip install 'dask[distributed]' tqdm") from error
    return distributed


def cores() -> int:
    """Return the number of cores that this process may use."""
    from dask.system import CPU_COUNT

    return int(CPU_COUNT)
