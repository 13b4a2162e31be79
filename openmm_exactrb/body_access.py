"""Access to the bodies of an integrator: energies, temperatures, states."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any

import numpy as np
import openmm
from openmm import unit

from openmm_exactrb import checks
from openmm_exactrb.context.forces import ContextForces, Positions
from openmm_exactrb.context.timings import Timings
from openmm_exactrb.context.units import FORCE, gas_constant_times, plain
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.minimise import minimised
from openmm_exactrb.mechanics.state import BodyState, State


class BodyAccess:
    """The bodies of an integrator's Context: energies, temperatures, states."""

    timings: Timings

    @abstractmethod
    def getIntegrationForceGroups(self) -> int:
        """Return the bits of the force groups that act."""

    @abstractmethod
    def getNamedBodies(self) -> list[list[int]] | None:
        """Return the particles of the bodies in addition to those that constraints make."""

    @abstractmethod
    def _up_to_date(self) -> Any:
        """Return the propagator of the present Context, which knows what was set there."""

    def kineticEnergies(self) -> tuple[unit.Quantity, unit.Quantity]:
        """Return the translational and the rotational kinetic energy of the bodies, as Quantities in kJ/mol."""
        sync = self._up_to_date().sync
        translational, rotational = sync.bodies.kinetic_energies(sync.state.rounded)
        return translational * unit.kilojoule_per_mole, rotational * unit.kilojoule_per_mole

    def totalEnergy(self) -> unit.Quantity:
        """Return the energy that a run should keep, in kJ/mol: kinetic, and potential of the force groups that act.

        The kinetic part is that of the bodies in float64, also where the platform's velocities are rounded.
        """
        context = self._up_to_date().sync.context
        state = context.getState(energy=True, groups=self.getIntegrationForceGroups())
        return sum(self.kineticEnergies(), state.getPotentialEnergy())

    def degreesOfFreedom(self) -> tuple[int, int]:
        """Return the numbers of translational and of rotational degrees of freedom.

        A linear body has two rotational ones, a particle none. With a CMMotionRemover three translational are missing,
        whatever its interval is: between two removals nothing but a thermostat, or forces from outside, moves the
        centre of mass.
        """
        propagator = self._up_to_date()
        bodies = propagator.sync.bodies
        return bodies.translational_freedom - 3 * propagator.updates.removes_motion, bodies.rotational_freedom

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
            If the temperature is negative, not finite or has another unit, or the seed is not a whole number.
        """
        seed = None if randomSeed is None else checks.whole(randomSeed, "randomSeed", least=0)
        propagator, kT, rng = self._up_to_date(), gas_constant_times(temperature), np.random.default_rng(seed)
        sync, at_rest = propagator.sync, propagator.updates.removes_motion
        sync.replace(sync.state.renewed(sync.bodies.canonical_momenta(sync.state.rounded, kT, rng, at_rest)))

    def minimizeEnergy(self, tolerance: float | unit.Quantity = 10.0, maxIterations: int = 0) -> None:
        """Bring the bodies to a minimum of the potential energy.

        Bodies stay rigid, those named by hand too, which OpenMM's own minimiser bends. Where constraints leave a
        molecule a motion of its own, OpenMM's minimiser does it.

        Parameters
        ----------
        tolerance : float or Quantity
            The largest component of a force that may be left, in kJ/mol/nm if it has no unit; the root mean square of
            all for OpenMM's minimiser.
        maxIterations : int, optional
            0 for as many as it takes.

        Raises
        ------
        ValueError
            If the tolerance is not a positive force, the number of iterations is not whole, or bodies are named by hand
            where constraints leave a molecule a motion of its own.
        NonFiniteError
            If the energy or a force at the start is not finite.
        ArithmeticError
            If OpenMM's minimiser loses the constraints.

        Warns
        -----
        MinimisationWarning
            If the energy does not fall any more above the tolerance.
        """
        force = checks.positive(plain(tolerance, FORCE, "a tolerance"), "a tolerance", FORCE.get_symbol())
        iterations = checks.whole(maxIterations, "maxIterations", least=0)
        sync = self._up_to_date().sync
        bodies = sync.bodies
        if len(bodies.clusters):
            if self.getNamedBodies():
                raise ValueError(
                    "bodies named by hand cannot be minimised together with molecules with constraints: minimise with "
                    "simulation.minimizeEnergy() before bodies are named"
                )
            start = sync.context.getState(positions=True).getPositions()
            try:
                openmm.LocalEnergyMinimizer.minimize(sync.context, force, iterations)
                sync.pull()
            except (ValueError, openmm.OpenMMException) as error:
                sync.context.setPositions(start)
                raise ArithmeticError(
                    "OpenMM's minimiser lost the constraints, for which its solver does not converge; positions are "
                    "those of before: take overlaps out by short steps with much friction and checkDivergence=False"
                ) from error
            sync.push()
            return
        positions = Positions(sync.context, bodies, sync.particles)
        landscape = ContextForces(positions, self.getIntegrationForceGroups(), self.timings).landscape
        found = minimised(bodies, sync.state.rounded, landscape, force, iterations, sync.box())
        sync.replace(sync.state.renewed(found))

    def bodyState(self) -> tuple[RigidBodies, BodyState]:
        """Return the bodies and copies of their positions, orientations and momenta in float64."""
        sync = self._up_to_date().sync
        return sync.bodies, BodyState(*(a.copy() for a in sync.bodies.tangent(sync.state.rounded)))

    def fullState(self) -> tuple[RigidBodies, State]:
        """Return the bodies and their state in sums high + low of `openmm_exactrb.compensated`, as it is shown."""
        sync = self._up_to_date().sync
        return sync.bodies, State(*(a.copy() for a in sync.state))

    def setBodyState(self, state: BodyState | State) -> None:
        """Give the bodies a state: positions, orientations and momenta, as `bodyState` or `fullState` returns them.

        Raises
        ------
        ValueError
            If numbers are missing or not finite, or quaternions are not of unit length within 1e-9.
        """
        sync = self._up_to_date().sync
        if not isinstance(state, BodyState | State):
            raise ValueError(f"setBodyState() takes the state of bodies, bodyState()[1], not a {type(state).__name__}")
        full = state if isinstance(state, State) else State.of(state)
        if any(a.shape != b.shape or not np.isfinite(a).all() for a, b in zip(full, sync.state, strict=True)):
            raise ValueError("a state of bodies must have finite numbers for all of them: take one of bodyState()")
        if not (np.abs((full.q[0] ** 2).sum(axis=0) - 1.0) < 2e-9).all():
            raise ValueError("orientations must be quaternions of unit length: divide each by its norm")
        sync.replace(State(*map(np.ascontiguousarray, full)))
