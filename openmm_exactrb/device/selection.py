"""Which engine carries out the steps of an integrator, and why."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal, get_args

import openmm
from openmm import unit

from openmm_exactrb.context import arrays, platforms, variables
from openmm_exactrb.context.find import find_bodies
from openmm_exactrb.context.multiple_time_steps import MultipleTimeSteps, fast_forces
from openmm_exactrb.context.synchronisation import refuse_unset
from openmm_exactrb.device import emit, gather, names
from openmm_exactrb.device.rebind import rebind
from openmm_exactrb.device.rows import Table
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.rotors import ROTORS, Rotor
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.thermostat import Thermostat

Engine = Literal["host", "device", "auto"]
_ROTORS = ("exact", "exact_numpy", "exact_compiled")


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
        self._group = names.GROUP if self.on_device else None  # of the sums over bodies; None in the host's program
        self._own = () if thermostat is None else thermostat.own_numbers
        self._warned = False  # of single precision
        self._mark()
        why = None if asked == "host" else _unsupported_settings(scheme, rotor, fast, thermostat)
        self._refuse(why)
        if why:
            self.open, self.on_device, self.note = False, False, why

    @cached_property
    def table(self) -> Table:
        """The rows of the scheme, from which the device's program is made."""
        return Table.of(self.scheme)

    def declare(self, integrator: openmm.CustomIntegrator) -> None:
        """Write the program into an integrator without a Context."""
        if self._group is None:
            variables.declare(integrator, self._own, sum(self.scheme.memory) if self.scheme.processor else None)
        else:
            emit.declare(integrator, self.table, self._group)
        self.set_groups(integrator, self.groups)

    def set_groups(self, integrator: openmm.CustomIntegrator, groups: int) -> None:
        """Set which force groups act, by their bits; the group of the sums over bodies never does."""
        openmm.CustomIntegrator.setIntegrationForceGroups(integrator, groups)
        self.groups = openmm.CustomIntegrator.getIntegrationForceGroups(integrator)
        if self._group is not None:
            others = self.groups & 0xFFFFFFFF & ~(1 << self._group)
            openmm.CustomIntegrator.setIntegrationForceGroups(integrator, others)

    def _refuse(self, why: str | None) -> None:
        """Raise ValueError if there is a reason against the device, which was asked for."""
        if why and self.asked == "device":
            raise ValueError(f"{why}; use engine='host'")

    def settle(self, context: Any, integrator: Any) -> None:
        """Select the engine for a Context and its step size; ValueError if engine="device" does not support them."""
        if self.asked == "device":
            self._refuse(_unsupported_context(context, integrator, self._fast))
        if self.open:
            self.on_device, self.note = self._rule(context, integrator)
            self._mark()

    def _rule(self, context: Any, integrator: Any) -> tuple[bool, str]:
        """Return whether to take the device, and the reason. A run from a checkpoint keeps its engine if it can."""
        writer = _writer(integrator, self._own)
        why = None if writer == "device" else platforms.no_gpu(context)
        why = why or _unsupported_context(context, integrator, self._fast)
        if why or writer:
            return not why and writer == "device", why or f"the run began with engine={writer!r}"
        return True, f"{context.getPlatform().getName()} computes on a GPU"

    def _mark(self) -> None:
        selected = self.on_device == (self._group is not None)
        self.marks = () if not selected else (0.0, names.HELD) if self.on_device else variables.marks(self._own)

    def install_device(self, context: Any, integrator: openmm.CustomIntegrator, bodies: RigidBodies) -> None:
        """Add the sums over bodies to the System, and give the integrator the program that uses them."""
        group = gather.free_group(context.getSystem(), names.GROUP if self._group is None else self._group)
        assert group is not None  # `settle` makes sure
        gather.install(context.getSystem(), bodies, group)
        if group == self._group:
            context.reinitialize(preserveState=True)
        else:
            self._replace_program(context, integrator, group)
        gather.make_kernels(context)

    def install_host(self, context: Any, integrator: openmm.CustomIntegrator) -> None:
        """Give the integrator the host's program, unless it has it and the device wrote none of its variables."""
        if not self._warned:
            platforms.warn_of_single_precision(context)
            self._warned = True
        if self._group is not None:
            gather.remove(context.getSystem())
        if self._group is not None or (self.open and integrator.getGlobalVariable(0) not in self.marks):
            self._replace_program(context, integrator, None)

    def _replace_program(self, context: Any, integrator: openmm.CustomIntegrator, group: int | None) -> None:
        self._group = group
        program = openmm.CustomIntegrator(0.0)
        self.declare(program)
        rebind(context, integrator, program)
        self._mark()


def _writer(integrator: openmm.CustomIntegrator, own: Sequence[str]) -> str | None:
    """Return the engine that wrote the variables, None if none did; ValueError if another kind of integrator did."""
    first = integrator.getGlobalVariable(0)
    if first == names.HELD:
        return "device"
    if first not in variables.marks(own):
        raise ValueError(variables.OTHER_FORMAT)
    return "host" if first else None


def _unsupported_settings(
    scheme: Scheme, rotor: Rotor, fast: MultipleTimeSteps | None, thermostat: Thermostat | None
) -> str | None:
    """Return why the settings of an integrator need the host, or None."""
    if thermostat is not None and not thermostat.on_device:
        return f"the device supports the Langevin thermostat only, not {type(thermostat).__name__}"
    if fast is not None and fast.certain:
        return "the device does not support multiple time steps (fast=)"
    if rotor not in map(ROTORS.get, _ROTORS):
        own = "" if ROTORS.get(rotor.name) is rotor else "your own rotor "
        return f"the device supports the exact rotor only, not {own}{rotor.name}"
    try:
        Table.of(scheme, thermostat=thermostat is not None)
    except ValueError as error:
        return str(error)
    return None


def _unsupported_context(context: Any, integrator: Any, fast: MultipleTimeSteps | None) -> str | None:
    """Return why a Context, at the present step size, needs the host, or None."""
    platform, system = context.getPlatform(), context.getSystem()
    name = platform.getName()
    if name not in (*platforms.DEVICES, "Reference"):
        return f"the device supports the platforms CUDA, HIP, OpenCL and Reference only, not {name}"
    if platforms.is_single(context):
        return "in single precision the state of the bodies would be rounded: set Precision to mixed or double"
    if name == "Reference" and any(map(system.isVirtualSite, range(system.getNumParticles()))):
        return "the Reference platform of OpenMM moves virtual sites at the end of a step only, not within a program"
    for parameter in context.getParameters():
        if parameter in names.OPENMM or names.has(parameter):
            return f"the parameter {parameter!r} of a force has the name of a variable of the program: rename it"
    x = arrays.positions(context.getState(positions=True))
    refuse_unset(context)
    bodies = find_bodies(system, x, integrator.getNamedBodies())
    if len(bodies.clusters):
        return "constraints leave a molecule of the System a motion of its own, which the device does not follow"
    found, h = fast_forces(system, bodies, fast), integrator.getStepSize().value_in_unit(unit.picosecond)
    if found is not None and found.acts(integrator.getScheme(), h):
        return (
            'bonded forces have inner steps at this step size (fast="auto"), which the device does not support: take a '
            "smaller step, or fast=None for no inner steps"
        )
    return gather.unsupported(system, bodies)
