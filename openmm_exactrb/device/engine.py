"""The engine on the device: loads the bodies, lets OpenMM run the program, and looks at what came of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.context.couplings import Couplings
from openmm_exactrb.context.host import Host, Plan
from openmm_exactrb.context.session import Session
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.device import gather, load, names
from openmm_exactrb.device.replicas import Replicas
from openmm_exactrb.device.rotor import RANGE
from openmm_exactrb.motion.guard import NonFiniteError
from openmm_exactrb.motion.kinetic import rigid
from openmm_exactrb.rotors import Rotor, rotor_of_sums
from openmm_exactrb.schemes.scheme import Scheme
from openmm_exactrb.schemes.word import DRIFT

# Bodies may turn this much faster within a call than at its start before the rotor's range ends.
_HASTE = 1.75


@dataclass
class Device(Host):
    """Steps of an integrator in its present Context that OpenMM makes by the integrator's program.

    Attributes
    ----------
    rate : float or None
        b norm(m) of the fastest body in 1/ps, None where it was not measured.
    """

    rate: float | None = None

    def advance(self, integrator: openmm.CustomIntegrator, plan: Plan, n: int) -> None:
        """Make n steps. After an error the Context holds what it held before.

        Raises
        ------
        NonFiniteError
            If numbers become infinite, or a body turns faster than the rotor's range.
        """
        session, scheme = self.session, plan.scheme
        assert isinstance(session, Replicas)
        context, (x, v) = session.context, session.settle()
        before = x, v, context.getTime(), context.getStepCount()
        self._set_turns(integrator, scheme)
        try:
            for steps, settings in _calls(n, bool(scheme.processor) and not self.couplings.act):
                for name, value in settings.items():
                    integrator.setGlobalVariableByName(name, value)
                openmm.CustomIntegrator.step(integrator, steps)
            finite = all(np.isfinite(a).all() for a in session.moved_on())
        except BaseException as error:
            self._go_back(integrator, *before)
            if isinstance(error, openmm.OpenMMException) and "NaN" in str(error):
                raise NonFiniteError(_complaint(before[3], n)) from error
            raise
        finally:
            for name, value in {names.ENTER: 1.0, names.LEAVE: 1.0, names.ASKED: 0.0, names.KNOWN: 0.0}.items():
                integrator.setGlobalVariableByName(name, value)
        if not finite:
            self._go_back(integrator, *before)
            raise NonFiniteError(_complaint(before[3], n))
        if n:
            self.rate = integrator.getGlobalVariableByName(names.FASTEST) ** (1.0 / names.POWER)
            self.timings.evaluations += n * scheme.forces + scheme.processing

    def _set_turns(self, integrator: openmm.CustomIntegrator, scheme: Scheme) -> None:
        """Choose how many rotations a drift is made of."""
        session = self.session
        if self.rate is None or not session.behind:
            self.rate = float(np.max(load.rates(session.bodies, session.state.rounded), initial=0.0))
        h = integrator.getStepSize().value_in_unit(unit.picosecond)
        longest = max((abs(part) for letter, part in scheme.word + scheme.processor if letter == DRIFT), default=0.0)
        turns = max(1, math.ceil(_HASTE * self.rate * abs(h) * longest / RANGE))
        if integrator.getGlobalVariableByName(names.TURNS) != turns:
            integrator.setGlobalVariableByName(names.TURNS, float(turns))

    def _go_back(self, integrator: openmm.CustomIntegrator, x: Any, v: Any, time: Any, step: int) -> None:
        """Bring the Context back to what it held."""
        context = self.session.context
        integrator.setGlobalVariableByName(names.LOADED, 0.0)
        context.setPositions(x)
        context.setVelocities(v)
        context.setTime(time)
        context.setStepCount(step)
        self.session.lose()
        self.session.take_up()


def device(
    context: Any,
    integrator: openmm.CustomIntegrator,
    rotor: Rotor,
    named: list[list[int]] | None,
    timings: Timings,
) -> Device:
    """Prepare the System of a Context and the program of its integrator.

    Raises
    ------
    ValueError
        If the force group of the sums is taken, or as `Session`.
    """
    system = context.getSystem()
    sites = any(map(system.isVirtualSite, range(system.getNumParticles())))
    gather.install(system, Session(context, integrator, named).bodies)
    gather.make_kernels(context)
    session, couplings = Replicas(context, integrator, named), Couplings(context, named or [])
    pushed = couplings.pushes or couplings.removes_motion
    for name, value in ((names.SITES, sites), (names.BAROSTAT, couplings.moves), (names.PUSHED, pushed)):
        integrator.setGlobalVariableByName(name, float(value))
    kinetic = rigid(session.bodies.mass, rotor_of_sums(rotor, session.bodies.inertia), rotor.order)
    return Device(session, couplings, kinetic, timings)


def _calls(n: int, processed: bool) -> Iterator[tuple[int, dict[str, float]]]:
    """Yield into which calls of OpenMM n steps fall, with what is to be set before each."""
    inner = {names.ENTER: 1.0, names.LEAVE: 1.0, names.ASKED: 0.0}
    if processed:
        inner |= {names.ENTER: 0.0, names.LEAVE: 0.0}
    if processed and n > 1:
        yield 1, inner | {names.ENTER: 1.0}
        n -= 1
    elif processed:
        inner |= {names.ENTER: 1.0}
    if n > 1:
        yield n - 1, inner
    if n > 0:
        yield 1, inner | {names.LEAVE: 1.0, names.ASKED: 1.0}


def _complaint(step: int, n: int) -> str:
    return (
        f"within the {n} steps after step {step} positions became infinite, or a body turned more than {_HASTE} times "
        "as fast as the fastest one before. The Context keeps the state before this call: take a smaller step size or "
        "fewer steps a call, or minimise the energy first"
    )
