"""The ExactRigidBodyIntegrator, which performs the splitting and the rotations with forces from OpenMM."""

from __future__ import annotations

import copy
import operator
import threading
import time
import weakref
from collections.abc import Sequence
from typing import Any

import openmm
from openmm import unit

from openmm_exactrb.context.minimiser import check, prepare
from openmm_exactrb.context.own_methods import give_to, replace_in_openmm
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.context.updates import warn_of_removed_motion
from openmm_exactrb.engines.engine import Propagator, Settings
from openmm_exactrb.engines.selection import Selection
from openmm_exactrb.integrators.bath_access import BathAccess
from openmm_exactrb.integrators.copies import SETTINGS, Copied, copied_by_openmm
from openmm_exactrb.integrators.parts import held_by_openmm, know
from openmm_exactrb.integrators.step_sizes import described, step_size, steps_for, warn_of_barostats
from openmm_exactrb.library.library import library, of_library
from openmm_exactrb.mechanics.free_motion import Constrain
from openmm_exactrb.multiple_time_steps.fast_forces import MultipleTimeSteps
from openmm_exactrb.openmm_access.closed_program import OwnProgram
from openmm_exactrb.openmm_access.find_context import NO_CONTEXT, find_context
from openmm_exactrb.openmm_access.units import check_first_arguments, picoseconds
from openmm_exactrb.rotors import ROTORS, Rotor
from openmm_exactrb.rotors import look_up as look_up_rotor
from openmm_exactrb.schemes import Scheme, splitting
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.support import checks
from openmm_exactrb.thermostats.thermostat import Noise, Thermostat, valid_seed


class ExactRigidBodyIntegrator(Copied, OwnProgram, BathAccess, openmm.CustomIntegrator):
    """Rigid-body dynamics with the exact free rotation and a symmetric splitting.

    Rigid bodies are the clusters of particles that the constraints of the System make rigid. Particles without
    constraints, and clusters that constraints do not make rigid, are integrated as well. After every call of
    ``step(n)``, the Context contains the new positions, velocities, time and step count. Changes made to the Context
    between calls are taken into account. On the host, a scheme that begins and ends with a kick evaluates the forces
    again at the start of each call, and so does a processed scheme if the package's library is missing. Within a call,
    no force is evaluated twice at the same positions.

    Parameters
    ----------
    stepSize : float or Quantity, optional
        Step size of the scheme, in ps if given without a unit. Pass either ``stepSize`` or ``forceInterval``.
    scheme : str or Scheme, optional
        A key of `openmm_exactrb.SCHEMES`, or a scheme of your own. The default, which evaluates forces once per step as
        VerletIntegrator does, is "W2_1", a processed Verlet scheme, or "BAOA" with a thermostat. Nosé-Hoover chains use
        "BAOAB" by default, and hybrid Monte Carlo uses "S2_2".
    rotor : str or Rotor, optional
        A key of `openmm_exactrb.ROTORS`, or an `openmm_exactrb.rotors.Rotor` of your own.
    bodies : sequence of sequences of int, optional
        Particles of each rigid body, in addition to the bodies that constraints define. The positions at the first step
        define the shapes. Forces within these bodies only add a constant to the energy.
    fast : {"auto", "bonded"} or sequence of int, optional
        Forces that are integrated with inner steps within the drifts. "bonded" selects bonds, angles, torsions and
        pairs three bonds apart; a sequence selects force groups by number. The other forces, which usually determine
        the cost, are evaluated as often as without inner steps. "auto" selects bonded forces if the time between force
        evaluations exceeds a sixteenth of the shortest vibrational period. None means no inner steps.
    inner : str or Scheme, optional
        Scheme of the inner steps; by default S2_2, or SRKN4_6b if the scheme has an order above 2 or force gradients.
        In schemes that contain a heat exchange, it is S2_2 with kicks of 0.198 instead of 0.193, or S2_4 if drifts
        have unequal lengths.
    innerSteps : int, optional
        Number of inner steps per step, at least one for each drift. The default gives at least 16 evaluations of bonded
        forces per shortest vibrational period, 64 with SRKN4_6b, and in schemes that contain a heat exchange 8.4, or
        7.5 with S2_4.
    engine : {"auto", "host", "native"}, optional
        What performs the steps. "host" means Python on the CPU. "native" means kernels on the device of the
        Platform (CUDA, HIP or OpenCL) or, for Reference and CPU, in the package's C++ library (see "On a GPU" in the
        documentation). "auto" means "native" if the library is available, the engine supports the System and the
        settings, and the platform is Reference, CPU or a single GPU; otherwise "host" (see `engineNote`).
    thermostat : Thermostat, optional
        A thermostat of `openmm_exactrb.thermostats` or your own. With a thermostat, the scheme may also be a key of
        `openmm_exactrb.schemes.WITH_THERMOSTAT`. None means constant energy.
    forceInterval : float or Quantity, optional
        Mean time between two force evaluations, in ps if given without a unit, instead of ``stepSize``. The step size
        is this interval times `forceEvaluationsPerStep`, so that schemes with equal intervals cost about the same.
    checkDivergence : bool, optional
        Whether to raise an error if the total energy jumps. Pass False if your own forces or substeps do work, as in
        active matter. The total energy is also not checked if the System has a PythonForce from outside this package or
        a force of a plugin, because these forces may do work. Non-finite numbers always raise an error.
    constraints : sequence of callable, optional
        Types of constraints in addition to the distances of the System, with the host engine only: functions of the
        free motion and the bodies that return the constrained free motion (see "A constraint type" in the
        documentation).

    Raises
    ------
    ValueError
        If an argument is invalid, or not supported by the requested engine.

    Attributes
    ----------
    timings : Timings
    """

    def __init__(
        self,
        stepSize: float | unit.Quantity | None = None,
        scheme: str | Scheme | None = None,
        rotor: str | Rotor = "exact",
        bodies: Sequence[Sequence[int]] | None = None,
        fast: str | Sequence[int] | None = "auto",
        inner: str | Scheme | None = None,
        innerSteps: int | None = None,
        engine: str = "auto",
        thermostat: Thermostat | None = None,
        *,
        forceInterval: float | unit.Quantity | None = None,
        checkDivergence: bool = True,
        constraints: Sequence[Constrain] = (),
    ) -> None:
        of_subclass = frozenset(vars(self))
        check_first_arguments(stepSize, scheme)
        if thermostat is not None and not isinstance(thermostat, Thermostat):
            raise ValueError(
                f"thermostat must be a Thermostat such as Langevin(300, 1), not {type(thermostat).__name__}"
            )
        self._fast = MultipleTimeSteps.of(fast, inner, innerSteps)
        self._thermostat = thermostat
        if thermostat is not None:
            thermostat.require_inner(None if self._fast is None else self._fast.scheme)
        if scheme is None:
            scheme = DEFAULT if thermostat is None else thermostat.scheme
        self._scheme = look_up(scheme) if thermostat is None else splitting(scheme)
        self._rotor = look_up_rotor(rotor)
        self._check = checks.switch(checkDivergence, "checkDivergence")
        self._bodies = None if bodies is None else checks.lists_of_indices(bodies, "bodies")
        self._constraints = checks.functions(constraints, "constraints")
        self._h = step_size(stepSize, forceInterval, self._proposal)
        super().__init__(self._h)
        self._noise, self._version, self._groups = Noise(), 0, -1
        self._selection = Selection(engine, self._settings())
        self._selection.declare(self, self._settings())
        self.timings = Timings()
        self._context: weakref.ref[Any] | None = None
        self._propagator: Propagator | None = None
        self._at_work = threading.Lock()  # held while `step` runs
        self._minimised = False  # by OpenMM's minimiser since the last call
        self._is_part = False  # of a CompoundIntegrator
        self._made = True
        self._complete(of_subclass)
        if of_library(self):
            know(self)
        else:
            replace_in_openmm(ExactRigidBodyIntegrator)

    # -- settings -------------------------------------------------------------------------------------------------

    def getScheme(self) -> Scheme:
        """Return the splitting scheme."""
        return self._scheme

    def getRotor(self) -> str:
        """Return the name of the free-rotor flow."""
        return self._rotor.name

    def getThermostat(self) -> Thermostat | None:
        """Return the thermostat, or None at constant energy."""
        thermostat: Thermostat | None = self._thermostat
        return thermostat

    def getNamedBodies(self) -> list[list[int]] | None:
        """Return the particles of each body that was passed as `bodies`, or None."""
        return copy.deepcopy(self._bodies)

    def getMultipleTimeSteps(self) -> MultipleTimeSteps | None:
        """Return the settings of inner steps, or None if ``fast=None``."""
        return self._fast

    @property
    def checkDivergence(self) -> bool:
        """Whether a jump of the total energy raises an error."""
        return self._check

    @checkDivergence.setter
    def checkDivergence(self, check: bool) -> None:
        self._check = checks.switch(check, "checkDivergence")
        self._changed()

    @property
    def forceEvaluationsPerStep(self) -> int:
        """Number of force evaluations per step, excluding those of fast forces.

        A processed scheme needs `Scheme.output_forces` additional force evaluations per call of `step`. With hybrid
        Monte Carlo, a rejection, or a scheme that begins with a drift, needs one more.
        """
        return self._proposal.forces

    def stepsFor(self, time: float | unit.Quantity) -> int:
        """Return the smallest number of steps that take at least a time, in ps if given without a unit.

        Raises
        ------
        ValueError
            If the value is not a time of at least zero, or the step size is zero.
        """
        return steps_for(time, self._h)

    @property
    def _proposal(self) -> Scheme:
        """The scheme of a step or, for hybrid Monte Carlo, of a proposal."""
        return self._scheme if self._thermostat is None else self._thermostat.splitting(self._scheme)[0]

    def setStepSize(self, size: float | unit.Quantity) -> None:
        """Set the step size of the scheme, in ps if given without a unit.

        Raises
        ------
        ValueError
            If the value is not a time, or the requested engine does not support it.
        """
        before, self._h = self._h, picoseconds(size)
        super().setStepSize(self._h)
        self._changed()
        if self._propagator is not None and not self._propagator.sync.outdated:
            try:
                self._settle(self._propagator.sync.context)
            except ValueError:
                self._h = before
                super().setStepSize(before)
                raise

    def setIntegrationForceGroups(self, groups: int | set[int]) -> None:
        """Set the active force groups, as a set or a bit mask; raise ValueError for anything else."""
        super().setIntegrationForceGroups(checks.force_groups(groups))
        self._groups = openmm.CustomIntegrator.getIntegrationForceGroups(self)
        self._changed()

    def getIntegrationForceGroups(self) -> int:
        """Return the force groups that were set as active, as a bit mask."""
        return self._groups

    def setRandomNumberSeed(self, seed: int) -> None:
        """Set the seed of the noise; with 0, the next step draws a seed, which is then kept.

        Raises
        ------
        ValueError
            If the seed is not a whole number from 0 to 2^31 - 1.
        """
        super().setRandomNumberSeed(valid_seed(checks.whole(seed, "the seed", 0)))
        self._noise.set(self, seed)

    def getSeedInUse(self) -> int:
        """Return the seed in use, which was set, read from a checkpoint, or drawn.

        The result is 0 before a seed is drawn. ``getRandomNumberSeed`` returns the seed that was set.
        """
        return self._noise.in_use(self)

    def getEngine(self) -> str:
        """Return the name of the engine that performs the steps, which with engine="auto" depends on the Context."""
        if self._selection.open and self._unsettled():
            self._settle(self._found())
        return self._selection.engine.name

    def engineNote(self) -> str:
        """Return the reason for the choice of the engine, and what a step is, as a sentence."""
        self.getEngine()
        return f"{self._selection.note}; {described(self._h, self.forceEvaluationsPerStep)}"

    # -- steps ------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        """Advance the bodies by this many steps.

        Parameters
        ----------
        steps : int

        Raises
        ------
        ValueError
            If the number of steps is negative or not whole, there is no Context yet, nothing can move, a barostat would
            tear bodies apart, or positions are not finite or do not fit the bodies. The state is then unchanged.
        RuntimeError
            If this integrator is already performing a step in another thread.
        IntegrationError
            If the state becomes non-finite (NonFiniteError) or the total energy jumps. After this or any other error,
            the Context contains the state after the last valid step or, with a processed scheme on the host, the state
            before this call. After an error of OpenMM with the native engine, the state may be up to 1000 steps older.
        """
        count = steps if type(steps) is int and steps >= 0 else checks.whole(steps, "the number of steps", least=0)
        self._begin_work()
        start = time.perf_counter()
        try:
            propagator = self._present()
            thermostat = self._thermostat
            temperature = thermostat.temperature if thermostat is not None and thermostat.acts else None
            propagator.updates.settle(propagator.sync.context, temperature)
            key = 0 if thermostat is None else self._noise.key(self, count)
            propagator.advance(self._version, self._settings, key, count)
        finally:
            self.timings.total += time.perf_counter() - start
            self._at_work.release()

    def _begin_work(self) -> None:
        """Reserve the integrator; raise RuntimeError if a step is in progress, because the state is then incomplete."""
        if not self._at_work.acquire(blocking=False):
            raise RuntimeError(
                "this integrator is already performing a step, in another thread or from a force that calls it: wait "
                "until step() has returned, and give each thread its own integrator and Context"
            )

    def _settings(self) -> Settings:
        thermostat, steps, splitting, splits = self._thermostat, self._scheme, self._scheme, 1
        if thermostat is not None:
            steps, (splitting, splits) = thermostat.steps(self._scheme), thermostat.splitting(self._scheme)
        parts = steps, self._scheme, splitting, splits, self._h, self._groups
        return Settings(*parts, self._rotor, self._fast, thermostat, self._bodies, self._check, self._constraints)

    def _changed(self) -> None:
        self._version += 1  # substeps are bound again before the next step
        self._describe()

    def getSettings(self) -> dict[str, dict[str, Any]]:
        """Return all settings of this integrator, which are its arguments and the values set by OpenMM's setters."""
        rotor = self._rotor.name if ROTORS.get(self._rotor.name) is self._rotor else self._rotor
        arguments = {"stepSize": self._h, "scheme": self._scheme, "rotor": rotor, "bodies": self._bodies}
        settings = {name: getattr(self, f"get{name}")() for name in SETTINGS}
        return {"arguments": arguments | self._arguments(), "settings": settings}

    def __repr__(self) -> str:
        """Return the type, the scheme, the rotor and what a step is."""
        step = described(self._h, self.forceEvaluationsPerStep)
        return f"{type(self).__name__}(scheme={self._scheme.name!r}, rotor={self._rotor.name!r}; {step})"

    def _arguments(self) -> dict[str, Any]:
        """Return the arguments that a copy needs in addition to the common arguments."""
        others = {"engine": self._selection.asked, "thermostat": self._thermostat, "checkDivergence": self._check}
        return others | MultipleTimeSteps.arguments(self._fast) | {"constraints": self._constraints}

    def _up_to_date(self) -> Propagator:
        """Return the propagator of the present Context, updated with the user's changes."""
        self._begin_work()
        self._at_work.release()
        propagator = self._present()
        propagator.sync.pull()
        return propagator

    def _unsettled(self) -> bool:
        """Return whether the Context is unknown, was reinitialised, or has the state of another engine."""
        propagator = self._propagator
        return propagator is None or propagator.sync.outdated or self.getGlobalVariable(0) not in self._selection.marks

    def _settle(self, context: Any, settings: Settings | None = None) -> None:
        """Choose the engine for a Context, and create a propagator if the engine changes."""
        before = self._selection.engine
        self._selection.settle(context, self, settings or self._settings())
        if self._selection.engine is not before:
            self._propagator = None

    def _enter(self, context: openmm.Context) -> None:
        """Belong to a Context that is being created."""
        self._context, self._propagator, self._is_part = weakref.ref(context), None, not self.thisown
        give_to(context, ExactRigidBodyIntegrator)

    def _agree(self) -> None:
        """Adopt the step size and the active force groups that C++ has set, such as those of a CompoundIntegrator."""
        if (size := openmm.CustomIntegrator.getStepSize(self)._value) != self._h:
            self.setStepSize(size)
        if (groups := openmm.CustomIntegrator.getIntegrationForceGroups(self)) != self._groups:
            self.setIntegrationForceGroups(groups)

    def _expect_minimisation(self, context: openmm.Context | None = None) -> None:
        """Prepare the Context for OpenMM's minimiser, whose result the next call checks."""
        prepare(context or self._found(), self._bodies)
        self._minimised = True

    def _found(self) -> Any:
        context = self._context and self._context()
        if context is None and of_library(self):
            raise ValueError(NO_CONTEXT)
        return context or find_context(self)

    def _present(self) -> Propagator:
        """Return the propagator of the present Context."""
        if self._is_part:
            library().notice(self)
        if self._minimised:
            check(self._found())
            self._minimised = False
        if self._propagator is None or self._unsettled():
            context, settings = self._found(), self._settings()
            settings.found(context)  # with the warnings that the choice of the engine does not repeat
            self._settle(context, settings)
            self._propagator = self._selection.engine.propagator(context, self, settings, self.timings)
            self._propagator.sync.new_trajectory = self._noise.parting(self)
            warn_of_removed_motion(context.getSystem())
            warn_of_barostats(context, self._h, self.forceEvaluationsPerStep)
        return self._propagator


_agree = operator.methodcaller("_agree")
held_by_openmm(
    copied_by_openmm(ExactRigidBodyIntegrator, _agree),
    lambda integrator, context: integrator._enter(context),  # noqa: SLF001
    _agree,
    operator.methodcaller("_expect_minimisation"),
)

#: The default scheme at constant energy.
DEFAULT = "W2_1"
