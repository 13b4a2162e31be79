"""Which engine an integrator has, and why: asked for, settled by the Context, and given its program."""

from __future__ import annotations

from typing import Any

import openmm

from openmm_exactrb.context import account, arrays, ledger
from openmm_exactrb.context.nesting import Nesting
from openmm_exactrb.device import choice, emit, gather, names, trial
from openmm_exactrb.device.contexts import rebind
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes.scheme import Scheme

_EVERY = 0xFFFFFFFF


class Chosen:
    """The engine of an integrator.

    With "auto" an integrator begins with the program of the host, which costs nothing. It gets that of the device when
    a Context has chosen it, and so when the System is known, with a force group that is free there.

    Parameters
    ----------
    asked : {"host", "device", "auto"}
    scheme : Scheme
    rotor : Rotor
    nesting : Nesting or None
        What is to have steps of its own within drifts.
    bath : str or None
        What bath its steps have.

    Raises
    ------
    ValueError
        If there is no such engine, or scheme or rotor are not for the device that was asked for.

    Attributes
    ----------
    asked : str
    note : str
        A sentence that says why it is this engine.
    on_device : bool
        Whether the device makes the steps, as far as it is settled.
    groups : int
        Bits of the force groups that act, as the user set them.
    """

    def __init__(
        self,
        asked: str,
        scheme: Scheme,
        rotor: Rotor,
        nesting: Nesting | None,
        bath: str | None,
    ) -> None:
        self.asked, self._scheme, self._nesting = choice.named(asked), scheme, nesting
        against = choice.against_program(scheme, rotor, nesting is not None and nesting.certain, bath)
        if self.asked == "device" and against:
            raise ValueError(f"{against}: take engine='host'")
        self.note = f'engine="{self.asked}" was asked for' if self.asked != "auto" else against or ""
        self.open = self.asked == "auto" and not against  # whether the Context decides
        self.on_device = self.asked == "device"
        self._group = names.GROUP if self.on_device else None  # that the program has for sums; the host's has none
        self._preferred: str | None = None
        self.groups = -1

    def declare(self, integrator: openmm.CustomIntegrator) -> None:
        """Write the program into an integrator without a Context."""
        if self._group is None:
            ledger.declare(integrator)
            account.declare(integrator)
        else:
            emit.declare(integrator, self._scheme, self._group)
        self.act(integrator, self.groups)

    def act(self, integrator: openmm.CustomIntegrator, groups: int) -> None:
        """Set which force groups act, by their bits: that of the sums does not."""
        openmm.CustomIntegrator.setIntegrationForceGroups(integrator, groups)
        self.groups = openmm.CustomIntegrator.getIntegrationForceGroups(integrator)
        if self._group is not None:
            others = self.groups & _EVERY & ~(1 << self._group)
            openmm.CustomIntegrator.setIntegrationForceGroups(integrator, others)

    def prefer(self, engine: str) -> None:
        """Take an engine without a measurement, where the Context decides and can have it."""
        self._preferred = choice.named(engine)

    def leave_to_host(self, why: str) -> None:
        """Have the host make the steps, whatever the Context is.

        Raises
        ------
        ValueError
            If the device was asked for.
        """
        if self.asked == "device":
            raise ValueError(f"{why}: take engine='host'")
        if self.open:
            self.open, self.on_device, self.note = False, False, why

    def overtaken(self, integrator: openmm.CustomIntegrator) -> bool:
        """Tell whether the program is not that of the chosen engine, or has another one's checkpoint in its numbers."""
        program = "host" if self._group is None else "device"
        return self.open and (self.on_device != (program == "device") or _began(integrator) not in (None, program))

    def settle(self, context: Any, integrator: Any) -> None:
        """Choose the engine for a Context, and note why.

        A run that began with an engine keeps it. Else, where both are right, a few steps of both are timed.

        Raises
        ------
        ValueError
            If engine="device" was asked for, and is not right there.
        """
        if self.asked == "device":
            against = choice.against_parameters(context, True) or choice.against_context(
                context, integrator.getNamedBodies()
            )
            if against:
                raise ValueError(f"{against}; engine='host' can do it")
            self.bear_steps(context, integrator)
        if self.open:
            self.on_device, self.note = self._verdict(context, integrator)

    def bear_steps(self, context: Any, integrator: Any) -> None:
        """Raise ValueError where the device was asked for, and the host would nest forces at the present step."""
        against = choice.against_steps(context, integrator, self._nesting) if self.asked == "device" else None
        if against:
            raise ValueError(f"{against}: take engine='host', a smaller step, or fast=None, which nests nothing")

    def furnish(self, context: Any, integrator: openmm.CustomIntegrator, bodies: RigidBodies) -> None:
        """Give the System of a Context the sums over bodies, and the integrator the program that uses them."""
        group = gather.free_group(context.getSystem(), names.GROUP if self._group is None else self._group)
        assert group is not None  # `settle` would have said so
        gather.install(context.getSystem(), bodies, group)
        if group == self._group:
            context.reinitialize(preserveState=True)
        else:
            self._rebind(context, integrator, group)
        gather.make_kernels(context)

    def withdraw(self, context: Any, integrator: openmm.CustomIntegrator) -> None:
        """Give the integrator the program of the host, unless it has it with nothing of a device in its variables."""
        if self._group is not None:
            gather.remove(context.getSystem())
        if self._group is not None or self.overtaken(integrator):
            self._rebind(context, integrator, None)

    def _verdict(self, context: Any, integrator: Any) -> tuple[bool, str]:
        against = (
            choice.slower(context)
            or choice.against_parameters(context, False)
            or choice.against_context(context, integrator.getNamedBodies())
            or choice.against_steps(context, integrator, self._nesting)
        )
        if against:
            return False, against
        began = _began(integrator) or self._preferred
        if self.note and began == ("device" if self.on_device else "host"):
            return self.on_device, self.note
        if began in ("host", "device"):
            return began == "device", f"the run began with engine={began!r}"
        if not arrays.positions(context.getState(positions=True)).any():
            raise ValueError(
                "the Context has no positions yet, so that no engine can be chosen: call setPositions first"
            )
        return trial.verdict(context, integrator)

    def _rebind(self, context: Any, integrator: openmm.CustomIntegrator, group: int | None) -> None:
        self._group = group
        program = openmm.CustomIntegrator(0.0)
        self.declare(program)
        rebind(context, integrator, program)


def _began(integrator: openmm.CustomIntegrator) -> str | None:
    """Return which engine wrote the variables of an integrator, which checkpoints take along; None if none did."""
    mark = integrator.getGlobalVariable(0)
    if mark == names.HELD:
        return "device"
    return "host" if mark else None
