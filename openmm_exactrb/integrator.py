"""ExactRigidBodyIntegrator: OpenMM computes the forces, splitting and rotation are ours."""

from __future__ import annotations

import copy
import gc
import time
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb import vectors
from openmm_exactrb.bodies import LIGHT, BodyState, Indices, RigidBodies, find_bodies
from openmm_exactrb.propagate import move
from openmm_exactrb.rotors import ROTORS, rotor_of_sums
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.sums import exactly, fastest_advance, renewed

Array = NDArray[np.float64]

# Positions (nm) and velocities (nm/ps) closer than this to those of the stored bodies are theirs: an integrator that
# finds its Context changed by less goes on from the full float64 state.
_SAME = 1e-9
# Per-DOF variables, on the first particle of each body, in which the state travels in checkpoints and States: high
# parts, then low parts of the sums.
_STORED = tuple(f"exactrb_{name}{part}" for part in ("", "_low") for name in "RPmqw")
_IS_STORED = "exactrb_stored"
#: Forces that change positions or velocities between steps: without them a System conserves its energy.
COUPLINGS = (
    "AndersenThermostat",
    "CMMotionRemover",
    "MonteCarloAnisotropicBarostat",
    "MonteCarloBarostat",
    "MonteCarloFlexibleBarostat",
    "MonteCarloMembraneBarostat",
)


class NonFiniteError(ArithmeticError):
    """A body has numbers that are not finite, or is faster than light; the Context keeps the last good step."""


@dataclass
class Timings:
    """Wall time in seconds, and force evaluations, since the integrator was made or `reset` was called.

    Attributes
    ----------
    forces : float
        Inside OpenMM: setPositions, computeVirtualSites, getState.
    rotor : float
        The free rotation of the bodies.
    total : float
        Everything inside step().
    evaluations : int
        Force evaluations.
    """

    forces: float = 0.0
    rotor: float = 0.0
    total: float = 0.0
    evaluations: int = 0

    def reset(self) -> None:
        """Begin again at zero."""
        self.forces = self.rotor = self.total = 0.0
        self.evaluations = 0


class ExactRigidBodyIntegrator(openmm.CustomIntegrator):
    """Rigid-body dynamics with the exact free rotation and a symmetric splitting.

    Rigid bodies are the clusters of particles that constraints of the System hold rigid; particles without constraints
    move beside them. After every step(n) the Context holds the positions, velocities, time and step count of the
    bodies; what is set in the Context between calls is taken up. A call evaluates the forces of its first positions
    anew, since parameters may have been changed; within a call no force is evaluated twice.

    Parameters
    ----------
    stepSize : float or Quantity
        Size of a whole step of the scheme, in ps if it has no unit.
    scheme : str or Scheme, optional
        A key of `openmm_exactrb.SCHEMES`.
    rotor : str, optional
        A key of `openmm_exactrb.ROTORS`.
    bodies : sequence of sequences of int, optional
        Particles of rigid bodies beside those that constraints make. Their shape is that of the positions at the first
        step; what acts within them only adds a constant to the energy.

    Raises
    ------
    ValueError
        If scheme or rotor is unknown, or the step size is not a finite time.

    Attributes
    ----------
    timings : Timings
    """

    def __init__(
        self,
        stepSize: float | unit.Quantity,
        scheme: str | Scheme = "SRKN4_6b",
        rotor: str = "exact",
        bodies: Sequence[Sequence[int]] | None = None,
    ) -> None:
        self._scheme = look_up(scheme)
        if self._scheme.c:
            raise ValueError(
                f"scheme {self._scheme.name} needs force gradients, which OpenMM has not: choose another one"
            )
        if rotor not in ROTORS:
            raise ValueError(f"unknown rotor {rotor!r}: choose one of {', '.join(ROTORS)}")
        self._rotor = rotor
        self._bodies = None if bodies is None else [list(map(int, body)) for body in bodies]
        super().__init__(_picoseconds(stepSize))
        for name in _STORED:
            self.addPerDofVariable(name, 0.0)
        self.addGlobalVariable(_IS_STORED, 0.0)
        self.addUpdateContextState()
        self.timings = Timings()
        self._coupling: _Coupling | None = None

    # -- what a user asks for -----------------------------------------------------------------------------------

    def getScheme(self) -> Scheme:
        """Return the splitting scheme."""
        return self._scheme

    def getRotor(self) -> str:
        """Return the name of the free-rotor flow."""
        return self._rotor

    def hasNamedBodies(self) -> bool:
        """Tell whether there are bodies beside those that constraints make."""
        return self._bodies is not None

    def getNamedBodies(self) -> list[list[int]] | None:
        """Return the particles of the bodies beside those that constraints make, as they were handed over."""
        return copy.deepcopy(self._bodies)

    @property
    def forceEvaluationsPerStep(self) -> int:
        """Force evaluations that a step costs; a processed scheme needs `Scheme.processing` more a call of `step`."""
        return self._scheme.stages

    def setStepSize(self, size: float | unit.Quantity) -> None:
        """Set the size of a whole step of the scheme, in ps if it has no unit."""
        super().setStepSize(_picoseconds(size))

    def bind(self, context: openmm.Context) -> None:
        """Tell the integrator its Context.

        Only needed where it cannot be found, since `step` looks for the Context that was made with this integrator; and
        after `openmm.Context.reinitialize` where masses or lengths of constraints were changed. Forces and constraints
        that were added or removed are noticed without.

        Parameters
        ----------
        context : openmm.Context
            Made with this integrator.

        Raises
        ------
        ValueError
            If the Context has another integrator, its System has no rigid bodies, or its positions do not fit them.
        """
        if context.getIntegrator() is not self and getattr(context, "_integrator", None) is not self:
            raise ValueError("this Context was made with another integrator: bind the one that it was made with")
        self._coupling = _Coupling(context, self._rotor, self.getIntegrationForceGroups(), self.timings, self._bodies)

    def step(self, steps: int) -> None:
        """Advance the bodies by this many steps.

        Parameters
        ----------
        steps : int

        Raises
        ------
        ValueError
            If there is no Context yet, the System has no rigid bodies, a barostat would tear them, or positions are not
            finite or not rigid.
        NonFiniteError
            If numbers of a body become infinite or nan, or it is faster than light. The Context then holds the state
            after the last good step; with a processed scheme, that before this call. So it does after any other error
            in a force.
        """
        start = time.perf_counter()
        coupling = self._up_to_date()
        coupling.groups = self.getIntegrationForceGroups()
        coupling.forget_forces()
        h = self.getStepSize().value_in_unit(unit.picosecond)
        first = coupling.context.getStepCount() + 1
        time_now, done = coupling.context.getTime().value_in_unit(unit.picosecond), 0
        before = coupling.sums
        ends = range(steps) if coupling.changing else (steps - 1,)
        try:
            for number in range(steps):
                begins = number == 0 or coupling.changing
                coupling.step(self._scheme, h, (first + done, time_now), begins, number in ends)
                time_now += h
                done += 1
                if coupling.changing:
                    coupling.let_openmm_change(self)
        except BaseException:  # a force of the user's, or Ctrl-C, as well as a blow-up
            if self._scheme.processor and not coupling.changing:  # the state between is not that of the bodies
                coupling.sums, time_now, done = before, time_now - done * h, 0
            raise
        finally:
            if not coupling.changing and done:
                super().step(done)
            # OpenMM's own clock does not learn of a new step size where no computation uses dt.
            coupling.context.setTime(time_now)
            coupling.publish(self)
            self.timings.total += time.perf_counter() - start

    def kineticEnergies(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and the rotational kinetic energy of the bodies, as Quantities in kJ/mol."""
        coupling = self._up_to_date()
        translational, rotational = coupling.bodies.kinetic_energies(coupling.state)
        return translational * unit.kilojoule_per_mole, rotational * unit.kilojoule_per_mole

    def totalEnergy(self) -> unit.Quantity:
        """Return the energy that a run should keep, in kJ/mol: kinetic, and potential of the force groups that act.

        The kinetic part is that of the bodies in float64, also where the platform's velocities are rounded.
        """
        context = self._up_to_date().context
        state = context.getState(energy=True, groups=self.getIntegrationForceGroups())
        return sum(self.kineticEnergies(), state.getPotentialEnergy())

    def degreesOfFreedom(self) -> tuple[int, int]:
        """Return the numbers of translational and of rotational degrees of freedom.

        A linear body has two rotational ones, a single particle none. Where the System has a CMMotionRemover, three
        translational ones are missing.
        """
        coupling = self._up_to_date()
        return 3 * len(coupling.bodies) - 3 * coupling.removes_motion, coupling.bodies.rotational_freedom

    def temperatures(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and the rotational temperature of the bodies."""
        pairs = zip(self.kineticEnergies(), self.degreesOfFreedom(), strict=True)
        translational, rotational = (
            (2.0 * energy / (max(freedom, 1) * unit.MOLAR_GAS_CONSTANT_R)).in_units_of(unit.kelvin)
            for energy, freedom in pairs
        )
        return translational, rotational

    def setVelocitiesToTemperature(self, temperature: float | unit.Quantity, randomSeed: int | None = None) -> None:
        """Draw the momenta of the bodies from the canonical distribution.

        Unlike the method of the Context, it is right for linear bodies and for bodies without constraints.

        Parameters
        ----------
        temperature : float or Quantity
            In K if it has no unit.
        randomSeed : int, optional

        Raises
        ------
        ValueError
            If the temperature is negative, not finite or has a unit that does not fit.
        """
        coupling = self._up_to_date()
        coupling.thermalise(_gas_constant_times(temperature), np.random.default_rng(randomSeed))
        coupling.publish(self)

    def bodyState(self) -> tuple[RigidBodies, BodyState]:
        """Return the bodies and copies of their positions, attitudes and momenta in float64."""
        coupling = self._up_to_date()
        return coupling.bodies, BodyState(*(a.copy() for a in coupling.state))

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle the settings; a copy has no Context."""
        arguments = (self.getStepSize().value_in_unit(unit.picosecond), self._scheme, self._rotor, self._bodies)
        return _restored, (type(self), arguments, self.getIntegrationForceGroups())

    def __copy__(self) -> ExactRigidBodyIntegrator:
        """Return an integrator with the same settings and no Context."""
        factory, arguments = self.__reduce__()
        twin: ExactRigidBodyIntegrator = factory(*arguments)
        return twin

    def __deepcopy__(self, memo: dict[int, Any]) -> ExactRigidBodyIntegrator:
        """Return an integrator with the same settings and no Context."""
        return self.__copy__()

    def _up_to_date(self) -> _Coupling:
        """Return the coupling to the present Context, with what was set there taken up."""
        if self._coupling is None or self._coupling.context is None or self._coupling.outdated():
            self.bind(self._find_context())
        coupling = self._coupling
        assert coupling is not None
        coupling.take_up(self)
        return coupling

    def _find_context(self) -> openmm.Context:
        """Find the Context that was made with this integrator: OpenMM does not tell."""
        for referrer in gc.get_referrers(self):
            if isinstance(referrer, openmm.Context):
                return referrer
            if isinstance(referrer, dict) and referrer.get("_integrator") is self:
                for owner in gc.get_referrers(referrer):
                    if isinstance(owner, openmm.Context):
                        return owner
        raise ValueError(
            "the integrator has no Context yet: make a Simulation or a Context with it first, or call bind(context)"
        )


class _Coupling:
    """The bodies of one Context, and the two flows that move them.

    Holds no strong reference to the Context, which owns the integrator that owns this.
    """

    def __init__(
        self,
        context: openmm.Context,
        method: str,
        groups: int,
        timings: Timings,
        bodies: Sequence[Sequence[int]] | None,
    ) -> None:
        system = context.getSystem()
        x, v = _positions_and_velocities(context)
        self._context = weakref.ref(context)
        if len(x) > 1 and not x.any():
            raise ValueError("the Context has no positions yet: call setPositions first")
        self.bodies = find_bodies(system, x, bodies)
        self._fast = float(np.min(LIGHT * self.bodies.mass, initial=np.inf)) ** 2  # no body is, below this sum of P²
        _refuse_torn_bodies(context, bodies or [])
        self.groups = groups
        self.timings = timings
        self._contents = _contents(system)
        #: Whether OpenMM itself changes positions or velocities between steps.
        self.changing = not self._contents[1].isdisjoint(COUPLINGS)
        self.removes_motion = "CMMotionRemover" in self._contents[1]
        self._flow, self._advance = rotor_of_sums(method, self.bodies.inertia), fastest_advance()
        self._x, self._v = x.copy(), v.copy()  # what is handed to OpenMM
        self._seen: tuple[Array, Array] | None = None  # what the Context held when `state` was last in it
        self._forces: tuple[Array, Array] | None = None  # of the present positions
        self._at = (0, 0.0)
        #: The state as sums high + low, (2, k, N), so that no step rounds it.
        self.sums = BodyState(*map(exactly, self.bodies.fit(x, v)))

    @property
    def state(self) -> BodyState:
        """The state rounded to float64."""
        return self.sums.high

    @state.setter
    def state(self, state: BodyState) -> None:
        self.sums = BodyState(*map(renewed, self.sums, state))

    @property
    def context(self) -> Any:
        """The Context, or None when it is gone."""
        return self._context()

    def outdated(self) -> bool:
        """Tell whether the System was changed, as users do before they reinitialize the Context."""
        return _contents(self.context.getSystem()) != self._contents

    def step(self, scheme: Scheme, h: float, at: tuple[int, float], begins: bool, ends: bool) -> None:
        """Move the bodies by one step, which errors call by its number and the time (ps) before it.

        `begins` and `ends` say whether a processed scheme has to prepare the state before it, or to finish it after.
        """
        self._at = at
        flows = chain(scheme.processor * begins, scheme.sequence, scheme.postprocessor * ends)
        with np.errstate(all="ignore"):  # what is not finite is reported, with the bodies concerned
            self.sums = self._finite(move(flows, self.sums, h, self._drift, self._kick))

    def _drift(self, state: BodyState, tau: float) -> BodyState:
        start = time.perf_counter()
        q, m = self._flow(state.q, state.m, tau)
        self.timings.rotor += time.perf_counter() - start
        self._forces = None
        return BodyState(self._advance(state.R, state.P[0] / self.bodies.mass, tau), state.P, q, m)

    def _kick(self, state: BodyState, tau: float) -> BodyState:
        if self._forces is None:
            self._forces = self.bodies.forces(state.high, self._particle_forces(state.high))
        force, torque = self._forces
        after = state._replace(P=self._advance(state.P, force, tau), m=self._advance(state.m, torque, tau))
        return self._finite(after)

    def _finite(self, state: BodyState) -> BodyState:
        """Return a state whose numbers are fit for OpenMM, or raise NonFiniteError.

        Their squares are looked at, because finite numbers of 1e200 are as useless; places too, because the forces
        between infinite ones may vanish; and speeds, because bodies that were thrown apart may never meet again.
        """
        R, P, q, m = (float(np.vdot(x[0], x[0])) for x in state)
        if not np.isfinite(R + P + q + m) or (self._fast < P and self.bodies.lost(state.high).any()):
            self.forget_forces()
            raise NonFiniteError(self._complaint(state.high))
        return state

    def _particle_forces(self, state: BodyState) -> Array:
        x = self.bodies.positions(state, self._x)
        start = time.perf_counter()
        self.context.setPositions(x)
        self.context.computeVirtualSites()
        forces = vectors.forces(self.context.getState(forces=True, groups=self.groups))
        self.timings.forces += time.perf_counter() - start
        self.timings.evaluations += 1
        return forces

    def _complaint(self, after: BodyState) -> str:
        bad = np.flatnonzero(self.bodies.lost(after))
        names = "; ".join(self.bodies.name(int(b)) for b in bad[:3])
        more = f" and {len(bad) - 3} more" if len(bad) > 3 else ""
        pair, distance = self.bodies.closest(self.state)
        closest = f"The closest before it were the bodies {pair[0]} and {pair[1]}, {distance:.3g} nm apart. "
        number, time = self._at
        return (
            f"step {number}, after {time:.6g} ps: not finite or faster than light: {names}{more}. "
            f"{closest if len(self.bodies) > 1 else ''}The Context keeps the state before this step: take a smaller "
            "step size, or minimise the energy first"
        )

    def take_up(self, store: openmm.CustomIntegrator) -> None:
        """Bring the state up to date with what was set in the Context since it was published."""
        x, v = _positions_and_velocities(self.context)
        if self._seen is None or not all(map(np.array_equal, self._seen, (x, v))):
            self._compare(self._stored(store), x, v)

    def _compare(self, known: BodyState | None, x: Array, v: Array) -> None:
        """Take the state from x and v, or from the known sums for the bodies that are where they say."""
        self._seen = (x, v)
        self._x[:], self._v[:] = x, v  # particles without mass that are no virtual sites stay where they are
        if known is None:
            self.state = self.bodies.fit(x, v)
            return
        self.sums = known
        moved = _differs(self.bodies, x, self.bodies.positions(known.high, self._x))
        pushed = _differs(self.bodies, v, self.bodies.velocities(known.high, self._v))
        if len(moved) or len(pushed):
            self.state = self.bodies.refit(known.high, x, v, moved, pushed)

    def let_openmm_change(self, store: openmm.CustomIntegrator) -> None:
        """Let barostats, thermostats and the like of the System do their part of a step."""
        self._write()
        openmm.CustomIntegrator.step(store, 1)
        self._compare(self.sums, *_positions_and_velocities(self.context))

    def thermalise(self, kT: float, rng: np.random.Generator) -> None:
        """Draw momenta at a temperature."""
        bodies, state = self.bodies, self.state
        P = np.sqrt(kT * bodies.mass) * rng.standard_normal(state.P.shape)
        if self.removes_motion:
            P -= bodies.mass * (P.sum(axis=1, keepdims=True) / bodies.mass.sum())
        m = np.sqrt(kT * bodies.inertia.T) * rng.standard_normal(state.m.shape)
        for kind in bodies.kinds:
            if kind.linear:
                m[0, kind.bodies] = 0.0
        self.state = state._replace(P=P, m=m)

    def forget_forces(self) -> None:
        """Evaluate forces anew: parameters of the Context, the box or a force may have been changed."""
        self._forces = None

    def publish(self, store: openmm.CustomIntegrator) -> None:
        """Write the state into the Context: as particles, and in full into the per-DOF variables of the integrator."""
        self._write()
        (R, P, q, m), bodies = self.sums, self.bodies
        first, turning = bodies.first_particle, bodies.first_particle[: bodies.n_turning]
        full = np.zeros((2, 5, bodies.n_particles, 3))
        full[:, 0, first], full[:, 1, first] = R.swapaxes(1, 2), P.swapaxes(1, 2)
        full[:, 2, turning], full[:, 3, turning] = m.swapaxes(1, 2), q[:, 1:].swapaxes(1, 2)
        full[:, 4, turning, 0] = q[:, 0]
        for name, values in zip(_STORED, full.reshape(-1, bodies.n_particles, 3), strict=True):
            store.setPerDofVariableByName(name, values)
        store.setGlobalVariableByName(_IS_STORED, 1.0)
        self._seen = _positions_and_velocities(self.context)

    def _write(self) -> None:
        """Write positions and velocities into the Context."""
        self.context.setPositions(self.bodies.positions(self.state, self._x))
        self.context.setVelocities(self.bodies.velocities(self.state, self._v))
        self.context.computeVirtualSites()

    def _stored(self, store: openmm.CustomIntegrator) -> BodyState | None:
        if not store.getGlobalVariableByName(_IS_STORED):
            return None
        first, k = self.bodies.first_particle, self.bodies.n_turning
        columns = [np.array(store.getPerDofVariableByName(name), dtype=np.float64)[first].T for name in _STORED]
        R, P, m, vector, w = np.array(columns).reshape(2, 5, 3, len(first)).swapaxes(0, 1)
        q = np.concatenate([w[:, :1, :k], vector[:, :, :k]], axis=1)
        return BodyState(*map(np.ascontiguousarray, (R, P, q, m[:, :, :k])))


def _restored(kind: type[ExactRigidBodyIntegrator], arguments: tuple[Any, ...], groups: int) -> Any:
    """Return an integrator with the settings of another one."""
    integrator = kind(*arguments)
    integrator.setIntegrationForceGroups(groups)
    return integrator


def _plain(value: float | unit.Quantity, in_unit: unit.Unit, what: str) -> float:
    """Return a number in a unit; one without a unit already is."""
    quantity: Any = value
    if unit.is_quantity(value):
        if not quantity.unit.is_compatible(in_unit):
            raise ValueError(f"{value} is not {what}: give it in {in_unit.get_symbol()}, or as a Quantity of its kind")
        quantity = quantity.value_in_unit(in_unit)
    if not isinstance(quantity, (int, float, np.number)) or not np.isfinite(quantity):
        raise ValueError(f"{what} must be a finite number of {in_unit.get_symbol()}, not {value!r}")
    return float(quantity)


def _picoseconds(size: float | unit.Quantity) -> float:
    """Return a step size in ps."""
    return _plain(size, unit.picosecond, "a time step")


def _gas_constant_times(temperature: float | unit.Quantity) -> float:
    """Return RT in kJ/mol of a temperature in K."""
    kelvin = _plain(temperature, unit.kelvin, "a temperature")
    if kelvin < 0.0:
        raise ValueError(f"a temperature must not be negative, not {temperature}")
    return float((kelvin * unit.kelvin * unit.MOLAR_GAS_CONSTANT_R).value_in_unit(unit.kilojoule_per_mole))


def _contents(system: openmm.System) -> tuple[int, frozenset[str]]:
    """Return the number of constraints and the kinds of forces of a System."""
    return system.getNumConstraints(), frozenset(type(force).__name__ for force in system.getForces())


def _refuse_torn_bodies(context: openmm.Context, bodies: Sequence[Sequence[int]]) -> None:
    """Refuse bodies that a barostat would tear, since it moves particles, or OpenMM's molecules, each by itself."""
    barostats = [force for force in context.getSystem().getForces() if "Barostat" in type(force).__name__]
    for barostat in barostats:
        if not getattr(barostat, "getScaleMoleculesAsRigid", lambda: True)():
            name = type(barostat).__name__
            raise ValueError(f"{name} would scale the bodies themselves: call its setScaleMoleculesAsRigid(True)")
    if not barostats or not bodies:
        return
    molecule = {particle: number for number, molecule in enumerate(context.getMolecules()) for particle in molecule}
    for number, body in enumerate(bodies):
        if len({molecule[particle] for particle in body}) > 1:
            raise ValueError(
                f"a barostat would tear body {number} (particles {', '.join(map(str, body))}), which is not one "
                "molecule for OpenMM: join its particles by bonds, for example of a HarmonicBondForce of strength 0"
            )


def _positions_and_velocities(context: openmm.Context) -> tuple[Array, Array]:
    state = context.getState(positions=True, velocities=True)
    return vectors.positions(state), vectors.velocities(state)


def _differs(bodies: RigidBodies, actual: Array, expected: Array) -> Indices:
    """Return the bodies with a particle that is not where it is expected; nan differs."""
    different = np.zeros(len(bodies), dtype=bool)
    for kind in bodies.kinds:
        offset = np.abs(actual[kind.particles] - expected[kind.particles])
        different[kind.bodies] = ~(offset.max(axis=(1, 2)) <= _SAME)
    return np.flatnonzero(different)
