"""Context updates, which OpenMM performs between steps: barostats, thermostats and the CMMotionRemover of a System."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import openmm

from openmm_exactrb.context.dipole_boxes import DipoleBoxes
from openmm_exactrb.context.synchronisation import Synchronisation
from openmm_exactrb.errors import RemovedMotionWarning
from openmm_exactrb.mathematics.compensated import add
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.state import State
from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.openmm_access.units import gas_constant_times
from openmm_exactrb.support.messages import listed
from openmm_exactrb.support.types import Array
from openmm_exactrb.support.warn import warn

#: Forces that change positions between steps.
BAROSTATS = (
    "MonteCarloAnisotropicBarostat",
    "MonteCarloBarostat",
    "MonteCarloFlexibleBarostat",
    "MonteCarloMembraneBarostat",
)
_THERMOSTAT, _REMOVER = "AndersenThermostat", "CMMotionRemover"
#: Forces that change positions or velocities between steps, and therefore the energy.
UPDATES = (_THERMOSTAT, _REMOVER, *BAROSTATS)


class ContextUpdates:
    """OpenMM's actions between steps in a Context; raises ValueError if a barostat would tear bodies apart.

    A CMMotionRemover acts on velocities alone, and therefore equally on the inner and the true state of a processed
    scheme. OpenMM applies barostats and thermostats of the System to the true state. Those whose frequency is 0 do not
    act; `settle` reads the frequencies again.

    Attributes
    ----------
    lost : tuple of int
        The degrees of freedom of translation and of rotation that constraints other than distances remove.
    has_thermostats : bool
        Whether the System has a thermostat, which may act or not.
    moves, pushes : bool
        Whether a barostat moves bodies, and whether a thermostat changes their momenta.
    interval : int
        Number of steps between two moves of a barostat; 0 if they never move bodies.
    temperatures : dict
        The names of acting barostats and thermostats, keyed by the Context parameter that holds their temperature.
    """

    def __init__(self, context: openmm.Context, named: Sequence[Sequence[int]], lost: tuple[int, int] = (0, 0)) -> None:
        self._removals = tuple(
            force.getFrequency() for force in context.getSystem().getForces() if type(force).__name__ == _REMOVER
        )
        self._couplings, self._named, self.lost = couplings(context), named, lost
        self._barostats = [force for force in self._couplings if not _is_thermostat(force)]
        self.has_thermostats = len(self._couplings) > len(self._barostats)
        dipoles = DipoleBoxes(context.getSystem())
        self._dipoles = dipoles if dipoles.any else None
        self._since_trial = [0] * len(self._barostats)  # updates since the last trial of each barostat
        self._frequencies: list[float] | None = None
        self._several = False
        self.settle(context)

    def settle(self, context: openmm.Context, temperature: float | None = None) -> None:
        """Take account of barostats and thermostats that were switched on or off since the last call.

        Parameters
        ----------
        context : openmm.Context
        temperature : float, optional
            The temperature in K of the integrator's thermostat, if this thermostat acts.

        Raises
        ------
        ValueError
            If a barostat would tear bodies apart, or has another temperature than the integrator, or both the System
            and the integrator have a thermostat, or dipoles have no valid energy in the present box.
        """
        frequencies = [frequency(force, context) for force in self._couplings]
        if frequencies != self._frequencies:
            acting = [force for force, rate in zip(self._couplings, frequencies, strict=True) if rate]
            barostats = [force for force in acting if not _is_thermostat(force)]
            _check_torn_bodies(context, barostats, self._named)
            self._frequencies = frequencies
            self._waiting = 0  # steps since OpenMM last acted
            self.moves, self.pushes = bool(barostats), len(acting) > len(barostats)
            self.interval = math.gcd(*(int(frequency(force)) for force in barostats))
            self._several |= len(barostats) > 1
            self.temperatures = {force.Temperature(): type(force).__name__ for force in acting}
        self.check_box(context)
        if temperature is not None and self.temperatures:
            self._check_temperatures(context, temperature)

    def check_box(self, context: openmm.Context) -> None:
        """Raise ValueError if dipoles have no valid energy in the present box, which barostats may have accepted."""
        if self._dipoles is not None:
            self._dipoles.check(context, barostats=self.moves)

    def hottest(self, context: openmm.Context) -> float:
        """Return the largest RT (kJ/mol) of thermostats and barostats, from the present parameters of the Context."""
        return max((gas_constant_times(context.getParameter(name)) for name in self.temperatures), default=0.0)

    def _check_temperatures(self, context: openmm.Context, temperature: float) -> None:
        """Raise ValueError for a second thermostat, or a barostat at a temperature other than the integrator's (K)."""
        if self.pushes:
            raise ValueError(
                "the System has an AndersenThermostat, but this integrator also has a thermostat: remove the "
                "AndersenThermostat from the System, or use ExactRigidBodyIntegrator"
            )
        for parameter, name in self.temperatures.items():
            own = context.getParameter(parameter)
            if not math.isclose(own, temperature, rel_tol=1e-9):
                raise ValueError(
                    f"the temperature of the {name} is {own:.10g} K, but that of the integrator is {temperature:.10g} "
                    f"K: call context.setParameter({parameter!r}, {temperature:.10g}) or "
                    f"integrator.setTemperature({own:.10g})"
                )

    @property
    def act(self) -> bool:
        """Whether barostats, thermostats or a CMMotionRemover act."""
        return self.moves or self.pushes or self.removes_motion

    @property
    def removes_motion(self) -> bool:
        """Whether the centre of mass is kept at rest."""
        return bool(self._removals)

    def freedom(self, bodies: RigidBodies) -> tuple[int, int]:
        """Return the degrees of freedom of translation and of rotation."""
        translation, rotation = self.lost
        return (
            bodies.translational_freedom - 3 * self.removes_motion - translation,
            bodies.rotational_freedom - rotation,
        )

    @property
    def always(self) -> bool:
        """Whether OpenMM acts after every step, because of a thermostat or of barostats that count differently."""
        return self.pushes or (self.moves and self._several)

    @property
    def period(self) -> int:
        """Number of steps between two actions of barostats or thermostats; 0 if they never act."""
        return 1 if self.always else self.interval

    @property
    def removal(self) -> int:
        """Number of steps between two removals of motion; 0 if motion is never removed."""
        return math.gcd(*self._removals)

    def remove_motion(self, mass: Array, state: State, number: int) -> State:
        """Return the state after a given step, with the centre of mass at rest if a removal is due; masses are (N,)."""
        if any(number % interval == 0 for interval in self._removals):
            velocity = state.P.sum(axis=(0, 2)) / mass.sum()
            return state._replace(P=add(state.P, -velocity[:, None] * mass))
        return state

    def due(self) -> int:
        """Count a step, and return the number of OpenMM's updates that are due; only the last has an effect.

        A barostat of frequency n acts in every n-th update. The other updates have no effect and are deferred.
        """
        if not self.period:
            return 0
        self._waiting += 1
        if self._waiting < self.period:
            return 0
        waiting, self._waiting = self._waiting, 0
        return waiting

    def trial_energies(self, n: int) -> int:
        """Return the number of energies that barostats evaluate in n updates of OpenMM: two for each trial volume."""
        trials = 0
        for k, barostat in enumerate(self._barostats):
            if period := int(frequency(barostat)):
                more, self._since_trial[k] = divmod(min(self._since_trial[k], period - 1) + n, period)
                trials += more
        return 2 * trials

    def changed(self, sync: Synchronisation, state: State, box: tuple[float, ...]) -> State:
        """Return a state after an update of its Context; `box` is the box before the update.

        A ValueError is raised if dipoles have no valid energy in the present box: OpenMM accepts an energy of nan.
        """
        context = sync.context
        self.check_box(context)
        if not self.pushes:
            if arrays.box(context.getState()) == box:
                return state
            sync.write_velocities(state)  # so that only positions differ from the state
        x, v = sync.held()
        sync.particles[:] = x  # a barostat moves massless particles too
        return sync.compared(state, x, v)


def warn_of_removed_motion(system: openmm.System) -> None:
    """Warn of a CMMotionRemover in a System whose frozen particles accelerate the centre of mass of other particles."""
    massless = (i for i in range(system.getNumParticles()) if not system.getParticleMass(i)._value)
    removes = any(isinstance(force, openmm.CMMotionRemover) for force in system.getForces())
    if removes and not all(map(system.isVirtualSite, massless)):
        warn(
            "the CMMotionRemover removes the momentum that frozen particles (mass 0) transfer to the others, which "
            "causes energy errors of first order in the step size: create the System with removeCMMotion=False",
            RemovedMotionWarning,
        )


def couplings(context: openmm.Context) -> list[Any]:
    """Return the thermostats and barostats that a Context had when it was created; those added later do not act."""
    known = set(context.getParameters())
    names = (_THERMOSTAT, *BAROSTATS)
    found = [force for force in context.getSystem().getForces() if type(force).__name__ in names]
    return [force for force in found if force.Temperature() in known]


def frequency(force: Any, context: openmm.Context | None = None) -> float:
    """Return how often a force acts between steps: per ps for a thermostat, or steps from one action to the next.

    The force never acts if the result is 0. Without a Context, the result for a thermostat is its default.
    """
    if not _is_thermostat(force):
        scales = not isinstance(force, openmm.MonteCarloAnisotropicBarostat) or any(
            (force.getScaleX(), force.getScaleY(), force.getScaleZ())
        )
        return int(force.getFrequency()) * scales
    if context is None:
        return float(force.getDefaultCollisionFrequency()._value)
    return float(context.getParameter(force.CollisionFrequency()))


def acting_updates(context: openmm.Context) -> list[Any]:
    """Return the thermostats and barostats that act in a Context at present."""
    return [force for force in couplings(context) if frequency(force, context)]


def names_of_updates(system: openmm.System) -> list[str]:
    """Return the names of the forces that act between steps in new Contexts of a System."""
    return [name for force in system.getForces() if (name := type(force).__name__) in UPDATES and frequency(force)]


def _is_thermostat(force: Any) -> bool:
    return type(force).__name__ == _THERMOSTAT


def _check_torn_bodies(context: openmm.Context, barostats: list[Any], named: Sequence[Sequence[int]]) -> None:
    """Raise ValueError if a barostat, which moves particles or OpenMM's molecules individually, would tear bodies."""
    for barostat in barostats:
        if not getattr(barostat, "getScaleMoleculesAsRigid", lambda: True)():
            name = type(barostat).__name__
            raise ValueError(
                f"the {name} would change distances within bodies: call setScaleMoleculesAsRigid(True) on this "
                "barostat before you create the Simulation"
            )
    if not barostats or not named:
        return
    molecule = {particle: number for number, molecule in enumerate(context.getMolecules()) for particle in molecule}
    for number, body in enumerate(named):
        if len({molecule[particle] for particle in body}) > 1:
            raise ValueError(
                f"a barostat would tear apart body {number} (particles {listed(body)}), which OpenMM does "
                "not treat as one molecule: join its particles by bonds, such as those of a HarmonicBondForce with k "
                "= 0"
            )
