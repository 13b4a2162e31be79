"""Access to the bodies of an integrator: energies, temperatures and states."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, overload

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb.context.forces import ContextForces
from openmm_exactrb.context.group_motion import of_groups
from openmm_exactrb.context.minimiser import OPENMM, VIOLATED
from openmm_exactrb.context.solver import solvable
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.errors import MinimisationError
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.minimise import minimised
from openmm_exactrb.mechanics.state import BodyState, State
from openmm_exactrb.openmm_access.units import FORCE, gas_constant_times, plain
from openmm_exactrb.support import checks

#: The temperatures of translation and of rotation.
Temperatures = tuple[unit.Quantity, unit.Quantity]


class BodyAccess:
    """The bodies of an integrator's Context: energies, temperatures and states."""

    timings: Timings

    @abstractmethod
    def getIntegrationForceGroups(self) -> int:
        """Return the active force groups as a bit mask."""

    @abstractmethod
    def getNamedBodies(self) -> list[list[int]] | None:
        """Return the particles of each body that was passed as `bodies`, or None."""

    @abstractmethod
    def _up_to_date(self) -> Any:
        """Return the propagator of the present Context, updated with the user's changes."""

    def kineticEnergies(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and the rotational kinetic energy of the bodies, as Quantities in kJ/mol."""
        sync = self._up_to_date().sync
        translational, rotational = sync.bodies.kinetic_energies(sync.state.rounded)
        return translational * unit.kilojoule_per_mole, rotational * unit.kilojoule_per_mole

    def totalEnergy(self) -> unit.Quantity:
        """Return the kinetic energy plus the potential energy of the integration force groups, in kJ/mol.

        The kinetic energy is computed from the bodies in float64, even if the platform rounds velocities. If steps end
        with a drift after a heat exchange, as in the default scheme BAOA, the total energy has its canonical mean but
        additional fluctuations proportional to the step size. In this case, monitor ``effectiveEnergy``.
        """
        context = self._up_to_date().sync.context
        state = context.getState(energy=True, groups=self.getIntegrationForceGroups())
        return sum(self.kineticEnergies(), state.getPotentialEnergy())

    def degreesOfFreedom(self) -> tuple[int, int]:
        """Return the numbers of translational and of rotational degrees of freedom.

        A linear body has two rotational degrees of freedom, and a single particle has zero. With a CMMotionRemover,
        three translational degrees of freedom are subtracted, whatever its interval, because temperatures describe the
        motion relative to the centre of mass.
        """
        return freedom_of(self._up_to_date())

    @overload
    def temperatures(self) -> Temperatures: ...

    @overload
    def temperatures(self, groups: Mapping[str, Iterable[int]]) -> dict[str, Temperatures]: ...

    def temperatures(self, groups: Mapping[str, Iterable[int]] | None = None) -> Temperatures | dict[str, Temperatures]:
        """Return the translational and the rotational temperature of the bodies; nan without degrees of freedom.

        Parameters
        ----------
        groups : dict of str to sequences of int, optional
            Particles of each group, such as domains, linkers and solvent. A group must consist of whole bodies and
            clusters.

        Returns
        -------
        tuple of Quantity, or dict of str to tuples
            The two temperatures of all bodies, or of each group.

        Raises
        ------
        ValueError
            If a group contains only part of a body or cluster, or constraints in ``constraints=`` remove degrees of
            freedom.
        """
        propagator = self._up_to_date()
        sync = propagator.sync
        if groups is None:
            return temperatures_of(thermal_energies(propagator, sync.state), freedom_of(propagator))
        if any(propagator.updates.lost):
            raise ValueError(
                "the degrees of freedom that constraints= removes from each group are unknown: call temperatures() "
                "without groups"
            )
        motions = of_groups(sync.bodies, sync.state, groups, propagator.updates.removes_motion)
        return {name: temperatures_of(*motion) for name, motion in motions.items()}

    def computeSystemTemperature(self) -> unit.Quantity:
        """Return the temperature of all degrees of freedom of the bodies, in K; nan if there are none.

        The result is the mean of `temperatures`, weighted by `degreesOfFreedom`. OpenMM's reporters call this method
        instead of counting the constraints of the System. That count is wrong for redundant constraints and for bodies
        passed as `bodies`.
        """
        propagator = self._up_to_date()
        return _temperature(sum(thermal_energies(propagator, propagator.sync.state)), sum(freedom_of(propagator)))

    def setVelocitiesToTemperature(self, temperature: float | unit.Quantity, randomSeed: int | None = None) -> None:
        """Draw the momenta of the bodies from the canonical distribution at a temperature.

        The distribution is also correct for linear bodies, for redundant constraints and for bodies without
        constraints. With a CMMotionRemover, the total momentum is 0. ``Context.setVelocitiesToTemperature`` calls this
        method if OpenMM's constraint solver fails or the integrator has `bodies`.

        Parameters
        ----------
        temperature : float or Quantity
            Temperature, in K if given without a unit.
        randomSeed : int, optional
            Seed of the random numbers; by default drawn from the operating system.

        Raises
        ------
        ValueError
            If the temperature is negative, not finite or has an incompatible unit, or the seed is not a whole number.
        """
        seed = None if randomSeed is None else checks.whole(randomSeed, "randomSeed", least=0)
        propagator, kT, rng = self._up_to_date(), gas_constant_times(temperature), np.random.default_rng(seed)
        sync, at_rest = propagator.sync, propagator.updates.removes_motion
        sync.replace(sync.state.renewed(sync.bodies.canonical_momenta(sync.state.rounded, kT, rng, at_rest)))

    def minimizeEnergy(self, tolerance: float | unit.Quantity = 10.0, maxIterations: int = 0) -> None:
        """Minimise the potential energy.

        Bodies stay rigid, including those passed as `bodies`, and constraints may be redundant, for both of which
        ``simulation.minimizeEnergy`` raises an error. If molecules are constrained but not rigid, this method uses
        OpenMM's minimiser.

        Parameters
        ----------
        tolerance : float or Quantity
            Largest component of a force at the minimum, in kJ/mol/nm if given without a unit. OpenMM's minimiser limits
            the root mean square of all components instead.
        maxIterations : int, optional
            Largest number of iterations; 0 for no limit.

        Raises
        ------
        ValueError
            If the tolerance is not a positive force, the number of iterations is not whole, or the integrator has
            `bodies` and some molecules are constrained but not rigid.
        NonFiniteError
            If the energy or a force at the initial positions is not finite.
        MinimisationError
            If OpenMM's minimiser violates or does not support the constraints.

        Warns
        -----
        MinimisationWarning
            If the energy stops falling before the tolerance is reached.
        """
        force = checks.positive(plain(tolerance, FORCE, "a tolerance"), "a tolerance", FORCE.get_symbol())
        iterations = checks.whole(maxIterations, "maxIterations", least=0)
        sync = self._up_to_date().sync
        bodies = sync.bodies
        if len(bodies.clusters):
            if self.getNamedBodies():
                raise ValueError(
                    "a System that contains flexible molecules with constraints cannot be minimised with bodies "
                    "given in bodies=: minimise first, with an integrator without bodies="
                )
            start = sync.held()[0]
            try:
                if not solvable(sync.context.getSystem(), start):
                    raise ValueError("constraints follow from others")
                OPENMM(sync.context, force, iterations)
                sync.pull()
            except (ValueError, openmm.OpenMMException) as error:
                sync.context.setPositions(start)
                raise MinimisationError(VIOLATED.format(", so the positions are unchanged")) from error
            sync.push()
            return
        landscape = ContextForces(sync.positions, self.getIntegrationForceGroups(), self.timings).landscape
        found = minimised(bodies, sync.state.rounded, landscape, force, iterations, sync.box())
        sync.replace(sync.state.renewed(found))

    def bodyState(self) -> tuple[RigidBodies, BodyState]:
        """Return the bodies and copies of their positions, orientations and momenta in float64."""
        sync = self._up_to_date().sync
        return sync.bodies, BodyState(*(a.copy() for a in sync.bodies.tangent(sync.state.rounded)))

    def fullState(self) -> tuple[RigidBodies, State]:
        """Return the bodies and a copy of their state in double-doubles (`openmm_exactrb.mathematics.compensated`)."""
        sync = self._up_to_date().sync
        return sync.bodies, State(*(a.copy() for a in sync.state))

    def setBodyState(self, state: BodyState | State) -> None:
        """Set the state of the bodies: positions, orientations and momenta, as returned by `bodyState` or `fullState`.

        Raises
        ------
        ValueError
            If numbers are missing or not finite, or quaternions are not of unit length within 1e-9.
        """
        sync = self._up_to_date().sync
        if not isinstance(state, BodyState | State):
            raise ValueError(f"setBodyState() takes a state such as bodyState()[1], not {type(state).__name__}")
        full = state if isinstance(state, State) else State.of(state)
        if any(a.shape != b.shape or not np.isfinite(a).all() for a, b in zip(full, sync.state, strict=True)):
            raise ValueError(
                "the state must contain finite numbers for each body of the System: pass a state such as bodyState()[1]"
            )
        if not (np.abs((full.q[0] ** 2).sum(axis=0) - 1.0) < 2e-9).all():
            raise ValueError("orientations must be quaternions of unit length: divide each by its norm")
        sync.replace(State(*map(np.ascontiguousarray, full)))


def freedom_of(propagator: Any) -> tuple[int, int]:
    """Return the degrees of freedom of translation and of rotation."""
    freedom: tuple[int, int] = propagator.updates.freedom(propagator.sync.bodies)
    return freedom


def thermal_energies(propagator: Any, state: State) -> tuple[float, float]:
    """Return the kinetic energies from which temperatures are computed, in kJ/mol."""
    bodies, rounded = propagator.sync.bodies, state.rounded
    drift = bodies.drift(rounded) if propagator.updates.removes_motion else None
    energies: tuple[float, float] = bodies.kinetic_energies(rounded, drift)
    return energies


def temperatures_of(energies: Sequence[float], freedom: Sequence[float]) -> Temperatures:
    """Return translational and rotational temperatures; nan without degrees of freedom."""
    one, other = map(_temperature, energies, freedom)
    return one, other


def _temperature(energy: float, freedom: float) -> unit.Quantity:
    R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
    return 2.0 * energy / ((freedom or math.nan) * R) * unit.kelvin
