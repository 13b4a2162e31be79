"""Which engine makes the steps of an integrator: what was asked for, and what its Context allows."""

from __future__ import annotations

import openmm

from openmm_exactrb.context import ledger
from openmm_exactrb.device import choice, emit, names
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes.scheme import Scheme


class Selection:
    """The engine of an integrator.

    Parameters
    ----------
    asked : {"host", "device", "auto"}
    scheme : Scheme
    rotor : Rotor

    Raises
    ------
    ValueError
        If there is no such engine, or scheme or rotor are not for the device that was asked for.

    Attributes
    ----------
    asked : str
    on_device : bool
        Whether the device makes the steps, as far as that is known.
    programmed : bool
        Whether the integrator has a program for the device.
    note : str
        Why it is this engine.
    """

    def __init__(self, asked: str, scheme: Scheme, rotor: Rotor) -> None:
        self.asked = choice.named(asked)
        against = choice.against_program(scheme, rotor)
        if self.asked == "device" and against:
            raise ValueError(f"{against}: take engine='host'")
        self.on_device = self.asked == "device"
        self.programmed = self.asked != "host" and not against
        self.note = f'engine="{self.asked}" was asked for' if self.asked != "auto" else against or ""

    @property
    def depends(self) -> bool:
        """Whether the Context decides."""
        return self.programmed and self.asked == "auto"

    def declare(self, integrator: openmm.CustomIntegrator, scheme: Scheme) -> None:
        """Write the program, which OpenMM takes only before there is a Context: of one engine, or of both."""
        if not self.programmed:
            ledger.declare(integrator)
            return
        emit.declare(integrator, scheme, optional=self.depends)
        if self.depends:
            integrator.beginIfBlock(f"{names.LOADED} < 1")
            ledger.declare(integrator)
            integrator.endBlock()
        openmm.CustomIntegrator.setIntegrationForceGroups(integrator, names.OTHERS)

    def decide(self, context: openmm.Context) -> bool:
        """Tell whether the device makes the steps in a Context, and note why.

        Raises
        ------
        ValueError
            If engine="device" was asked for, and is not right there.
        """
        if self.programmed:
            against = choice.against_context(context)
            if self.asked == "device" and against:
                raise ValueError(f"{against}; engine='host' can do it")
            if self.depends:
                against = against or choice.slower(context)
                self.on_device = against is None
                self.note = against or f"{context.getPlatform().getName()} can make the whole step"
        return self.on_device

    def groups(self, bits: int) -> int:
        """Return the force groups (bits) that act, without that of the sums."""
        return bits & names.OTHERS if self.programmed else bits
