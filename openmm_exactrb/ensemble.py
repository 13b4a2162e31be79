"""Many independent runs on dask.distributed.

A `Recipe` is a function and its arguments. `run` and `as_completed` send recipes to worker processes, on this machine
or on a cluster, start those of a worker that dies again, and keep every finished one in a folder, so that the same
command goes on where it stopped.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import logging
import os
import pickle
import sys
import time
import traceback
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import product
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.schemes import Scheme

__all__ = ["Outcome", "Recipe", "as_completed", "energies", "run", "sweep"]

# Seconds to wait for a scheduler to answer.
_PATIENCE = 20.0
# What makes the forces of a platform the same numbers at every run.
_DETERMINISTIC = {"CPU": {"Threads": "1", "DeterministicForces": "true"}}
# All that is known of a recipe whose workers died; what its function raises is reported by `_perform`.
_DEADLY = {"error": "KilledWorker: every process that began it died, by a crash, for memory, or by somebody's hand"}
_SERIALISABLE = (openmm.System, openmm.State, openmm.Force, openmm.Integrator)


@dataclass(frozen=True, init=False, eq=False)
class Recipe:
    """One run: a function, and the arguments that it is called with.

    Parameters
    ----------
    function : callable
        A function at the top level of a module that the workers can import, or of the script that is run. It returns
        what JSON can hold: numbers, texts, lists, mappings with texts as keys, and numpy arrays, which become lists.
        For the same numbers at every call it takes all that it depends on as arguments, seeds too.
    **arguments
        Numbers, texts, lists, mappings, numpy arrays, paths, Quantities, functions, dataclasses such as a `Scheme`,
        or a System, State, Force or Integrator of OpenMM. Large ones travel with every recipe: hand over the path of a
        file, or a function that builds, instead.

    Raises
    ------
    TypeError
        If the function cannot be found by name, does not take these arguments, or one of them has no stable text.

    Attributes
    ----------
    key : str
        Hash of the function's name, the arguments and the version of this package. It does not know the function's
        code: after a change there take another folder.

    Examples
    --------
    >>> from openmm_exactrb import dipole_fluid
    >>> recipe = Recipe(energies, build=dipole_fluid, n=8, step=0.05, duration=1.0, seed=3)
    >>> recipe
    Recipe(openmm_exactrb.ensemble.energies, build=dipole_fluid, n=8, step=0.05, duration=1.0, seed=3)
    >>> recipe == Recipe(energies, seed=3, n=8, step=0.05, duration=1.0, build=dipole_fluid)
    True
    """

    function: Callable[..., Any]
    arguments: Mapping[str, Any]
    key: str

    def __init__(self, function: Callable[..., Any], /, **arguments: Any) -> None:
        name = _name(function)
        try:
            inspect.signature(function).bind(**arguments)
        except TypeError as error:
            raise TypeError(f"{name} cannot be called with these arguments: {error}") from None
        text = {argument: _canonical(value, argument) for argument, value in arguments.items()}
        words = json.dumps([_version(), name, text], sort_keys=True)
        object.__setattr__(self, "function", function)
        object.__setattr__(self, "arguments", dict(arguments))
        object.__setattr__(self, "key", hashlib.sha256(words.encode()).hexdigest()[:32])

    def __repr__(self) -> str:
        values = (f"{name}={_shown(value)}" for name, value in self.arguments.items())
        return f"Recipe({', '.join([_name(self.function), *values])})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Recipe) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


@dataclass(frozen=True)
class Outcome:
    """What became of a recipe.

    Attributes
    ----------
    recipe : Recipe
    result : object
        What its function returned, as JSON holds it; None if it failed.
    error : str or None
        Type and message of what it failed with.
    traceback : str or None
        Where that happened.
    seconds : float
        Wall time of the call, on its worker.
    kept : bool
        Whether it was on disk already.
    """

    recipe: Recipe
    result: Any = None
    error: str | None = None
    traceback: str | None = None
    seconds: float = 0.0
    kept: bool = False


def sweep(function: Callable[..., Any], axes: Mapping[str, Iterable[Any]], **fixed: Any) -> list[Recipe]:
    """Make the recipes of all combinations of arguments.

    Parameters
    ----------
    function : callable
    axes : mapping
        Argument to its values. The last one varies fastest.
    **fixed
        Arguments that are the same in all recipes.

    Returns
    -------
    list of Recipe

    Examples
    --------
    >>> from openmm_exactrb import dipole_fluid
    >>> axes = {"seed": range(100), "scheme": ["V2", "SRKN4_6b"]}
    >>> len(sweep(energies, axes, build=dipole_fluid, step=0.05, duration=1.0))
    200
    """
    for name, values in axes.items():
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise TypeError(f"axis {name} must be a list of values, not {values!r}")
    return [Recipe(function, **dict(zip(axes, values, strict=True)), **fixed) for values in product(*axes.values())]


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
    if workers is not None and (not isinstance(workers, int) or workers < 1):
        raise ValueError(f"workers must be a whole number of at least 1, not {workers!r}")
    _distributed()
    return _outcomes(recipes, _Store(Path(folder)), scheduler, workers, progress)


def energies(
    build: Callable[..., Any],
    *,
    step: float,
    duration: float,
    scheme: str | Scheme = "SRKN4_6b",
    rotor: str = "exact",
    temperature: float | None = None,
    seed: int = 0,
    frames: int = 100,
    platform: str = "Reference",
    **arguments: Any,
) -> dict[str, Any]:
    """Run rigid-body dynamics and return its energies; ready for a `Recipe`.

    Parameters
    ----------
    build : callable
        ``build(**arguments)`` returns (topology, system, positions) or (topology, system, positions, velocities), as
        `openmm_exactrb.dipole_fluid` and `openmm_exactrb.rigid_water` do. It gets the seed too if it takes one.
    step, duration : float
        In ps.
    scheme, rotor
        As `ExactRigidBodyIntegrator` takes them.
    temperature : float, optional
        In K. Momenta are drawn with the seed; without it they are those of the velocities, or zero.
    seed : int, optional
    frames : int, optional
        Samples after the first one, evenly spread over the steps.
    platform : str, optional
        With "CPU", its one thread and its deterministic forces are chosen.
    **arguments
        For `build`.

    Returns
    -------
    dict
        "times" in ps and "energies" (total) in kJ/mol, lists of one length; "steps" and "evaluations" (of forces).

    Raises
    ------
    NonFiniteError
        If the run blows up.
    """
    seeded = {"seed": seed} if "seed" in inspect.signature(build).parameters else {}
    _, system, positions, *velocities = build(**arguments, **seeded)
    integrator = ExactRigidBodyIntegrator(step, scheme=scheme, rotor=rotor)
    kind = openmm.Platform.getPlatform(platform)
    context = openmm.Context(system, integrator, kind, _DETERMINISTIC.get(platform, {}))
    context.setPositions(positions)
    if velocities:
        context.setVelocities(velocities[0])
    if temperature is not None:
        integrator.setVelocitiesToTemperature(temperature, seed)
    steps = max(1, round(duration / step))
    stops = np.unique(np.linspace(0, steps, min(frames, steps) + 1).round().astype(int))
    table = [_time_and_energy(context, integrator)]
    integrator.timings.reset()
    for stride in np.diff(stops).tolist():
        integrator.step(stride)
        table.append(_time_and_energy(context, integrator))
    times, totals = zip(*table, strict=True)
    return {"times": times, "energies": totals, "steps": steps, "evaluations": integrator.timings.evaluations}


def _time_and_energy(context: openmm.Context, integrator: ExactRigidBodyIntegrator) -> tuple[float, float]:
    """Return the time in ps and the total energy in kJ/mol."""
    return context.getTime()._value, integrator.totalEnergy()._value


# -- carrying out ---------------------------------------------------------------------------------------------------


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
    recipes: list[Recipe], store: _Store, scheduler: str | None, workers: int | None, progress: bool
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
        with _client(scheduler, min(workers or _cores(), len(missing))) as client:
            for outcome in _computed(client, missing):
                store.write(outcome)
                count(outcome)
                yield outcome


def _computed(client: Any, recipes: list[Recipe]) -> Iterator[Outcome]:
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
    parcels = [_packed(recipe) for recipe in recipes]
    futures = client.map(_perform, parcels, [_version()] * len(recipes), key=keys, pure=False)
    recipe_of = dict(zip(keys, recipes, strict=True))
    try:
        for future in _distributed().as_completed(futures, loop=client.loop):
            yield recipe_of[future.key], _received(future)
            future.release()
    finally:
        client.cancel([future for future in futures if not future.done()])


def _received(future: Any) -> dict[str, Any]:
    """Return the fields of an outcome; wait, if it was lost with its worker and is computed anew."""
    distributed = _distributed()
    try:
        fields: dict[str, Any] = future.result()
    except distributed.CancelledError as error:
        raise ConnectionError(
            "the scheduler has gone: what is finished is kept, the same call goes on there"
        ) from error
    except distributed.KilledWorker:
        return _DEADLY
    except Exception as error:  # what the function raises, `_perform` reports; this is dask's own
        return {"error": f"{type(error).__name__}: {error}"}
    return fields


def _packed(recipe: Recipe) -> bytes:
    """Pickle a recipe; only `_perform` unpacks it, since a worker that cannot import its module would hang."""
    import cloudpickle

    return bytes(cloudpickle.dumps(recipe))


def _perform(parcel: bytes, wanted: str) -> dict[str, Any]:
    """Call the function of a recipe, on a worker; return the fields of its Outcome."""
    began = time.perf_counter()
    try:
        if _version() != wanted:
            raise RuntimeError(f"this worker has openmm-exactrb {_version()}, the recipes come from {wanted}")
        recipe = pickle.loads(parcel)
        report = {"result": _plain(recipe.function(**recipe.arguments))}
    except (Exception, SystemExit) as error:
        report = {"error": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
    return {**report, "seconds": time.perf_counter() - began}


@contextmanager
def _client(scheduler: str | None, workers: int) -> Iterator[Any]:
    """Connect to a scheduler, or start one with workers on this machine."""
    distributed = _distributed()
    if scheduler is None:
        with (
            _patient(),
            distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.ERROR
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            yield client
        return
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f"no dask scheduler answers at {scheduler!r}: {error}") from error
    with client:
        yield client


def _patient() -> Any:
    """Have a LocalCluster wait for its workers to come back, however long.

    It dismisses, for good, one that is away at the moment when an earlier death of it is 15 s old, even if it is just
    starting again; the last one dismissed would leave the ensemble waiting for ever.
    """
    import dask

    return dask.config.set({"distributed.deploy.lost-worker-timeout": "7 days"})


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


def _distributed() -> Any:
    """Import dask.distributed, which is not needed for anything else."""
    try:
        import distributed
        import tqdm  # noqa: F401
    except ImportError as error:
        raise ImportError(f"ensembles need dask ({error}): pip install openmm-exactrb[ensemble]") from error
    return distributed


def _cores() -> int:
    """Return the number of cores that this process may use."""
    from dask.system import CPU_COUNT

    return int(CPU_COUNT)


@cache
def _version() -> str:
    """Return the version of this package."""
    try:
        return version("openmm-exactrb")
    except PackageNotFoundError:  # from a source folder on the path
        return "unknown"


# -- results on disk ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Store:
    """A folder with one file for each finished recipe."""

    folder: Path

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)

    def read(self, recipe: Recipe) -> Outcome | None:
        """Return the outcome of a recipe if it is here; what is not readable is not here."""
        try:
            record = json.loads(self._file(recipe).read_text("utf-8"))
            return Outcome(recipe, record["result"], seconds=record["seconds"], kept=True)
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None

    def write(self, outcome: Outcome) -> None:
        """Keep an outcome, unless it is a failure."""
        if outcome.error is not None:
            return
        record = {
            "recipe": repr(outcome.recipe),
            "versions": {"openmm-exactrb": _version(), "openmm": openmm.Platform.getOpenMMVersion()},
            "seconds": outcome.seconds,
            "result": outcome.result,
        }
        file = self._file(outcome.recipe)
        draft = file.with_suffix(f".{os.getpid()}.tmp")
        draft.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
        draft.replace(file)

    def _file(self, recipe: Recipe) -> Path:
        return self.folder / f"{recipe.key}.json"


def _plain(value: Any) -> Any:
    """Return a result as it comes back from JSON, so that a fresh one equals a kept one."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: _plain(item) for key, item in value.items()}
    raise TypeError(
        f"a result must be numbers, texts, lists, mappings with texts as keys, or numpy arrays, not {value!r}"
    )


# -- names and texts of what recipes hold ---------------------------------------------------------------------------


def _name(function: Any) -> str:
    """Return a function's name, by which a worker finds it and a later call knows it."""
    qualified = getattr(function, "__qualname__", None)
    if not callable(function) or qualified is None or "<" in qualified:
        raise TypeError(f"a function at the top level of a module is needed, which has a name, not {function!r}")
    return f"{_module(function.__module__)}.{qualified}"


def _module(name: str) -> str:
    """Return the name of a module; that of a script is the one under which it would be imported."""
    main = sys.modules.get("__main__")
    if name != "__main__" or main is None:
        return name
    spec, file = getattr(main, "__spec__", None), getattr(main, "__file__", None)
    return str(spec.name) if spec is not None else Path(file).stem if file else name


def _canonical(value: Any, where: str) -> Any:
    """Return what stands for an argument in JSON: the same for equal values, today and tomorrow."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple)):
        return [_canonical(item, where) for item in value]
    if isinstance(value, Mapping):
        pairs = [[_canonical(key, where), _canonical(item, where)] for key, item in value.items()]
        return {"mapping": sorted(pairs, key=lambda pair: json.dumps(pair[0]))}
    kind, text = _tagged(value, where)
    return {kind: text}


def _tagged(value: Any, where: str) -> tuple[str, Any]:
    """Return what kind of object an argument is, and what stands for it."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return "array", [value.dtype.str, list(value.shape), digest]
    if unit.is_quantity(value):
        return "quantity", [_canonical(value._value, where), str(value.unit)]
    if isinstance(value, os.PathLike):
        return "path", os.fspath(value)
    if isinstance(value, _SERIALISABLE):
        return "openmm", hashlib.sha256(openmm.XmlSerializer.serialize(value).encode()).hexdigest()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return type(value).__qualname__, _canonical(fields, where)
    if isinstance(value, (FunctionType, type)):
        return "function", _name(value)
    if type(value).__module__.startswith("openmm.app") and repr(value).isidentifier():  # PME, HBonds and the like
        return "option", repr(value)
    raise TypeError(f"argument {where} of a recipe cannot be {value!r}: hand over numbers, texts, or a file's path")


def _shown(value: Any) -> str:
    """Return a short text of an argument."""
    if isinstance(value, (FunctionType, type)):
        return value.__qualname__
    if isinstance(value, Scheme):
        return value.name
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
