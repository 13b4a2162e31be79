"""The context manager in which integrators of this package take the place of OpenMM's."""

from __future__ import annotations

import functools
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import openmm
from openmm import app, unit

from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.integrators.step_sizes import femtoseconds
from openmm_exactrb.openmm_access import parameters
from openmm_exactrb.openmm_access.units import not_negative, picoseconds
from openmm_exactrb.replacement.clock import changes_of_simulation
from openmm_exactrb.replacement.integrators import REPLACEMENTS, Replacement, replacement
from openmm_exactrb.replacement.record import Replaced
from openmm_exactrb.support import checks
from openmm_exactrb.systems.masses import heavy_hydrogens as make_heavy

# The longest step (ps) that was tried with light hydrogens, and the mass (amu) below which hydrogens are light.
_LONGEST, _HEAVY = 0.006, 2.5
_MODELLER = app.modeller.__name__  # creates integrators of its own, to relax membranes and to place hydrogens

_busy = threading.Lock()  # held while OpenMM's classes are changed


@contextmanager
def replace_integrators(
    interval: float | unit.Quantity | None = None,
    *,
    same_time: bool = False,
    heavy_hydrogens: bool = False,
    report: Callable[[str], object] | None = lambda text: print(text, file=sys.stderr),
) -> Iterator[Replaced]:
    """Let scripts and libraries create integrators of this package where they create OpenMM's by name.

    Within the ``with`` statement, each LangevinMiddleIntegrator and LangevinIntegrator is an
    `ExactRigidBodyLangevinIntegrator`, and each VerletIntegrator an `ExactRigidBodyIntegrator`, with the same
    arguments and the default scheme, whose step is one force evaluation. This also holds for names that were imported
    before, in all threads, and for subclasses of these classes. The integrators are instances of OpenMM's classes as
    well. After the ``with`` statement, also after an error, nothing of OpenMM is changed; the integrators that were
    created remain those of this package.

    Not replaced are integrators of other classes, integrators that OpenMM copies or reads from XML, those with a step
    of zero, and those of ``openmm.app.Modeller``. The record names the classes of integrators in Contexts that were
    not replaced.

    Parameters
    ----------
    interval : float or Quantity, optional
        The step of all integrators, in ps if given without a unit, instead of the steps of the script. The script makes
        as many steps as before, so that the simulated time changes.
    same_time : bool, optional
        Whether the simulated time remains the same. The script then counts its own steps, in ``step``, ``getStepSize``,
        ``Simulation.currentStep`` and the intervals of reporters, and several of these are one step. The frequencies of
        barostats are divided and rounded. States, checkpoints and ``Context.getStepCount`` contain the number of steps
        that are made.
    heavy_hydrogens : bool, optional
        Whether hydrogens of each System that ``createSystem`` returns have 3 amu, including those of water; see
        `openmm_exactrb.heavy_hydrogens`.
    report : callable, optional
        A function of a sentence, which is called for each kind of integrator when it is first created, and at the end.
        The default prints on stderr; None means no report.

    Yields
    ------
    Replaced
        A record of what was replaced, with the attributes ``integrators``, ``others``, ``steps``, ``forceEvaluations``,
        ``time``, ``openmmForceEvaluations`` and ``gain``.

    Raises
    ------
    ValueError
        If an argument is invalid, or within the statement: if a number of steps of the script is not a whole number of
        steps, or hydrogens are too light for the interval.
    RuntimeError
        If integrators are already being replaced in this process.
    """
    size = None if interval is None else _interval(interval)
    if checks.switch(same_time, "same_time") and size is None:
        raise ValueError("same_time needs an interval, the step that takes the place of the steps of the script")
    heavy = checks.switch(heavy_hydrogens, "heavy_hydrogens")
    if not _busy.acquire(blocking=False):
        raise RuntimeError("integrators are already being replaced in this process: leave the other with statement")
    record = Replaced(size, same_time, report or (lambda text: None))
    try:
        with ExitStack() as changes:
            for owner, name, attribute in _changes(record, heavy):
                changes.callback(setattr, owner, name, vars(owner)[name])
                setattr(owner, name, attribute)
            Replacement.present = record
            changes.callback(setattr, Replacement, "present", None)
            yield record
    finally:
        _busy.release()
        for line in record.lines():
            record.tell_once(line)


def _interval(interval: float | unit.Quantity) -> float:
    if not (size := not_negative(interval, unit.picosecond, "interval")):
        raise ValueError("interval must be positive, such as 8*femtoseconds, not 0")
    return size


def _changes(record: Replaced, heavy: bool) -> Iterator[tuple[Any, str, Any]]:
    """Yield the changes of OpenMM as (owner, name, attribute)."""
    for replaced in REPLACEMENTS:
        yield replaced, "__init__", _creating(replaced, record)
    yield openmm.Context, "__init__", _entering(record)
    yield from changes_of_simulation(record.clock)
    for owner in [kind for kind in vars(app).values() if isinstance(kind, type) and "createSystem" in vars(kind)]:
        if heavy:
            yield owner, "createSystem", _heavy(owner, record)


def _creating(replaced: type[Any], record: Replaced) -> Callable[..., None]:
    """Return the constructor with which objects of OpenMM's class become integrators of this package."""
    original, names = vars(replaced)["__init__"], REPLACEMENTS[replaced].arguments

    @functools.wraps(original)
    def constructor(self: Any, *given: Any, **named: Any) -> None:
        arguments = dict(zip(names, given, strict=False)) | named
        fits = len(given) + len(named) == len(names) and {*arguments} == {*names}
        if not fits or not (asked := picoseconds(arguments["stepSize"])) or _called_by_modeller():
            original(self, *given, **named)  # which raises an error, copies an integrator, or makes no steps
            return
        self.__class__ = replacement(type(self), replaced)
        REPLACEMENTS[replaced].__init__(self, **arguments | {"stepSize": record.interval or asked})
        self.scriptStep = asked
        record.add(self)

    return constructor


def _called_by_modeller() -> bool:
    """Return whether Modeller calls the function that calls this one."""
    return bool(sys._getframe(2).f_globals.get("__name__") == _MODELLER)  # noqa: SLF001


def _entering(record: Replaced) -> Callable[..., None]:
    """Return the constructor of a Context that checks what was replaced, and what was not."""
    original = openmm.Context.__init__

    @functools.wraps(original)
    def constructor(self: Any, *arguments: Any, **named: Any) -> None:
        system, integrator = (*arguments, None, None)[:2]
        if isinstance(system, openmm.System) and isinstance(integrator, openmm.Integrator):
            parts = _parts(integrator)
            ours = [part for part in parts if isinstance(part, Replacement)]
            _check_hydrogens(system, record.interval, ours)
            record.enter(system, ours, alone=parts == [integrator])
            if not _called_by_modeller():
                others = [type(part) for part in parts if not isinstance(part, ExactRigidBodyIntegrator)]
                record.others.update(map(_name, others))
        original(self, *arguments, **named)

    return constructor


def _parts(integrator: Any) -> list[Any]:
    if isinstance(integrator, openmm.CompoundIntegrator):
        return [integrator.getIntegrator(k) for k in range(integrator.getNumIntegrators())]
    return [integrator]


def _name(kind: type[Any]) -> str:
    module = kind.__module__
    return kind.__name__ if module == "openmm.openmm" else f"{kind.__name__} of {module}"


def _check_hydrogens(system: openmm.System, interval: float | None, ours: list[Replacement]) -> None:
    """Raise ValueError if hydrogens are too light for a step (ps), unless the script has long steps itself."""
    if interval is None or interval <= _LONGEST or all(part.scriptStep > _LONGEST for part in ours):
        return
    masses = parameters.masses(system)
    if light := int(((masses > 0.0) & (masses < _HEAVY)).sum()):
        raise ValueError(
            f"an interval of {femtoseconds(interval)} needs heavy hydrogens, but {light} particles of this System have "
            f"less than {_HEAVY} amu: use heavy_hydrogens=True (--heavy-hydrogens), which acts on what createSystem "
            "returns, call openmm_exactrb.heavy_hydrogens(system, topology) for any other System, or choose at most "
            f"{femtoseconds(_LONGEST)}"
        )


def _heavy(owner: type[Any], record: Replaced) -> Callable[..., Any]:
    """Return the method createSystem of a class of OpenMM, with heavy hydrogens."""
    original = vars(owner)["createSystem"]

    @functools.wraps(original)
    def createSystem(self: Any, *arguments: Any, **named: Any) -> Any:
        system = original(self, *arguments, **named)
        topology = getattr(self, "topology", None) or named.get("topology") or arguments[0]
        if any(atom.element is not None and atom.element.atomic_number == 1 for atom in topology.atoms()):
            make_heavy(system, topology)
            record.tell_once("hydrogens have 3 amu, including those of water")
        return system

    return createSystem
