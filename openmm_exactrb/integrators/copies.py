"""Copies of integrators, by Python and by OpenMM, which copies and reads integrators as text.

The settings of an integrator are stored as JSON in its C++ part, and thereby in its XML. From this text, the functions
with which OpenMM returns integrators create an integrator of the same class. Objects of users that have no text, such
as their own schemes, are represented by a key that is valid within the process. Reading text imports no module: classes
of users are looked up among those that exist.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import json
import secrets
import weakref
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.engines.catalogue import ENGINES
from openmm_exactrb.integrators.parts import know, known
from openmm_exactrb.library.library import of_library
from openmm_exactrb.openmm_access import settings_text
from openmm_exactrb.openmm_access.handed_out import hand_out
from openmm_exactrb.schemes import Scheme, scheme_for_thermostat
from openmm_exactrb.thermostats.thermostat import Thermostat

#: Settings of OpenMM's integrators that have methods getX and setX, and that OpenMM copies itself.
SETTINGS = "IntegrationForceGroups", "ConstraintTolerance", "RandomNumberSeed"

_AGAIN = "create the integrator again, with openmm_exactrb"


class Copied:
    """An integrator that Python and OpenMM can copy; a copy has the same settings and no Context."""

    _own: frozenset[str] = frozenset()  # the names of the attributes of this package

    @abstractmethod
    def getSettings(self) -> dict[str, dict[str, Any]]:
        """Return the arguments and the settings of this integrator."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the settings for pickles."""
        return restored, self._parts()

    def __copy__(self) -> Any:
        """Return an integrator with the same settings and no Context."""
        return restored(*self._parts())

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        """Return an integrator with the same settings, no Context, and deep copies of user-defined attributes."""
        kind, attributes, *others = self._parts()
        return restored(kind, copy.deepcopy(attributes, memo), *others)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; those of a user's subclass are part of the stored text."""
        super().__setattr__(name, value)
        if self._own and name not in self._own and name in vars(self):
            self._describe()

    def _complete(self, before: Collection[str]) -> None:
        """Store the settings of a new integrator; the attributes `before`, and all from now on, are a user's."""
        self._own = frozenset((*vars(self), "_own")).difference(before)
        self._describe()

    def _describe(self) -> None:
        """Store the present settings as text, except for those that OpenMM stores itself."""
        kind, attributes, arguments, _ = self._parts()
        del arguments["stepSize"]
        content = {"class": _name(kind), "arguments": _each(_coded, arguments), "attributes": _each(_coded, attributes)}
        settings_text.write(self, json.dumps(content, sort_keys=True, separators=(",", ":")))

    def _parts(self) -> tuple[Any, ...]:
        return type(self), self._attributes(), *self.getSettings().values()

    def _attributes(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in self._own}


def restored(kind: Any, attributes: dict[str, Any], arguments: dict[str, Any], settings: dict[str, Any]) -> Any:
    """Return an integrator of a class with the given attributes, arguments and settings of another integrator.

    The integrator is initialised by the class of this package that its class is or derives from, since the classes of
    users may have different arguments.
    """
    ours = next(base for base in kind.__mro__ if _is_ours(base))
    integrator = kind.__new__(kind)
    ours.__init__(integrator, **arguments)
    for name, value in attributes.items():
        setattr(integrator, name, value)
    for name, value in settings.items():
        getattr(integrator, f"set{name}")(value)
    return integrator


def copied_by_openmm(kind: type[Any], agree: Callable[[Any], None]) -> Callable[[Any], Any]:
    """Let OpenMM's functions return integrators of a class, or of its subclasses, with their Python part.

    Return the function completed(face) that returns the integrator of the C++ part that a Python object represents. The
    function agree(integrator) adopts settings that C++ has changed.
    """

    def completed(face: Any) -> Any:
        """Return the integrator whose C++ part OpenMM returned; every other integrator is returned unchanged."""
        if type(face) is not openmm.CustomIntegrator:
            return face
        if (integrator := known(face)) is not None:
            agree(integrator)
            return integrator
        text = settings_text.read(face)
        if text is None:
            if variables.declared(face):
                raise ValueError(
                    "this integrator was written by an earlier version of openmm_exactrb, without its settings: "
                    f"{_AGAIN}"
                )
            return face
        integrator = _read(text, face, kind)
        if not face.thisown:  # a part of another integrator, whose C++ part remains where it is
            integrator.this, face.this = face.this, integrator.this
            face.thisown = 1
            integrator.setRandomNumberSeed(integrator.getRandomNumberSeed())
            if of_library(integrator):
                know(integrator)
        return integrator

    def prepare(xml: str) -> None:
        for engine in ENGINES.values():
            engine.prepare_to_read(xml)

    hand_out(completed, prepare)
    return completed


def _read(text: str, face: openmm.CustomIntegrator, kind: type[Any]) -> Any:
    """Return a new integrator with the settings in a text, and those that OpenMM stores itself."""
    known = {_name(derived): derived for derived in _classes(kind)}
    settings = {name: getattr(face, f"get{name}")() for name in SETTINGS}
    try:
        content = json.loads(text)
        if (name := content["class"]) not in known:
            raise ValueError(
                f"the class {name} of this integrator does not exist in this process: import its module, and then "
                "read the integrator again"
            )
        arguments, attributes = (_each(_decoded, content[part]) for part in ("arguments", "attributes"))
        return restored(known[name], attributes, {"stepSize": face.getStepSize(), **arguments}, settings)
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"another version of openmm_exactrb wrote this integrator, with settings that are unknown here ({error}): "
            f"{_AGAIN}"
        ) from error


# -- values as JSON ---------------------------------------------------------------------------------------------------


# Functions that return objects without a text, by the key that represents the object in text.
_objects: dict[str, Callable[[], Any]] = {}


def _coded(value: Any) -> Any:
    """Return a value as JSON, in which every object is a pair of a key of `_DECODERS` and its content."""
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.generic):
        return _coded(value.item())
    if type(value) is list:
        return [_coded(item) for item in value]
    if type(value) is tuple:
        return {"tuple": [_coded(item) for item in value]}
    if type(value) is dict:
        return {"mapping": [[_coded(key), _coded(item)] for key, item in value.items()]}
    if isinstance(value, Scheme) and _listed(value):
        return {"scheme": value.name}
    if isinstance(value, Thermostat) and _is_ours(type(value)):
        return {"thermostat": [_name(type(value)), _each(_coded, value.settings())]}
    name = getattr(value, "name", None) or getattr(value, "__name__", "")
    return {"object": [_key(value), f"{type(value).__name__} {name}".strip()]}


def _decoded(value: Any) -> Any:
    """Return the value of JSON that `_coded` returned."""
    if isinstance(value, list):
        return [_decoded(item) for item in value]
    if isinstance(value, dict):
        ((kind, content),) = value.items()
        return _DECODERS[kind](content)
    return value


def _each(function: Callable[[Any], Any], named: Mapping[str, Any]) -> dict[str, Any]:
    return {name: function(value) for name, value in named.items()}


def _mapping(content: Any) -> dict[Any, Any]:
    return {_decoded(key): _decoded(item) for key, item in content}


def _thermostat(content: Any) -> Thermostat:
    name, fields = content
    kinds: dict[str, Any] = {_name(kind): kind for kind in _classes(Thermostat)}
    thermostat: Thermostat = kinds[name](**_each(_decoded, fields))
    return thermostat


def _object(content: Any) -> Any:
    key, name = content
    if (value := _objects.get(key, _nothing)()) is None:
        raise ValueError(
            f"this integrator has your own {name}, which only the process that wrote the integrator can copy: {_AGAIN}"
        )
    return value


_DECODERS: Mapping[str, Callable[[Any], Any]] = {
    "tuple": lambda content: tuple(map(_decoded, content)),
    "mapping": _mapping,
    "scheme": scheme_for_thermostat,
    "thermostat": _thermostat,
    "object": _object,
}


def _listed(scheme: Scheme) -> bool:
    """Return whether a scheme has a name by which it can be found."""
    try:
        return scheme_for_thermostat(scheme.name) == scheme
    except ValueError:
        return False


def _key(value: Any) -> str:
    """Return the key of an object; equal objects have the same key, so that equal integrators have equal text."""
    for key, held in _objects.items():
        if value is (known := held()) or _equal(value, known):
            return key
    key = secrets.token_hex(8)  # of this process alone, even after a fork
    _objects[key] = _held(value)
    return key


def _held(value: Any) -> Callable[[], Any]:
    """Return a function that returns an object; it keeps values such as schemes alive, but not a user's Context."""
    if not (dataclasses.is_dataclass(value) or callable(value)):
        with contextlib.suppress(TypeError):  # an object to which no weak reference is possible, such as a set
            return weakref.ref(value)
    return lambda: value


def _nothing() -> None:
    pass


def _equal(one: Any, other: Any) -> bool:
    try:
        return type(one) is type(other) and bool(one == other)
    except ValueError:  # arrays
        return False


def _name(kind: type[Any]) -> str:
    """Return the name of a class in text, which is without its module in this package."""
    return kind.__name__ if _is_ours(kind) else f"{kind.__module__}.{kind.__qualname__}"


def _is_ours(kind: type[Any]) -> bool:
    return kind.__module__.partition(".")[0] == "openmm_exactrb"


def _classes(kind: type[Any]) -> Iterator[type[Any]]:
    """Yield a class and all classes that derive from it."""
    yield kind
    for derived in kind.__subclasses__():
        yield from _classes(derived)
