"""Which engine an integrator has, and why: asked for, given the program of, and settled by the Context."""

from __future__ import annotations

from typing import Any

import openmm

from openmm_exactrb.context import ledger
from openmm_exactrb.device import choice, emit, names, trial
from openmm_exactrb.rotors import Rotor
from openmm_exactrb.schemes.scheme import Scheme


class Chosen:
    """The engine of an integrator.

    Parameters
    ----------
    asked : {"host", "device", "auto"}
    scheme : Scheme
    rotor : Rotor
    nested : bool
        Whether forces have steps of their own within drifts.
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
    programmed : bool
        Whether the integrator has the device's program.
    on_device : bool
        Whether the device makes the steps, as far as it is settled.
    """

    def __init__(self, asked: str, scheme: Scheme, rotor: Rotor, nested: bool, bath: str | None) -> None:
        self.asked, self._scheme = choice.named(asked), scheme
        against = choice.against_program(scheme, rotor, nested, bath)
        if self.asked == "device" and against:
            raise ValueError(f"{against}: take engine='host'")
        self.note = f'engine="{self.asked}" was asked for' if self.asked != "auto" else against or ""
        self.programmed = self.asked != "host" and not against
        self.on_device = self.asked == "device"

    @property
    def open(self) -> bool:
        """Whether the Context decides."""
        return self.programmed and self.asked == "auto"

    def declare(self, integrator: openmm.CustomIntegrator) -> None:
        """Write the program, which OpenMM takes only before there is a Context: of one engine, or of both."""
        if not self.programmed:
            ledger.declare(integrator)
            return
        emit.declare(integrator, self._scheme, optional=self.open)
        if self.open:
            integrator.beginIfBlock(f"{names.LOADED} < 1")
            ledger.declare(integrator)
            integrator.endBlock()
        openmm.CustomIntegrator.setIntegrationForceGroups(integrator, names.OTHERS)

    def settle(self, context: Any, integrator: Any) -> None:
        """Choose the engine for a Context, and note why. Where both are right a few steps of both are timed.

        Raises
        ------
        ValueError
            If engine="device" was asked for, and is not right there.
        """
        if not self.programmed:
            return
        against = choice.against_context(context, integrator.getNamedBodies())
        if self.asked == "device" and against:
            raise ValueError(f"{against}; engine='host' can do it")
        if self.open:
            against = against or choice.slower(context)
            self.on_device, self.note = (False, against) if against else trial.verdict(context, integrator)
