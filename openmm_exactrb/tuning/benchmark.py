"""The compared methods, and their runs from several initial states, which measure energies and times."""

from __future__ import annotations

import copy
import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.context.timings import Timings
from openmm_exactrb.errors import IntegrationError
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.integrators.states import loadState
from openmm_exactrb.library.library import missing
from openmm_exactrb.schemes import CATALOGUE, Scheme
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.tuning.budget import Budget
from openmm_exactrb.tuning.initial_state import InitialState, others
from openmm_exactrb.tuning.preparation import characteristics, diverging

#: Schemes that are tried by default: each is the cheapest at some accuracy on some system. If the budget does not allow
#: all of them, the first ones are tried.
CANDIDATES = (
    "W4_4",
    "W2_1",
    "S2_2",
    "W4_6",
    "SRKN4_6b",
    "W2_4",
    "W4_5",
    "V2",
    "SRKN6_11b",
    "W2_5",
    "S2_4",
    "SRKN6_14a",
)

#: Schemes that are tried with nested bonded forces by default, in order of preference.
NESTED_CANDIDATES = ("W2_1", "S2_2", "W4_4", "SRKN4_6b", "W2_4", "W4_5", "S2_3", "W2_5", "ABA_8_6_4")

#: Name of the baseline: OpenMM's leapfrog with constraints.
VERLET = "VerletIntegrator"

#: Suffix of the name of a scheme with nested bonded forces.
NESTED = " nested"

#: Number of starts from which a promised error is measured.
STARTS = 3

# Usual and smallest number of energies that a run records.
_SAMPLES, _FEWEST_SAMPLES = 300, 48
# Number of steps per call of the integrator in Simulation.step.
_CALL = 10
# Step, in characteristic times, of the run that measures the time of a force evaluation.
_BRIEF = 0.05
# A run is unstable once its total energy has changed by this fraction of the kinetic energy.
_LOST = 0.1


@dataclass(frozen=True)
class Method:
    """A scheme, with or without inner steps for bonded forces, or None for the baseline `VERLET`."""

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
        """Force evaluations per step, not counting those of inner steps."""
        return 1 if self.scheme is None else self.scheme.forces

    @property
    def evaluations(self) -> float:
        """Force evaluations per step within `Simulation.step`, including those for the output."""
        if self.scheme is None:
            return 1.0
        shown = self.scheme.with_inner_steps if self.nested else self.scheme
        looks = bool(self.scheme.processor) and missing() is not None  # at forces that may have changed, once a call
        return self.scheme.forces + max(shown.output_forces + looks, int(self.scheme.sequence[0][0].kicks)) / _CALL


def schemes_named(names: str | Scheme | Sequence[str | Scheme]) -> list[Scheme]:
    """Return the schemes that a user names, without repetitions; raise ValueError for unknown or ambiguous names."""
    schemes = [look_up(name) for name in ([names] if isinstance(names, (str, Scheme)) else names)]
    if not schemes:
        raise ValueError("schemes must contain at least one scheme: all names are in openmm_exactrb.SCHEMES")
    known: dict[str, Scheme] = {}
    for scheme in schemes:
        name = scheme.name
        if name.endswith(NESTED) or name == VERLET or known.setdefault(name, CATALOGUE.get(name, scheme)) != scheme:
            raise ValueError(
                f"a scheme in schemes= has the name of another method, {name!r}: choose another name for this scheme"
            )
    return list(known.values())


class RunEnergies(NamedTuple):
    """The total energies of a run, and its cost."""

    #: In kJ/mol per body, at equal intervals of time.
    values: NDArray[np.float64]
    #: Time between two energies in ps.
    interval: float
    #: Wall time in s per force evaluation.
    seconds: float
    #: Force evaluations of inner steps per evaluation of the other forces.
    nested: float


class SchemeUnderTest:
    """A scheme with the exact rotor, on the engine that a recommended integrator will use."""

    def __init__(self, start: InitialState, method: Method) -> None:
        options: dict[str, Any] = {"scheme": method.scheme, "fast": "bonded" if method.nested else None}
        make = functools.partial(ExactRigidBodyIntegrator, 1e-6, bodies=start.bodies, **options)
        self.integrator = make()
        self.context = start.context(self.integrator)
        if (engine := self.integrator.getEngine()) != "host":  # an engine chosen by name is kept when the step changes
            own = copy.deepcopy(start.system)  # an engine may add forces to this copy
            self.integrator = make(engine=engine)
            self.context = replace(start, system=own).context(self.integrator)
        self.timings = self.integrator.timings

    def begin(self, h: float, start: InitialState) -> None:
        """Set the initial state, and the step size in ps."""
        self.integrator.setStepSize(h)
        loadState(self.context, start.state)
        self.timings.reset()

    def energy(self) -> float:
        """Return the total energy in kJ/mol, with the kinetic energy computed in float64."""
        return float(self.integrator.totalEnergy()._value)

    def step(self, steps: int) -> None:
        """Perform the given number of steps."""
        self.integrator.step(steps)


class VerletUnderTest(SchemeUnderTest):
    """OpenMM's leapfrog, which interprets the initial velocities as velocities half a step earlier."""

    def __init__(self, start: InitialState) -> None:
        self.integrator, self.timings, self._groups = openmm.VerletIntegrator(1e-6), Timings(), start.groups
        self.integrator.setConstraintTolerance(1e-10)
        self.context = start.context(self.integrator)

    def energy(self) -> float:
        """Return the total energy in kJ/mol, with the kinetic energy at the time of the positions."""
        now = self.context.getState(energy=True, groups=self._groups)
        return float((now.getPotentialEnergy() + now.getKineticEnergy())._value)

    def step(self, steps: int) -> None:
        """Perform the given number of steps, and wait for platforms that compute asynchronously."""
        begun = time.perf_counter()
        self.integrator.step(steps)
        self.context.getState(positions=True)
        self.timings.total += time.perf_counter() - begun
        self.timings.evaluations += steps


class Benchmark:
    """Runs of methods on a System that conserves its energy, from several initial states and within a budget."""

    def __init__(self, state: InitialState, budget: Budget, seed: int = 0) -> None:
        integrator, context = state.probe()
        #: Characteristics of the initial state.
        self.characteristics = characteristics(integrator, context)
        now = context.getState(positions=True, forces=True, groups=state.groups)
        if not now.getForces(asNumpy=True)._value.any():
            raise ValueError("no force acts, so there is no energy error to measure: add forces to the System")
        bodies, bodies_state = integrator.bodyState()
        context.setPositions(bodies.positions(bodies_state, now.getPositions(asNumpy=True)._value))
        context.computeVirtualSites()
        #: The initial state, with molecules that are rigid and not split by the periodic box.
        self.state = state.updated(context)
        self.budget, self._seed = budget, seed
        #: Processor time in s of a force evaluation in the last run; 0 before the first run.
        self.processor = 0.0
        self._under_test: dict[str, SchemeUnderTest] = {}

    @functools.cached_property
    def starts(self) -> list[InitialState]:
        """The initial state, and other states at its temperature."""
        self.budget.require()
        return others(self.state, STARTS, self._seed)

    @property
    def has_baseline(self) -> bool:
        """Whether constraints define all bodies, so that OpenMM's VerletIntegrator moves the same bodies."""
        return self.state.bodies is None and self.state.system.getNumConstraints() > 0

    @functools.cached_property
    def nests(self) -> bool:
        """Whether the System contains both bonded forces that can have inner steps and other forces."""
        integrator, _context = self.state.probe(fast="bonded")
        try:
            integrator.bodyState()
        except ValueError:
            return False
        return True

    def evaluations_left(self) -> float:
        """Return the number of force evaluations that the rest of the budget allows, estimated from short runs."""
        step = _BRIEF * self.characteristics.time
        for _ in range(2):  # the first run compiles kernels
            self.run(Method(CATALOGUE["V2"]), step, _FEWEST_SAMPLES * step, self.state)
        return self.budget.left / self.processor

    def under_test(self, method: Method) -> SchemeUnderTest:
        """Return the object that runs a method."""
        if method.name not in self._under_test:
            made = VerletUnderTest(self.state) if method.scheme is None else SchemeUnderTest(self.state, method)
            self._under_test[method.name] = made
        return self._under_test[method.name]

    def run(self, method: Method, step: float, duration: float, start: InitialState) -> RunEnergies | None:
        """Run a method for a duration, both in ps.

        Return None if the run diverges, the energy changes by a tenth of the kinetic energy or more, or OpenMM's
        integrator fails. BudgetSpentError is raised before or during a run that the budget does not allow.
        """
        self.budget.require(self.processor * method.stages * duration / step)
        tested, begun = self.under_test(method), time.process_time()
        try:
            with np.errstate(all="ignore"), diverging():
                return self._energies(tested, step, duration, start)
        except IntegrationError:
            return None
        except openmm.OpenMMException:
            if method.scheme is not None:
                raise
            return None
        finally:
            if tested.timings.evaluations >= _FEWEST_SAMPLES:  # fewer would measure mainly the cost of starting a run
                self.processor = (time.process_time() - begun) / tested.timings.evaluations

    def _energies(
        self, tested: SchemeUnderTest, step: float, duration: float, start: InitialState
    ) -> RunEnergies | None:
        n_bodies, kinetic, *_ = self.characteristics
        every = max(1, round(duration / _SAMPLES / step))
        values: list[float] = []
        tested.begin(step, start)
        first = tested.energy() / n_bodies
        while len(values) < max(_FEWEST_SAMPLES, math.ceil(duration / (every * step))):
            self.budget.require()
            tested.step(every)
            values.append(tested.energy() / n_bodies)
            if not abs(values[-1] - first) < _LOST * kinetic:
                return None
        timings = tested.timings
        seconds, nested = timings.total / timings.evaluations, timings.fast_evaluations / timings.evaluations
        return RunEnergies(np.array(values), every * step, seconds, nested)
