"""Which engine carries out the steps of an integrator, and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

import openmm

from openmm_exactrb.context import variables
from openmm_exactrb.engines.custom_program import emit, fast_group, gather, names
from openmm_exactrb.engines.custom_program.program import Layout
from openmm_exactrb.engines.custom_program.rebind import rebind
from openmm_exactrb.engines.custom_program.rows import Table
from openmm_exactrb.engines.custom_program.support import Needs, UnsupportedError, needs, unsupported_settings
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.multiple_time_steps.fast_forces import MultipleTimeSteps
from openmm_exactrb.openmm_access import platforms
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.thermostat import Thermostat

Engine = Literal["host", "device", "auto"]
# Of OpenMM's constraints, where they close drifts, as a part of a length; OpenMM's own default is 1e-5.
_TOLERANCE, _USUAL = 1e-8, 1e-5


class Selection:
    """The engine of an integrator, and the program that the integrator has for it.

    With "auto" a rule decides: the device on a GPU, if all settings and the System are supported there, else the host.
    An integrator starts with the host's program, which costs nothing. The device's program needs to know the Context,
    since it uses a force group that no force of the System is in. ValueError if the engine is unknown, or "device" does
    not support a setting.

    Attributes
    ----------
    open : bool
        Whether the Context decides.
    on_device : bool
        Whether the device makes the steps; provisional until the Context has decided.
    note : str
        The reason, a sentence.
    groups : int
        Bits of the force groups that act, as the user set them.
    needs : Needs or None
        What the Context needs of the device's program, once it was asked.
    marks : tuple of float
        Values of an integrator's first variable if its program and its state are those of the selected engine.
    """

    def __init__(
        self, asked: str, scheme: Scheme, rotor: Rotor, fast: MultipleTimeSteps | None, thermostat: Thermostat | None
    ) -> None:
        if asked not in get_args(Engine):
            raise ValueError(f"unknown engine {asked!r}: choose one of {', '.join(get_args(Engine))}")
        self.asked, self.scheme, self._fast = asked, scheme, fast
        self.open, self.on_device, self.groups = asked == "auto", asked == "device", -1
        self.note = f'engine="{asked}" was asked for'
        self._layout: Layout | None = None  # of the program that the integrator has; None for the host's
        self.needs: Needs | None = None
        self._own = () if thermostat is None else thermostat.own_numbers
        self._warned = False  # of single precision
        self._end: Any = None  # what gives the forces of the Context their own groups back
        why = None if asked == "host" else unsupported_settings(scheme, rotor, thermostat)
        self._refuse(why)
        if why:
            self.open, self.on_device, self.note = False, False, why
        if self.on_device:
            self._layout = Layout(Table.of(scheme), names.GROUP)
        self._mark()

    @property
    def table(self) -> Table:
        """The rows of the program that the Context needs, once it was asked."""
        assert self.needs is not None
        return self.needs.layout.table

    @property
    def outdated(self) -> bool:
        """Whether the Context needs another program on the device than the integrator has."""
        return self.on_device and self.needs is not None and self.needs.layout != self._layout

    def declare(self, integrator: openmm.CustomIntegrator) -> None:
        """Write the program into an integrator without a Context."""
        if self._layout is None:
            variables.declare(integrator, self._own, sum(self.scheme.memory) if self.scheme.processor else None)
        else:
            emit.declare(integrator, self._layout)
            _tighten(integrator)
        self.set_groups(integrator, self.groups)

    def set_groups(self, integrator: openmm.CustomIntegrator, groups: int) -> None:
        """Set which force groups act, by their bits.

        For OpenMM's minimiser and barostats that of the fast forces does too, but not that of the sums over bodies.
        """
        openmm.CustomIntegrator.setIntegrationForceGroups(integrator, groups)
        self.groups = openmm.CustomIntegrator.getIntegrationForceGroups(integrator)
        if self._layout is not None:
            fast = 0 if self._layout.fast is None else 1 << self._layout.fast
            others = (self.groups | fast) & 0xFFFFFFFF & ~(1 << self._layout.sums)
            openmm.CustomIntegrator.setIntegrationForceGroups(integrator, others)

    def _refuse(self, why: str | None) -> None:
        """Raise ValueError if there is a reason against the device, which was asked for."""
        if why and self.asked == "device":
            raise ValueError(f"{why}; use engine='host'")

    def settle(self, context: Any, integrator: Any) -> None:
        """Select the engine for a Context and its step size; ValueError if engine="device" does not support them."""
        if self.asked == "device":
            self._refuse(self._ask(context, integrator))
        if self.open:
            self.on_device, self.note = self._rule(context, integrator)
            self._mark()

    def _ask(self, context: Any, integrator: Any) -> str | None:
        """Find out what a Context needs of the device's program; return why that is the host, or None."""
        try:
            self.needs = needs(context, integrator, self.scheme, self._fast, self.groups)
        except UnsupportedError as error:
            return str(error)
        return None

    def _rule(self, context: Any, integrator: Any) -> tuple[bool, str]:
        """Return whether to take the device, and the reason. A run from a checkpoint keeps its engine if it can."""
        writer = _writer(integrator, self._own)
        why = None if writer == "device" else platforms.no_gpu(context)
        why = why or self._ask(context, integrator)
        if not (why or writer) and self.needs is not None:
            why = self.needs.note
        if why or writer:
            return not why and writer == "device", why or f"the run began with engine={writer!r}"
        return True, f"{context.getPlatform().getName()} computes on a GPU"

    def _mark(self) -> None:
        selected = self.on_device == (self._layout is not None)
        self.marks = () if not selected else (0.0, names.HELD) if self.on_device else variables.marks(self._own)

    def install_device(self, context: Any, integrator: openmm.CustomIntegrator, bodies: RigidBodies) -> None:
        """Add the sums over bodies to the System, and give the integrator the program that uses them."""
        system, wanted = context.getSystem(), self.needs
        assert wanted is not None  # `settle` has made sure
        fast_group.restore(system)
        gather.install(system, bodies, wanted.layout.sums)
        if wanted.layout.fast is not None:
            fast_group.move(system, wanted.fast, wanted.layout.fast)
            if self._end is None or not self._end.alive:
                self._end = fast_group.restore_after(context)
        if wanted.layout == self._layout:
            self._layout = wanted.layout  # the same object compares at once
            context.reinitialize(preserveState=True)
        else:
            self._replace_program(context, integrator, wanted.layout)
        gather.make_kernels(context, wanted.layout.clusters)

    def install_host(self, context: Any, integrator: openmm.CustomIntegrator) -> None:
        """Give the integrator the host's program, unless it has it and the device wrote none of its variables.

        Forces that another Context of the System has moved to a group of theirs are in their own groups here.
        """
        if not self._warned:
            platforms.warn_of_single_precision(context)
            self._warned = True
        system = context.getSystem()
        if self._layout is not None:
            gather.remove(system)
        elif fast_group.any_moved(system):
            fast_group.restore(system)
            context.reinitialize(preserveState=True)
        if self._layout is not None or (self.open and integrator.getGlobalVariable(0) not in self.marks):
            self._replace_program(context, integrator, None)

    def _replace_program(self, context: Any, integrator: openmm.CustomIntegrator, layout: Layout | None) -> None:
        self._layout = layout
        if layout is not None:
            _tighten(integrator)
        program = openmm.CustomIntegrator(0.0)
        self.declare(program)
        rebind(context, integrator, program)
        self._mark()


def _tighten(integrator: openmm.CustomIntegrator) -> None:
    """Set the tolerance of OpenMM's constraints that programs need, unless a user has set one."""
    if integrator.getConstraintTolerance() == _USUAL:
        integrator.setConstraintTolerance(_TOLERANCE)


def _writer(integrator: openmm.CustomIntegrator, own: Sequence[str]) -> str | None:
    """Return the engine that wrote the variables, None if none did; ValueError if another kind of integrator did."""
    first = integrator.getGlobalVariable(0)
    if first == names.HELD:
        return "device"
    if first not in variables.marks(own):
        raise ValueError(variables.OTHER_FORMAT)
    return "host" if first else None
