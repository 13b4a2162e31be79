"""ExactRigidBodyIntegrator: OpenMM computes the forces, splitting and rotation are ours."""

from __future__ import annotations

import gc
import time
import weakref
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.bodies import BodyState, RigidBodies, find_bodies
from openmm_exactrb.propagate import compose
from openmm_exactrb.rotors import ROTORS, Flow, rotor
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.schemes import scheme as look_up

Array = NDArray[np.float64]

# Positions (nm) and velocities (nm/ps) closer than this to those of the stored bodies are theirs: an integrator that
# finds its Context changed by less goes on from the full float64 state.
_SAME = 1e-9
# Per-DOF variables, on the first particle of each body, in which the state travels in checkpoints and States.
_STORED = ("exactrb_R", "exactrb_P", "exactrb_m", "exactrb_q", "exactrb_w")
# Forces that change positions or velocities between steps.
_CHANGING = (
    "AndersenThermostat",
    "CMMotionRemover",
    "MonteCarloAnisotropicBarostat",
    "MonteCarloBarostat",
    "MonteCarloFlexibleBarostat",
    "MonteCarloMembraneBarostat",
)


class NonFiniteError(ArithmeticError):
    """A force or momentum is not finite; the Context keeps the state after the last good step."""


@dataclass
class Timings:
    """Wall time in seconds, and force evaluations, since the integrator was made.

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


@dataclass
class _Binding:
    """What belongs to one Context."""

    context: weakref.ref[openmm.Context]
    bodies: RigidBodies
    flow: Flow
    changing: bool
    x: Array  # positions handed to OpenMM, its virtual sites do not matter
    v: Array
    seen: tuple[Array, Array] | None = None  # positions and velocities in the Context after our last step
    state: BodyState | None = None
    force: tuple[Array, Array] | None = field(default=None)  # of the present positions


class ExactRigidBodyIntegrator(openmm.CustomIntegrator):
    """Rigid-body dynamics with the exact free rotation and a symmetric splitting.

    Rigid bodies are the clusters of particles that constraints of the System hold rigid; particles without constraints
    move beside them. After every step(n) the Context holds the positions, velocities, time and step count of the
    bodies; what is set in the Context between calls is taken up.

    Parameters
    ----------
    stepSize : float or Quantity
        Size of a whole step of the scheme, in ps if it has no unit.
    scheme : str or Scheme, optional
        A key of `openmm_exactrb.SCHEMES`.
    rotor : str, optional
        A key of `openmm_exactrb.ROTORS`.

    Raises
    ------
    ValueError
        If scheme or rotor is unknown, or the step size is not a finite time.

    Attributes
    ----------
    timings : Timings
    """

    def __init__(
        self, stepSize: float | unit.Quantity, scheme: str | Scheme = "SRKN4_6b", rotor: str = "exact"
    ) -> None:
        self._scheme = look_up(scheme)
        if rotor not in ROTORS:
            raise ValueError(f"unknown rotor {rotor!r}: choose one of {', '.join(ROTORS)}")
        self._rotor = rotor
        super().__init__(_picoseconds(stepSize))
        for name in _STORED:
            self.addPerDofVariable(name, 0.0)
        self.addGlobalVariable("exactrb_stored", 0.0)
        self.addUpdateContextState()
        self.timings = Timings()
        self._binding: _Binding | None = None
        self._advance = compose(self._scheme, self._drift, self._kick)

    # -- what a user asks for -----------------------------------------------------------------------------------

    def getScheme(self) -> Scheme:
        """Return the splitting scheme."""
        return self._scheme

    def getRotor(self) -> str:
        """Return the name of the free-rotor flow."""
        return self._rotor

    @property
    def forceEvaluationsPerStep(self) -> int:
        """Force evaluations that a step costs."""
        return self._scheme.stages

    def setStepSize(self, size: float | unit.Quantity) -> None:
        """Set the size of a whole step of the scheme, in ps if it has no unit."""
        super().setStepSize(_picoseconds(size))

    def bind(self, context: openmm.Context) -> None:
        """Tell the integrator its Context.

        Only needed where it cannot be found: `step` looks for the Context that was made with this integrator.

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
            raise ValueError(
                "this Context was made with another integrator: bind the one that it was made with"
            )
        x, _ = _positions_and_velocities(context)
        bodies = find_bodies(context.getSystem(), x)
        changing = {type(force).__name__ for force in context.getSystem().getForces()} & set(_CHANGING)
        self._binding = _Binding(
            weakref.ref(context),
            bodies,
            rotor(self._rotor, bodies.inertia if len(bodies.inertia) > 1 else bodies.inertia[0]),
            bool(changing),
            np.zeros((bodies.n_particles, 3)),
            np.zeros((bodies.n_particles, 3)),
        )

    def step(self, steps: int) -> None:
        """Advance the bodies by this many steps.

        Parameters
        ----------
        steps : int

        Raises
        ------
        ValueError
            If there is no Context yet, the System has no rigid bodies, or positions are not finite or not rigid.
        NonFiniteError
            If a force or momentum becomes infinite or nan. The Context then holds the state after the last good step.
        """
        start = time.perf_counter()
        binding = self._bound()
        context = binding.context()
        h = self.getStepSize().value_in_unit(unit.picosecond)
        self._take_up(binding, context)
        done = 0
        try:
            for _ in range(steps):
                binding.state = self._one_step(binding, h)
                done += 1
                if binding.changing:
                    self._publish(binding, context)
                    super().step(1)
                    self._take_up(binding, context)
        finally:
            if not binding.changing and done:
                super().step(done)
            self._publish(binding, context)
            self.timings.total += time.perf_counter() - start

    def kineticEnergies(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and the rotational kinetic energy of the bodies, as Quantities in kJ/mol."""
        binding = self._bound()
        self._take_up(binding, binding.context())
        translational, rotational = binding.bodies.kinetic_energies(binding.state)
        return translational * unit.kilojoule_per_mole, rotational * unit.kilojoule_per_mole

    def bodyState(self) -> tuple[RigidBodies, BodyState]:
        """Return the bodies and copies of their positions, attitudes and momenta in float64."""
        binding = self._bound()
        self._take_up(binding, binding.context())
        return binding.bodies, BodyState(*(a.copy() for a in binding.state))

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle the settings; a copy has no Context."""
        return type(self), (self.getStepSize().value_in_unit(unit.picosecond), self._scheme, self._rotor)

    def __copy__(self) -> ExactRigidBodyIntegrator:
        """Return an integrator with the same settings and no Context."""
        factory, arguments = self.__reduce__()
        return factory(*arguments)

    def __deepcopy__(self, memo: dict[int, Any]) -> ExactRigidBodyIntegrator:
        """Return an integrator with the same settings and no Context."""
        return self.__copy__()

    # -- the two flows ------------------------------------------------------------------------------------------

    def _drift(self, state: BodyState, tau: float) -> BodyState:
        binding = self._binding
        start = time.perf_counter()
        q, m = binding.flow(state.q, state.m, np.float64(tau))
        self.timings.rotor += time.perf_counter() - start
        binding.force = None
        return BodyState(state.R + tau * state.P / binding.bodies.mass, state.P, q, m)

    def _kick(self, state: BodyState, tau: float) -> BodyState:
        force, torque = self._force(state)
        return state._replace(P=state.P + tau * force, m=state.m + tau * torque)

    def _force(self, state: BodyState) -> tuple[Array, Array]:
        """Return forces and torques on the bodies, once for each set of positions."""
        binding = self._binding
        if binding.force is None:
            x = binding.bodies.positions(state, binding.x)
            context = binding.context()
            start = time.perf_counter()
            context.setPositions(x)
            context.computeVirtualSites()
            forces = context.getState(forces=True, groups=self.getIntegrationForceGroups()).getForces(
                asNumpy=True
            )
            self.timings.forces += time.perf_counter() - start
            self.timings.evaluations += 1
            binding.force = binding.bodies.forces(state.q, forces._value)
        return binding.force

    def _one_step(self, binding: _Binding, h: float) -> BodyState:
        with np.errstate(all="ignore"):  # what is not finite is reported below, with the bodies concerned
            state = self._advance(binding.state, h)
        if not np.isfinite(state.P.sum() + state.m.sum()):
            self._report(binding, binding.state, state, h)
        return state

    def _report(self, binding: _Binding, before: BodyState, after: BodyState, h: float) -> None:
        """Raise the error of a step that did not end well."""
        binding.force = None
        bad = np.flatnonzero(~after.finite())
        step = binding.context().getStepCount() + 1
        names = "; ".join(binding.bodies.name(int(b)) for b in bad[:3]) + ("; ..." if len(bad) > 3 else "")
        raise NonFiniteError(
            f"step {step}: forces or momenta of {len(bad)} bodies are not finite: {names}. The Context keeps the state "
            "before this step: take a smaller step size, or minimise the energy if bodies overlap"
        )

    # -- the Context --------------------------------------------------------------------------------------------

    def _bound(self) -> _Binding:
        if self._binding is None or self._binding.context() is None:
            self.bind(self._find_context())
        return self._binding

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

    def _take_up(self, binding: _Binding, context: openmm.Context) -> None:
        """Bring the body state up to date with what was set in the Context since our last step."""
        x, v = _positions_and_velocities(context)
        if binding.seen is not None and all(map(np.array_equal, binding.seen, (x, v))):
            return
        binding.seen, binding.force = (x, v), None
        stored = self._stored(binding)
        if stored is None:
            binding.state = binding.bodies.fit(x, v)
            return
        moved = _differs(binding.bodies, x, binding.bodies.positions(stored, binding.x))
        pushed = _differs(binding.bodies, v, binding.bodies.velocities(stored, binding.v))
        binding.state = stored
        if moved.any() or pushed.any():
            fitted = binding.bodies.fit(x, v, stored, moved)
            changed = moved | pushed
            turning = changed[: binding.bodies.n_turning]
            binding.state = fitted._replace(
                P=np.where(changed, fitted.P, stored.P), m=np.where(turning, fitted.m, stored.m)
            )

    def _publish(self, binding: _Binding, context: openmm.Context) -> None:
        """Write the body state into the Context, as particles and in full."""
        state, bodies = binding.state, binding.bodies
        context.setPositions(bodies.positions(state, binding.x))
        context.setVelocities(bodies.velocities(state, binding.v))
        context.computeVirtualSites()
        k = bodies.n_turning
        full = np.zeros((len(_STORED), bodies.n_particles, 3))
        full[0, bodies.first_particle] = state.R.T
        full[1, bodies.first_particle] = state.P.T
        full[2, bodies.first_particle[:k]] = state.m.T
        full[3, bodies.first_particle[:k]] = state.q[1:].T
        full[4, bodies.first_particle[:k], 0] = state.q[0]
        for name, values in zip(_STORED, full, strict=True):
            self.setPerDofVariableByName(name, values)
        self.setGlobalVariableByName("exactrb_stored", 1.0)
        binding.seen = _positions_and_velocities(context)

    def _stored(self, binding: _Binding) -> BodyState | None:
        """Read the body state that the Context carries, also through checkpoints and States."""
        if not self.getGlobalVariableByName("exactrb_stored"):
            return None
        k, first = binding.bodies.n_turning, binding.bodies.first_particle
        R, P, m, vector, w = (
            np.ascontiguousarray(np.array(self.getPerDofVariableByName(name), dtype=np.float64)[first].T)
            for name in _STORED
        )
        return BodyState(R, P, np.vstack([w[:1, :k], vector[:, :k]]), np.ascontiguousarray(m[:, :k]))


def _picoseconds(size: float | unit.Quantity) -> float:
    """Return a step size in ps."""
    if unit.is_quantity(size):
        if not size.unit.is_compatible(unit.picosecond):
            raise ValueError(f"the step size {size} is not a time: give it in ps, or as a Quantity of time")
        size = size.value_in_unit(unit.picosecond)
    if not isinstance(size, (int, float, np.number)) or not np.isfinite(size):
        raise ValueError(f"the step size must be a finite number of ps, not {size!r}")
    return float(size)


def _positions_and_velocities(context: openmm.Context) -> tuple[Array, Array]:
    state = context.getState(positions=True, velocities=True)
    return state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value


def _differs(bodies: RigidBodies, actual: Array, expected: Array) -> NDArray[np.bool_]:
    """Tell which bodies have a particle that is not where it is expected, (N,); nan differs."""
    different = np.zeros(len(bodies), dtype=bool)
    for kind in bodies.kinds:
        offset = np.abs(actual[kind.particles] - expected[kind.particles])
        different[kind.bodies] = ~(offset.max(axis=(1, 2)) <= _SAME)
    return different
