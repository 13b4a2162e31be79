"""ExactRigidBodyIntegrator: OpenMM computes the forces, splitting and rotation are ours."""

from __future__ import annotations

import copy
import math
import weakref
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb import checks
from openmm_exactrb.context import host
from openmm_exactrb.context.found import find_context
from openmm_exactrb.context.letters import LETTERS, Maker
from openmm_exactrb.context.nesting import Nesting
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.context.units import FORCE, gas_constant_times, picoseconds, plain, refuse_temperature
from openmm_exactrb.device.choice import Engine
from openmm_exactrb.device.chosen import Chosen
from openmm_exactrb.device.engine import Device, device
from openmm_exactrb.motion.bodies import RigidBodies
from openmm_exactrb.motion.momenta import canonical
from openmm_exactrb.motion.state import BodyState, State
from openmm_exactrb.rotors import ROTORS, Rotor
from openmm_exactrb.rotors import look_up as look_up_rotor
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.schemes import scheme as look_up
from openmm_exactrb.schemes.word import OPENMM

Array = NDArray[np.float64]


class ExactRigidBodyIntegrator(openmm.CustomIntegrator):
    """Rigid-body dynamics with the exact free rotation and a symmetric splitting.

    Rigid bodies are the clusters of particles that constraints of the System hold rigid. Beside them move particles
    without constraints, and clusters whose constraints leave them a motion of their own, along these to roundoff. After
    every step(n) the Context holds positions, velocities, time and step count; what is set in it between calls is taken
    up. A call evaluates the forces of its first positions anew; within a call no force is evaluated twice.

    Parameters
    ----------
    stepSize : float or Quantity
        Size of a whole step of the scheme, in ps if it has no unit.
    scheme : str or Scheme, optional
        A key of `openmm_exactrb.SCHEMES`, or a scheme of your own.
    rotor : str or Rotor, optional
        A key of `openmm_exactrb.ROTORS`, or an `openmm_exactrb.rotors.Rotor` of your own.
    bodies : sequence of sequences of int, optional
        Particles of rigid bodies beside those that constraints make. Their shape is that of the positions at the first
        step; what acts within them only adds a constant to the energy.
    fast : {"auto", "bonded"} or sequence of int, optional
        Forces with steps of their own within the drifts of the scheme: "bonded" ones, which are bonds, angles, torsions
        and pairs three bonds apart, or those of some force groups. A step then evaluates the others, which are what
        costs, as often as before. "auto": bonded ones, where a step has forces more rarely than each sixteenth of the
        shortest period of bonds and angles. None nests nothing.
    inner : str or Scheme, optional
        Scheme of the inner steps; if it is not given S2_2, or SRKN4_6b in schemes of higher order than 2 or with force
        gradients.
    innerSteps : int, optional
        Inner steps for the time of a step, at least one for each drift. If it is not given, a drift has an evaluation
        for each twentieth of the shortest period of nested bonds and angles, with SRKN4_6b each eightieth, or more.
    engine : {"auto", "host", "device"}, optional
        Who carries the steps out. "host": compiled kernels of this package. "device": a program of OpenMM's
        CustomIntegrator, on CUDA, HIP or OpenCL in mixed or double precision (docs: On a GPU). "auto": the device where
        it can be and a few steps show that the host is not much faster; `engineNote` says why.

    Raises
    ------
    ValueError
        If scheme, rotor or engine is unknown, the step size is not a finite time, bodies are not lists of particles,
        what is to be nested are no force groups, or scheme or rotor are not for the device that was asked for.

    Attributes
    ----------
    timings : Timings
    """

    _bath_in_steps: ClassVar[str | None] = None

    def __init__(
        self,
        stepSize: float | unit.Quantity,
        scheme: str | Scheme = "SRKN4_6b",
        rotor: str | Rotor = "exact",
        bodies: Sequence[Sequence[int]] | None = None,
        fast: str | Sequence[int] | None = "auto",
        inner: str | Scheme | None = None,
        innerSteps: int | None = None,
        engine: Engine = "auto",
    ) -> None:
        refuse_temperature(stepSize, scheme)
        self._nesting = Nesting.of(fast, inner, innerSteps)
        self._scheme = look_up(scheme)
        self._rotor = look_up_rotor(rotor)
        self._bodies = None if bodies is None else checks.lists_of_indices(bodies, "bodies")
        self._makers: dict[str, Maker] = dict(LETTERS)
        super().__init__(picoseconds(stepSize))
        self._engine = Chosen(engine, self._steps(), self._rotor, self._nesting, self._bath_in_steps)
        self._engine.declare(self)
        self.timings = Timings()
        self._context: weakref.ref[Any] | None = None
        self._host: host.Host | None = None

    # -- what a user asks for -----------------------------------------------------------------------------------

    def getScheme(self) -> Scheme:
        """Return the splitting scheme."""
        return self._scheme

    def getRotor(self) -> str:
        """Return the name of the free-rotor flow."""
        return self._rotor.name

    def hasNamedBodies(self) -> bool:
        """Tell whether there are bodies beside those that constraints make."""
        return self._bodies is not None

    def getNamedBodies(self) -> list[list[int]] | None:
        """Return the particles of the bodies beside those that constraints make, as they were handed over."""
        return copy.deepcopy(self._bodies)

    def getNesting(self) -> Nesting | None:
        """Return what is to have steps of its own within the drifts, or None."""
        return self._nesting

    @property
    def forceEvaluationsPerStep(self) -> int:
        """Force evaluations that a step costs; a processed scheme needs `Scheme.processing` more a call of `step`.

        Those of nested forces are not counted.
        """
        return self._scheme.forces

    def setStepSize(self, size: float | unit.Quantity) -> None:
        """Set the size of a whole step of the scheme, in ps if it has no unit.

        Raises
        ------
        ValueError
            If it is no time, or so long that forces would be nested, and the device was asked for, which does not nest.
        """
        before = self.getStepSize()
        super().setStepSize(picoseconds(size))
        if self._engine.open and self._engine.on_device:
            self._host = None  # longer steps may be the host's
        elif self._host is not None:
            try:
                self._engine.bear_steps(self._host.session.context, self)
            except ValueError:
                super().setStepSize(before)
                raise

    def setIntegrationForceGroups(self, groups: int | set[int]) -> None:
        """Set which force groups act, as a set or by their bits."""
        self._engine.act(self, groups if isinstance(groups, int) else sum(1 << group for group in groups))
        if isinstance(self._host, Device):
            self._host = None  # OpenMM reads the groups where it makes the kernels

    def getIntegrationForceGroups(self) -> int:
        """Return the bits of the force groups that act, as they were set."""
        return self._engine.groups

    def getEngine(self) -> str:
        """Return which engine makes the steps, "host" or "device"; with engine="auto" the Context decides."""
        if self._engine.open and self._unsettled():
            self._engine.settle(self._found(), self)
        return "device" if self._engine.on_device else "host"

    def preferEngine(self, engine: str) -> None:
        """With engine="auto": have the engine of a run that goes on, without a measurement, where the Context can."""
        self._engine.prefer(engine)

    def engineNote(self) -> str:
        """Say in a sentence why it is this engine."""
        self.getEngine()
        return self._engine.note

    def addLetter(self, letter: str, maker: Maker) -> None:
        """Tell what a letter of the scheme's word does.

        Parameters
        ----------
        letter : str
            The first character of the letters that it makes.
        maker : callable
            ``maker(parts, letters)`` returns a flow for each of the letters: ``flow(state, tau) -> state``, where the
            state is an `openmm_exactrb.motion.state.State` and `parts` an `openmm_exactrb.context.letters.Parts`.

        Raises
        ------
        ValueError
            If the letter is not one character, is one that the integrator makes itself whatever it is told, or is in
            the word of a scheme that the device was asked for.
        """
        if not isinstance(letter, str) or len(letter) != 1:
            raise ValueError(f"a letter is one character, such as 'F', not {letter!r}")
        if letter == OPENMM or letter in self._own_makers():
            raise ValueError(f"the letter {letter!r} is made by the integrator itself: choose another one")
        if any(name[0] == letter for name, _ in self._steps().word + self._steps().processor):
            self._engine.leave_to_host(f"the device cannot carry out the letter {letter!r} of your own")
            if isinstance(self._host, Device):
                self._host = None
        self._makers[letter] = maker

    def bind(self, context: openmm.Context) -> None:
        """Tell the integrator its Context.

        Only needed where `step` cannot find the Context that was made with this integrator. Positions may be set later.

        Parameters
        ----------
        context : openmm.Context
            Made with this integrator.

        Raises
        ------
        ValueError
            If it is no Context, or has another integrator.
        """
        if not isinstance(context, openmm.Context):
            raise ValueError(
                f"bind() takes an openmm.Context, such as simulation.context, not {type(context).__name__}"
            )
        if context.getIntegrator() is not self and getattr(context, "_integrator", None) is not self:
            raise ValueError("this Context was made with another integrator: bind the one that it was made with")
        self._context, self._host = weakref.ref(context), None

    def step(self, steps: int) -> None:
        """Advance the bodies by this many steps.

        Parameters
        ----------
        steps : int

        Raises
        ------
        ValueError
            If the number is not whole or negative, there is no Context yet, nothing in the System can move, a barostat
            would tear bodies, or positions are not finite or not rigid. The state stays what it was.
        NonFiniteError
            If numbers of a body become infinite, it is faster than light, or energy comes from nowhere. As after any
            other error the Context holds the last good step; on the device or with a processor, that before this call.
        """
        count = checks.whole(steps, "the number of steps", least=0)
        with self.timings.measuring():
            present = self._present()
            present.advance(self, self._plan(present.session.context), count)

    def kineticEnergies(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and the rotational kinetic energy of the bodies, as Quantities in kJ/mol."""
        session = self._up_to_date().session
        translational, rotational = session.bodies.kinetic_energies(session.state.rounded)
        return translational * unit.kilojoule_per_mole, rotational * unit.kilojoule_per_mole

    def totalEnergy(self) -> unit.Quantity:
        """Return the energy that a run should keep, in kJ/mol: kinetic, and potential of the force groups that act.

        The kinetic part is that of the bodies in float64, also where the platform's velocities are rounded.
        """
        context = self._up_to_date().session.context
        state = context.getState(energy=True, groups=self.getIntegrationForceGroups())
        return sum(self.kineticEnergies(), state.getPotentialEnergy())

    def degreesOfFreedom(self) -> tuple[int, int]:
        """Return the numbers of translational and of rotational degrees of freedom.

        A linear body has two rotational ones, a particle none. With a CMMotionRemover three translational are missing,
        whatever its interval is: between two removals nothing but a bath, or forces from outside, moves the centre of
        mass.
        """
        parts = self._up_to_date()
        bodies = parts.session.bodies
        return bodies.translational_freedom - 3 * parts.couplings.removes_motion, bodies.rotational_freedom

    def temperatures(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and the rotational temperature of the bodies; nan of what has no freedom."""
        pairs, R = zip(self.kineticEnergies(), self.degreesOfFreedom(), strict=True), unit.MOLAR_GAS_CONSTANT_R
        one, other = ((2.0 * energy / ((n or math.nan) * R)).in_units_of(unit.kelvin) for energy, n in pairs)
        return one, other

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
            If the temperature is negative, not finite or has a unit that does not fit, or the seed is no whole number.
        """
        seed = None if randomSeed is None else checks.whole(randomSeed, "randomSeed", least=0)
        parts, kT, rng = self._up_to_date(), gas_constant_times(temperature), np.random.default_rng(seed)
        bodies, state = parts.session.bodies, parts.session.state.rounded
        parts.session.replace(canonical(bodies, state, kT, rng, parts.couplings.removes_motion))

    def minimizeEnergy(self, tolerance: float | unit.Quantity = 10.0, maxIterations: int = 0) -> None:
        """Bring the bodies to a minimum of the potential energy.

        Bodies stay rigid, those named by hand too, which OpenMM's own minimiser bends.

        Parameters
        ----------
        tolerance : float or Quantity
            The largest component of a force that may be left, in kJ/mol/nm if it has no unit.
        maxIterations : int, optional
            0 for as many as it takes.

        Raises
        ------
        ValueError
            If the tolerance is no positive force, or the number of iterations not whole.
        NonFiniteError
            If the energy or a force at the start is not finite.
        ArithmeticError
            If the constraints of a molecule cannot be followed any longer.

        Warns
        -----
        MinimisationWarning
            If the energy does not fall any more above the tolerance.
        """
        force = checks.positive(plain(tolerance, FORCE, "a tolerance"), "a tolerance", FORCE.get_symbol())
        iterations = checks.whole(maxIterations, "maxIterations", least=0)
        self._up_to_date().minimise(self.getIntegrationForceGroups(), force, iterations)

    def getSettings(self) -> dict[str, dict[str, Any]]:
        """Return all that makes this integrator: arguments, what OpenMM's setters set, and letters of your own."""
        rotor = self._rotor.name if ROTORS.get(self._rotor.name) is self._rotor else self._rotor
        h = self.getStepSize().value_in_unit(unit.picosecond)
        arguments = {"stepSize": h, "scheme": self._scheme, "rotor": rotor, "bodies": self._bodies}
        own = {letter: maker for letter, maker in self._makers.items() if LETTERS.get(letter) is not maker}
        settings = {name: getattr(self, f"get{name}")() for name in _SETTINGS}
        return {"arguments": arguments | self._arguments(), "settings": settings, "letters": own}

    def bodyState(self) -> tuple[RigidBodies, BodyState]:
        """Return the bodies and copies of their positions, attitudes and momenta in float64."""
        session = self._up_to_date().session
        return session.bodies, BodyState(*(a.copy() for a in session.bodies.tangent(session.state.rounded)))

    def fullState(self) -> tuple[RigidBodies, State]:
        """Return the bodies and their state in sums high + low of `openmm_exactrb.compensated`: all that is known."""
        session = self._up_to_date().session
        return session.bodies, State(*(a.copy() for a in session.state))

    def setBodyState(self, state: BodyState | State) -> None:
        """Give the bodies a state: places, attitudes and momenta, as `bodyState` or `fullState` returns them.

        Raises
        ------
        ValueError
            If numbers are missing or not finite.
        """
        session = self._up_to_date().session
        full = state if isinstance(state, State) else State.of(state)
        if any(a.shape != b.shape or not np.isfinite(a).all() for a, b in zip(full, session.state, strict=True)):
            raise ValueError("a state of bodies must have finite numbers for all of them: take one of bodyState()")
        session.state = State(*map(np.ascontiguousarray, full))
        session.publish()

    def __repr__(self) -> str:
        """Return scheme, rotor and step."""
        step = self.getStepSize().value_in_unit(unit.picosecond)
        return f"{type(self).__name__}({step:g} ps, scheme={self._scheme.name!r}, rotor={self._rotor.name!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle the settings; a copy has no Context."""
        return _restored, (type(self), *self.getSettings().values())

    def __copy__(self) -> Any:
        """Return an integrator with the same settings and no Context."""
        return _restored(type(self), *self.getSettings().values())

    def _arguments(self) -> dict[str, Any]:
        """Return what a copy is made with, beside the arguments that all have."""
        return {"engine": self._engine.asked} | Nesting.arguments(self._nesting)

    def _steps(self) -> Scheme:  # with all letters of a step
        return self._scheme

    def _own_makers(self) -> Mapping[str, Maker]:  # of the letters that nobody else may make
        return {}

    def _plan(self, context: openmm.Context) -> host.Plan:
        return host.Plan(self._steps(), self._makers)

    def _up_to_date(self) -> host.Host:
        """Return what moves the bodies of the present Context, with what was set there taken up."""
        parts = self._present()
        parts.session.take_up()
        return parts

    def _unsettled(self) -> bool:  # whether the Context is not known, or has changed
        return self._host is None or self._host.session.outdated or self._engine.overtaken(self)

    def _found(self) -> Any:
        return (self._context and self._context()) or find_context(self)

    def _present(self) -> host.Host:
        """Return what moves the bodies of the present Context."""
        if self._host is None or self._unsettled():
            context = self._found()
            self._engine.settle(context, self)
            options = context, self, self._rotor, self._bodies, self.timings
            if self._engine.on_device:
                self._host = device(*options, self._engine)
            else:
                self._engine.withdraw(context, self)
                self._host = host.host(*options, self._nesting)
        return self._host


# What OpenMM's integrators are told by methods: getX and setX.
_SETTINGS = "IntegrationForceGroups", "ConstraintTolerance", "RandomNumberSeed"


def _restored(kind: Any, arguments: dict[str, Any], settings: dict[str, Any], makers: dict[str, Maker]) -> Any:
    """Return an integrator with the settings of another one."""
    integrator = kind(**arguments)
    for name, value in settings.items():
        getattr(integrator, f"set{name}")(value)
    for letter, maker in makers.items():
        integrator.addLetter(letter, maker)
    return integrator
