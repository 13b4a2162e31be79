"""Integrators that C++ holds and steps, such as the parts of a CompoundIntegrator and copies of these parts.

An integrator of the library calls `bound` while a Context is created, and `step` for steps that C++ starts. Its Python
object is found by the number of the C++ object, or is made from the settings that the C++ object stores. From then on,
the Context keeps the Python object alive.
"""

from __future__ import annotations

import sys
import weakref
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import openmm

from openmm_exactrb.context.variables import OTHER_FORMAT
from openmm_exactrb.library.library import library, listen, of_library

# The Python objects by the numbers of their C++ objects, and the attribute of a Context that keeps them alive.
_known: weakref.WeakValueDictionary[int, Any] = weakref.WeakValueDictionary()
_ATTRIBUTE = "_exactrb_integrators"
# The code of OpenMM's minimiser, which first asks the integrator for its tolerance of constraints.
_MINIMISER = openmm.LocalEnergyMinimizer.minimize.__code__


def know(integrator: Any) -> None:
    """Register the Python object of an integrator of the library."""
    _known[library().number(integrator)] = integrator


def known(face: Any) -> Any | None:
    """Return the Python object of the integrator that another Python object represents, or None."""
    return _known.get(library().number(face)) if of_library(face) else None


def held_by_openmm(
    completed: Callable[[Any], Any],
    enter: Callable[[Any, openmm.Context], None],
    agree: Callable[[Any], None],
    minimise: Callable[[Any], None],
) -> None:
    """Let C++ call integrators of this package.

    completed(face) returns the Python object of an integrator, and enter(integrator, context) is called while a Context
    is created. agree(integrator) adopts settings of C++ before steps that C++ starts, and minimise(integrator) is
    called when OpenMM's minimiser begins.
    """

    def bound(pointer: int, number: int) -> None:
        context = _being_created()
        if context is None:  # `reinitialize`, in which the Context remains the same
            return
        integrator = _known.get(number) or completed(library().face(pointer))
        vars(context).setdefault(_ATTRIBUTE, []).append(integrator)
        enter(integrator, context)

    def step(number: int, steps: int) -> None:
        integrator = _known[number]
        agree(integrator)
        integrator.step(steps)

    def asked(number: int) -> None:
        if any(frame.f_code is _MINIMISER for frame in _frames()):
            minimise(_known[number])

    listen(bound, step, asked, OTHER_FORMAT)


def _being_created() -> openmm.Context | None:
    """Return the Context whose constructor is running, or None."""
    objects = (frame.f_locals.get("self") for frame in _frames() if frame.f_code.co_name == "__init__")
    return next((one for one in objects if isinstance(one, openmm.Context)), None)


def _frames() -> Iterator[FrameType]:
    """Yield the frames of the calling functions, the innermost first."""
    frame: FrameType | None = sys._getframe(1)  # noqa: SLF001
    while frame is not None:
        yield frame
        frame = frame.f_back
