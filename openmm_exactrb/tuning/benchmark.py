"""The methods that are compared, and their benchmark: energy error and wall time of runs from one initial state."""

from __future__ import annotations

import contextlib
import copy
import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import openmm

from openmm_exactrb.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.divergence import IntegrationError
from openmm_exactrb.schemes import CATALOGUE, Scheme
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.tuning.error import expected_error
from openmm_exactrb.tuning.initial_state import LOST, InitialState, characteristics, diverging

#: Schemes that are tried by default: each is the cheapest at some accuracy on some system.
CANDIDATES = (
    "V2",
    "W2_1",
    "S2_2",
    "S2_4",
    "W2_4",
    "W2_5",
    "W4_4",
    "W4_5",
    "W4_6",
    "SRKN4_6b",
    "SRKN6_11b",
    "SRKN6_14a",
)

#: Schemes that are tried with nested bonded forces by default.
NESTED_CANDIDATES = ("W2_1", "S2_2", "S2_3", "W2_4", "W2_5", "W4_4", "W4_5", "SRKN4_6b", "ABA_8_6_4")

#: Name of the baseline: OpenMM's leapfrog with constraints.
VERLET = "VerletIntegrator"

#: End of the name of a scheme with nested bonded forces.
NESTED = " nested"

# Energies of a run, and the fewest.
_SAMPLES, _FEWEST_SAMPLES = 300, 48
# Steps of a call of the integrator by Simulation.step, and the fewest and most calls in which evaluations are counted.
_CALL, _FEWEST_CALLS, _MOST_CALLS = 10, 6, 30
# Rounds of timing through all methods, and force evaluations of each method in a round.
_ROUNDS, _EVALUATIONS = 7, 28


@dataclass(frozen=True)
class Method:
    """A scheme, plain or with the bonded forces nested in its drifts, or without a scheme the baseline `VERLET`."""

    scheme: Scheme | None = None
    nested: bool = False

    @property
    def name(self) -> str:
        """The name in tables and results."""
        return VERLET if self.scheme is None else self.scheme.name + NESTED * self.nested

    @property
    def order(self) -> int:
        """Order in the step size."""
        return 2 if self.scheme is None else self.scheme.order

    @property
    def stages(self) -> int:
        """Force evaluations per step, not counting those of nested forces."""
        return 1 if self.scheme is None else self.scheme.forces

    @property
    def own_scheme(self) -> Scheme | None:
        """The scheme if it is the user's own, that is, if its name does not say which one it is."""
        return None if self.scheme is None or CATALOGUE.get(self.scheme.name) == self.scheme else self.scheme


def schemes_named(names: str | Scheme | Sequence[str | Scheme]) -> list[Scheme]:
    """Return the schemes that a user names, without repetitions; ValueError for unknown or ambiguous names."""
    schemes = [look_up(name) for name in ([names] if isinstance(names, (str, Scheme)) else names)]
    if not schemes:
        raise ValueError(f"schemes is empty: name some of {', '.join(CATALOGUE)}")
    known: dict[str, Scheme] = {}
    for scheme in schemes:
        name = scheme.name
        if name.endswith(NESTED) or name == VERLET or known.setdefault(name, CATALOGUE.get(name, scheme)) != scheme:
            raise ValueError(f"a scheme of your own has the name {name!r} of another method: choose another name")
    return list(known.values())


class IntegratorUnderTest:
    """Runs one method from the initial state, again and again."""

    def __init__(self, state: InitialState, integrator: openmm.Integrator) -> None:
        self.state, self.integrator, self.context = state, integrator, state.context(integrator)

    @property
    def fast_share(self) -> float:
        """Evaluations of nested forces per evaluation of the others, since the last `begin`."""
        return 0.0

    def begin(self, h: float) -> None:
        """Return to the initial state, with a step in ps."""
        self.integrator.setStepSize(h)
        self.context.setPositions(self.state.positions)
        self.context.setVelocities(self.state.velocities)

    def energy(self) -> float:
        """Return the total energy in kJ/mol, with the kinetic energy at the time of the positions."""
        now = self.context.getState(energy=True, groups=self.state.groups)
        return float((now.getPotentialEnergy() + now.getKineticEnergy())._value)

    def evaluations_per_step(self, h: float) -> float:
        """Return the force evaluations of a step of h ps, called as `Simulation.step` does in the whole System."""
        return 1.0 + sum(2.0 / period for period in self.state.periods)  # a barostat compares two energies

    def seconds_per_evaluation(self, steps: int) -> float:
        """Make steps, and return their wall time per force evaluation."""
        begun = time.perf_counter()
        self.integrator.step(steps)
        self.context.getState(positions=True)  # waits for platforms that compute asynchronously
        return (time.perf_counter() - begun) / steps


class ExactRigidBody(IntegratorUnderTest):
    """A scheme with the exact rotor, on the engine that the integrator of a choice will have."""

    def __init__(self, state: InitialState, method: Method) -> None:
        options: dict[str, Any] = {"scheme": method.scheme, "fast": "bonded" if method.nested else None}
        make = functools.partial(ExactRigidBodyIntegrator, 1e-6, bodies=state.bodies, **options)
        super().__init__(state, make())
        if (engine := self.integrator.getEngine()) != "host":  # chosen by name, it is kept when the step changes
            own = copy.deepcopy(state.system)  # to which an engine may add forces
            super().__init__(replace(state, system=own), make(engine=engine))

    @property
    def fast_share(self) -> float:
        """See `IntegratorUnderTest`."""
        timings = self.integrator.timings
        return float(timings.fast_evaluations / max(1, timings.evaluations))

    def begin(self, h: float) -> None:
        """Return to the initial state, with a step in ps."""
        super().begin(h)
        self.integrator.timings.reset()

    def energy(self) -> float:
        """Return the total energy in kJ/mol, with the kinetic energy in float64."""
        return float(self.integrator.totalEnergy()._value)

    def evaluations_per_step(self, h: float) -> float:
        """Return the force evaluations of a step of h ps, called as `Simulation.step` does in the whole System.

        They are counted over periods of a barostat, unless these are very long.
        """
        self.begin(h)
        integrator = self.integrator
        if self.state.whole is not None:
            integrator = copy.copy(integrator)
            integrator.setRandomNumberSeed(1)  # barostats draw from it on Reference and CPU: the same count every time
            _context = replace(self.state, system=copy.deepcopy(self.state.whole)).context(integrator)
        period = math.lcm(_CALL, *self.state.periods) // _CALL
        calls = min(period * math.ceil(_FEWEST_CALLS / period), _MOST_CALLS)
        integrator.step(_CALL)  # with what a run pays once
        integrator.timings.reset()
        integrator.step(_CALL)
        counted = [integrator.timings.evaluations]
        with contextlib.suppress(IntegrationError):  # a step that is stable in the survey need not be for as long
            for _ in range(calls - 1):
                integrator.step(_CALL)
                counted.append(integrator.timings.evaluations)
        return float(counted[-1] / (len(counted) * _CALL))

    def seconds_per_evaluation(self, steps: int) -> float:
        """Make steps, and return their wall time per force evaluation."""
        self.integrator.timings.reset()
        self.integrator.step(steps)
        return float(self.integrator.timings.total / self.integrator.timings.evaluations)


class Verlet(IntegratorUnderTest):
    """OpenMM's leapfrog, whose velocities are half a step behind the positions."""

    def __init__(self, state: InitialState) -> None:
        super().__init__(state, openmm.VerletIntegrator(1e-6))
        self.integrator.setConstraintTolerance(1e-10)
        masses = [state.system.getParticleMass(i)._value for i in range(state.system.getNumParticles())]
        self._inverse_masses = np.array([[1.0 / m if m > 0.0 else 0.0] for m in masses])

    def begin(self, h: float) -> None:
        """Return to the initial positions, with the velocities half a step earlier."""
        super().begin(h)
        self.context.computeVirtualSites()
        forces = self.context.getState(forces=True, groups=self.state.groups).getForces(asNumpy=True)._value
        self.context.setVelocities(self.state.velocities - 0.5 * h * forces * self._inverse_masses)
        self.context.applyVelocityConstraints(1e-10)


class Benchmark:
    """Runs methods from one initial state of a System that conserves its energy."""

    def __init__(self, state: InitialState) -> None:
        integrator, context = state.probe()
        #: Of the initial state.
        self.characteristics = characteristics(integrator, context)
        bodies, bodies_state = integrator.bodyState()
        #: The initial state of all integrators: molecules are rigid, and not split by the periodic box.
        self.state = replace(state, positions=bodies.positions(bodies_state, state.positions.copy()))
        self._integrators: dict[str, IntegratorUnderTest] = {}

    @property
    def has_baseline(self) -> bool:
        """Whether constraints hold all bodies, so that OpenMM's Verlet integrator moves the same ones."""
        return self.state.bodies is None and self.state.system.getNumConstraints() > 0

    @functools.cached_property
    def nests(self) -> bool:
        """Whether there are bonded forces to be nested, and others."""
        integrator, _context = self.state.probe(fast="bonded")
        try:
            integrator.bodyState()
        except ValueError:
            return False
        return True

    def under_test(self, method: Method) -> IntegratorUnderTest:
        """Return the integrator under test of a method."""
        if method.name not in self._integrators:
            made = Verlet(self.state) if method.scheme is None else ExactRigidBody(self.state, method)
            self._integrators[method.name] = made
        return self._integrators[method.name]

    def error(self, method: Method, step: float, duration: float, horizon: float) -> float:
        """Run from the initial state for a duration, and return the energy error to expect over the horizon, all in ps.

        It is in kJ/mol per body, and infinite if the run diverges or changes the energy by a tenth of the kinetic one.
        """
        tested, (n_bodies, kinetic, *_) = self.under_test(method), self.characteristics
        every = max(1, round(duration / _SAMPLES / step))
        energies: list[float] = []
        try:
            with np.errstate(all="ignore"), diverging():
                tested.begin(step)
                first = tested.energy() / n_bodies
                while len(energies) < max(_FEWEST_SAMPLES, math.ceil(duration / (every * step))):
                    tested.integrator.step(every)
                    energies.append(tested.energy() / n_bodies)
                    if not abs(energies[-1] - first) < LOST * kinetic:
                        return math.inf
        except IntegrationError:
            return math.inf
        error = expected_error(np.array(energies), every * step, horizon)
        return error if error < LOST * kinetic else math.inf

    def seconds_per_evaluation(self, methods: Sequence[Method], interval: float) -> list[float]:
        """Return the wall times in s per force evaluation of methods at a time per force evaluation in ps.

        The fastest of some rounds counts, since other processes only add to the time.
        """
        rounds = []
        for _ in range(_ROUNDS):
            times = []
            for method in methods:
                tested = self.under_test(method)
                tested.begin(method.stages * interval)
                tested.integrator.step(1)
                times.append(tested.seconds_per_evaluation(max(2, round(_EVALUATIONS / method.stages))))
            rounds.append(times)
        return [float(t) for t in np.min(rounds, axis=0)]
