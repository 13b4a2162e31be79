"""What OpenMM does between steps, as a letter of the word: barostats, thermostats, CMMotionRemover."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.compensated import add
from openmm_exactrb.context import arrays
from openmm_exactrb.context.clock import Clock
from openmm_exactrb.context.forces import Places
from openmm_exactrb.context.session import Session
from openmm_exactrb.context.units import gas_constant_times
from openmm_exactrb.motion.engine import Flow
from openmm_exactrb.motion.state import State

Array = NDArray[np.float64]

_BAROSTATS = (
    "MonteCarloAnisotropicBarostat",
    "MonteCarloBarostat",
    "MonteCarloFlexibleBarostat",
    "MonteCarloMembraneBarostat",
)
_THERMOSTAT, _REMOVER = "AndersenThermostat", "CMMotionRemover"
#: Forces that change positions or velocities between steps: without them a System conserves its energy.
COUPLINGS = (_THERMOSTAT, _REMOVER, *_BAROSTATS)


class Couplings:
    """The couplings of a System.

    Parameters
    ----------
    context : openmm.Context
    named : sequence of sequences of int
        Particles of bodies that a user named.

    Raises
    ------
    ValueError
        If a barostat would tear bodies.

    Attributes
    ----------
    intervals : tuple of int
        Steps between two removals of the motion of the centre of mass.
    moves, pushes : bool
        Whether a barostat moves bodies, and a thermostat changes their momenta.
    """

    def __init__(self, context: openmm.Context, named: Sequence[Sequence[int]]) -> None:
        removers = [force for force in context.getSystem().getForces() if type(force).__name__ == _REMOVER]
        baths = acting_baths(context)
        thermostats, barostats = ([b for b in baths if (type(b).__name__ == _THERMOSTAT) is t] for t in (True, False))
        _refuse_torn_bodies(context, barostats, named)
        self.intervals = tuple(force.getFrequency() for force in removers)
        self.moves, self.pushes = bool(barostats), bool(thermostats)
        self._of_thermostats, self._of_baths = (
            {force.Temperature() for force in forces} for forces in (thermostats, baths)
        )

    def hottest_thermostat(self, context: openmm.Context) -> float:
        """Return RT (kJ/mol) of the hottest thermostat, as the parameters of the Context have it now."""
        return _highest(context, self._of_thermostats)

    def hottest(self, context: openmm.Context) -> float:
        """Return RT (kJ/mol) of the hottest thermostat or barostat, as the parameters of the Context have it now."""
        return _highest(context, self._of_baths)

    @property
    def act(self) -> bool:
        """Whether there are any."""
        return self.moves or self.pushes or self.removes_motion

    @property
    def removes_motion(self) -> bool:
        """Whether the centre of mass is kept at rest."""
        return bool(self.intervals)

    def flow(self, session: Session, places: Places, clock: Clock) -> Flow[State]:
        """Return what OpenMM does between two steps.

        Barostats and thermostats do it themselves, at the places of the state; a moved box or new velocities are taken
        up. The motion of the centre of mass is removed here, from momenta in float64.
        """
        context = session.context

        def openmm_acts(state: State) -> State:
            places.write(state)
            if self.pushes:
                session.write_velocities(state)
            box = arrays.box(context.getState())
            clock.tick()
            if not self.pushes:
                if arrays.box(context.getState()) == box:
                    return state
                session.write_velocities(state)  # so that only places differ from those of the state
            places.lose()
            x, v = session.held()
            session.particles[:] = x  # a barostat moves what has no mass too
            return session.compared(state, x, v)

        def flow(state: State, tau: float) -> State:
            if self.moves or self.pushes:
                state = openmm_acts(state)
            if any(clock.number % interval == 0 for interval in self.intervals):
                state = without_motion(session.bodies.mass, state)
            return state

        return flow


def _highest(context: openmm.Context, parameters: set[str]) -> float:
    return max((gas_constant_times(context.getParameter(name)) for name in parameters), default=0.0)


def acting_baths(context: openmm.Context) -> list[Any]:
    """Return the thermostats and barostats that a Context knows: those that joined its System later do nothing."""
    known = set(context.getParameters())
    names = (_THERMOSTAT, *_BAROSTATS)
    baths = [force for force in context.getSystem().getForces() if type(force).__name__ in names]
    return [force for force in baths if force.Temperature() in known]


def refuse_other_baths(context: openmm.Context, temperature: float) -> None:
    """Refuse what would bring the bodies of an integrator with a bath to another temperature (K), or a second bath.

    Raises
    ------
    ValueError
        If there is a thermostat in the System, or a barostat of another temperature.
    """
    baths = [(type(force).__name__, force.Temperature()) for force in acting_baths(context)]
    if any(name == _THERMOSTAT for name, _ in baths):
        raise ValueError(
            "the System has an AndersenThermostat, but this integrator is a thermostat itself: remove it from the "
            "System, or take ExactRigidBodyIntegrator"
        )
    for name, parameter in baths:
        own = context.getParameter(parameter)
        if not math.isclose(own, temperature, rel_tol=1e-9):
            raise ValueError(
                f"the {name} is at {own:g} K, the integrator at {temperature:g} K: give both the same, with "
                f"context.setParameter({parameter!r}, {temperature:g}) or with setTemperature"
            )


def without_motion(mass: Array, state: State) -> State:
    """Return a state whose centre of mass is at rest; the masses of the bodies are (N,)."""
    velocity = state.P.sum(axis=(0, 2)) / mass.sum()
    return state._replace(P=add(state.P, -np.outer(velocity, mass)))


def _refuse_torn_bodies(context: openmm.Context, barostats: list[Any], named: Sequence[Sequence[int]]) -> None:
    """Refuse bodies that a barostat would tear, since it moves particles, or OpenMM's molecules, each by itself."""
    for barostat in barostats:
        if not getattr(barostat, "getScaleMoleculesAsRigid", lambda: True)():
            name = type(barostat).__name__
            raise ValueError(f"{name} would scale the bodies themselves: call its setScaleMoleculesAsRigid(True)")
    if not barostats or not named:
        return
    molecule = {particle: number for number, molecule in enumerate(context.getMolecules()) for particle in molecule}
    for number, body in enumerate(named):
        if len({molecule[particle] for particle in body}) > 1:
            raise ValueError(
                f"a barostat would tear body {number} (particles {', '.join(map(str, body))}), which is not one "
                "molecule for OpenMM: join its particles by bonds, for example of a HarmonicBondForce of strength 0"
            )
