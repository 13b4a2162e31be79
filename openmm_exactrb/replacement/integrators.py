"""The integrators that take the place of OpenMM's; each is also an instance of the class that it replaces."""

from __future__ import annotations

from typing import Any, ClassVar

import openmm
from openmm import unit

from openmm_exactrb.integrators.copies import restored
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.integrators.langevin import ExactRigidBodyLangevinIntegrator
from openmm_exactrb.openmm_access.units import picoseconds


class Replacement(ExactRigidBodyIntegrator):
    """What integrators that take the place of OpenMM's add to those of this package.

    Attributes
    ----------
    replaced : type
        The class of OpenMM.
    arguments : tuple of str
        The arguments of this class.
    present : object or None
        The replacement that is in progress, which decides on steps; see `openmm_exactrb.replacement.record.Replaced`.
    scriptStep : float
        The step in ps with which the script created the integrator.
    """

    replaced: ClassVar[type[Any]]
    arguments: ClassVar[tuple[str, ...]] = "temperature", "frictionCoeff", "stepSize"
    present: ClassVar[Any] = None
    scriptStep = 0.0

    def step(self, steps: int) -> None:
        """Advance by this many steps, which are those of the script if its simulated time is kept."""
        present = Replacement.present
        if present is None:
            super().step(steps)
        else:
            present.step(self, steps, super().step)

    def getStepSize(self) -> unit.Quantity:
        """Return the step size, which is that of the script if its simulated time is kept."""
        clock = Replacement.present and Replacement.present.clock(self)
        return self.scriptStep * unit.picosecond if clock else super().getStepSize()

    def setStepSize(self, size: float | unit.Quantity) -> None:
        """Set the step size, in ps if given without a unit, unless an interval for all steps was chosen."""
        present = Replacement.present
        super().setStepSize(size if present is None else present.step_for(self, picoseconds(size)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the settings for pickles, in which a subclass of the script has its own name."""
        kind, *others = super()._parts()
        return _restored, (_SCRIPTS.get(kind, kind), *others)


class VerletReplacement(Replacement, openmm.VerletIntegrator):
    """`ExactRigidBodyIntegrator` instead of VerletIntegrator."""

    replaced = openmm.VerletIntegrator
    arguments = ("stepSize",)


class LangevinMiddleReplacement(Replacement, ExactRigidBodyLangevinIntegrator, openmm.LangevinMiddleIntegrator):
    """`ExactRigidBodyLangevinIntegrator` instead of LangevinMiddleIntegrator."""

    replaced = openmm.LangevinMiddleIntegrator


class LangevinReplacement(Replacement, ExactRigidBodyLangevinIntegrator, openmm.LangevinIntegrator):
    """`ExactRigidBodyLangevinIntegrator` instead of LangevinIntegrator."""

    replaced = openmm.LangevinIntegrator


#: The classes that take the place of OpenMM's, by the class that each replaces.
REPLACEMENTS: dict[type[Any], type[Any]] = {
    kind.replaced: kind for kind in (LangevinMiddleReplacement, LangevinReplacement, VerletReplacement)
}
# The classes derived by `replacement` from those of scripts, and the latter.
_DERIVED: dict[tuple[type[Any], type[Any]], type[Any]] = {}
_SCRIPTS: dict[type[Any], type[Any]] = {}


def replacement(kind: type[Any], replaced: type[Any]) -> type[Any]:
    """Return the class that replaces one of OpenMM's or, with the same name, a subclass of it in a script."""
    if kind is replaced:
        return REPLACEMENTS[replaced]
    if (known := _DERIVED.get((kind, replaced))) is not None:
        return known
    names = {"__module__": kind.__module__, "__qualname__": kind.__qualname__, "__doc__": kind.__doc__}
    derived = type(kind.__name__, (kind, REPLACEMENTS[replaced]), names)
    _DERIVED[kind, replaced], _SCRIPTS[derived] = derived, kind
    return derived


def _restored(kind: type[Any], *others: Any) -> Any:
    replaced = next((base for base in kind.__mro__ if base in REPLACEMENTS), None)
    return restored(kind if replaced is None or issubclass(kind, Replacement) else replacement(kind, replaced), *others)
