"""The data that corrections need from a Langevin integrator of this package or of OpenMM."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import unit

from openmm_exactrb.averages.chord import Chords
from openmm_exactrb.context.updates import ContextUpdates, warn_of_removed_motion
from openmm_exactrb.context.watch import watch
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.integrators.integrator import ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.bodies import RigidBodies
from openmm_exactrb.mechanics.fit import fit
from openmm_exactrb.mechanics.state import BodyState
from openmm_exactrb.multiple_time_steps import virtual_sites
from openmm_exactrb.multiple_time_steps.fast_forces import FastForces, fast_forces
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.openmm_access.molecules import in_flexible_molecules
from openmm_exactrb.schemes import scheme_for_thermostat
from openmm_exactrb.schemes.step_errors import StepErrors, step_errors
from openmm_exactrb.schemes.thermostatted import with_thermostat
from openmm_exactrb.support.descriptions import mismatch
from openmm_exactrb.support.types import Array
from openmm_exactrb.thermostats.hybrid import HybridMonteCarlo
from openmm_exactrb.thermostats.langevin import Langevin
from openmm_exactrb.thermostats.thermostat import Thermostat


@dataclass(frozen=True)
class Dynamics:
    """Langevin dynamics with one heat exchange per step.

    Attributes
    ----------
    scheme : str
    step : float
        Step size in ps.
    errors : StepErrors
        Coefficients of the step-size error.
    temperature : float
        Temperature in K.
    frictions : tuple of float
        Frictions in 1/ps.
    freedom : int
        Number of degrees of freedom.
    bodies : RigidBodies
        The bodies of the System.
    named : sequence of sequences of int
        Particles of each body passed as `bodies`.
    state : callable
        Returns the state of the bodies at the positions (n_particles, 3) of the Context.
    damping : (N,) and (K,) arrays
        Frictions of translation and of rotation, relative to their mean over the degrees of freedom.
    fast : FastForces, optional
        The fast forces, which act in the drifts.
    chords : Chords, optional
        The conserved term of drifts along chords; None for other drifts.
    changing : callable
        Returns the settings that a user may change during a run.
    """

    scheme: str
    step: float
    errors: StepErrors
    temperature: float
    frictions: tuple[float, ...]
    freedom: int
    bodies: RigidBodies
    named: Sequence[Sequence[int]] | None
    state: Callable[[Array], BodyState]
    damping: tuple[Array, Array]
    fast: FastForces | None
    chords: Chords | None
    changing: Callable[[], object]


def dynamics_of(simulation: Any) -> Dynamics:
    """Return the data that corrections need from the integrator of a Simulation.

    Raises
    ------
    ValueError
        If averages of the integrator cannot be corrected.
    """
    integrator = simulation.integrator
    if isinstance(integrator, ExactRigidBodyIntegrator) and isinstance(integrator.getThermostat(), HybridMonteCarlo):
        raise ValueError(
            "averages of hybrid Monte Carlo have no step-size error, so there is nothing to correct: omit the "
            "AverageReporter, and average the energies or observables themselves"
        )
    theirs = isinstance(integrator, openmm.LangevinMiddleIntegrator)
    if not theirs and not (
        isinstance(integrator, ExactRigidBodyIntegrator) and _is_langevin(integrator.getThermostat())
    ):
        raise ValueError(
            "averages can be corrected only for Langevin dynamics: use ExactRigidBodyLangevinIntegrator or OpenMM's "
            f"LangevinMiddleIntegrator instead of {type(integrator).__name__}"
        )
    frictions = _frictions_of_openmm(integrator) if theirs else _frictions(integrator.getThermostat())
    if not any(frictions):
        raise ValueError(
            "averages can be corrected only for Langevin dynamics with friction: create the integrator with a friction "
            "above 0"
        )
    if integrator.getIntegrationForceGroups() & 0xFFFFFFFF != 0xFFFFFFFF:
        raise ValueError(
            "averages can be corrected only if the integrator uses all force groups: call "
            "integrator.setIntegrationForceGroups(set(range(32)))"
        )
    if not theirs and integrator.getSettings()["arguments"]["constraints"]:
        raise ValueError(
            "averages can be corrected only for rigid bodies and distance constraints: create the integrator without "
            "constraints="
        )
    dynamics = (_of_openmm if theirs else _of_this_package)(simulation, frictions)
    if not dynamics.temperature:
        raise ValueError(
            "averages can be corrected only at a temperature above 0 K: set a positive temperature with "
            "integrator.setTemperature"
        )
    return dynamics


def _is_langevin(thermostat: Thermostat | None) -> bool:
    """Return whether friction and noise of a thermostat are those of Langevin dynamics with its frictions."""
    return isinstance(thermostat, Langevin) and not mismatch(thermostat, "frictions", *thermostat.flows)


def _frictions(thermostat: Langevin) -> tuple[float, ...]:
    return tuple(dict.fromkeys((*thermostat.frictions, *thermostat.flexible_frictions)))


def _frictions_of_openmm(integrator: openmm.LangevinMiddleIntegrator) -> tuple[float, ...]:
    return (integrator.getFriction().value_in_unit(unit.picosecond**-1),)


def _of_this_package(simulation: Any, frictions: tuple[float, ...]) -> Dynamics:
    integrator, context = simulation.integrator, simulation.context
    thermostat, step = integrator.getThermostat(), integrator.getStepSize()._value
    bodies = integrator.bodyState()[0]
    masses = virtual_sites.masses(simulation.system, lambda: arrays.positions(context.getState(positions=True)))
    fast = fast_forces(simulation.system, bodies, integrator.getMultipleTimeSteps(), masses)
    if fast is not None and not fast.acts(integrator.getScheme(), step):
        fast = None
    if fast is not None and not integrator._up_to_date().defers_inner_drifts:  # noqa: SLF001
        raise ValueError(
            "averages cannot be corrected with these fast forces, for which the engine "
            f"{integrator.getEngine()!r} has no kernel: use engine='host'"
        )
    return Dynamics(
        scheme=integrator.getScheme().name,
        step=step,
        errors=step_errors(thermostat.steps(integrator.getScheme())),
        temperature=thermostat.temperature,
        frictions=frictions,
        freedom=sum(integrator.degreesOfFreedom()),
        bodies=bodies,
        named=integrator.getNamedBodies(),
        state=lambda _: integrator.bodyState()[1],
        damping=_damping(thermostat, bodies, in_flexible_molecules(context, bodies, integrator.getNamedBodies())),
        fast=fast,
        chords=None,
        changing=lambda: (
            integrator.getStepSize()._value,
            integrator.getThermostat(),
            integrator.getScheme(),
            integrator.bodyState()[0] is bodies,  # false after context.reinitialize()
        ),
    )


def _of_openmm(simulation: Any, frictions: tuple[float, ...]) -> Dynamics:
    """Return the dynamics of a LangevinMiddleIntegrator: BAOA with drifts along chords."""
    integrator, context, system = simulation.integrator, simulation.context, simulation.system
    temperature = integrator.getTemperature().value_in_unit(unit.kelvin)
    ContextUpdates(context, ()).settle(context, temperature)
    warn_of_removed_motion(system)
    x = arrays.positions(context.getState(positions=True))
    bodies = find_bodies(system, x, box=arrays.periodic_box(context))
    renewed: list[bool] = []
    watch(context, "reinitialize", after=lambda: renewed.append(True))
    removed = 3 * any(isinstance(force, openmm.CMMotionRemover) for force in system.getForces())
    return Dynamics(
        scheme="LangevinMiddle",
        step=integrator.getStepSize().value_in_unit(unit.picosecond),
        errors=step_errors(with_thermostat(scheme_for_thermostat("BAOA"))),
        temperature=temperature,
        frictions=frictions,
        freedom=bodies.translational_freedom + bodies.rotational_freedom - removed,
        bodies=bodies,
        named=None,
        state=lambda positions: fit(bodies, positions, np.zeros_like(positions)),
        damping=(np.ones(len(bodies)), np.ones(bodies.n_turning)),
        fast=None,
        chords=Chords(bodies, parameters.constraints(system)[0], x),
        changing=lambda: (
            integrator.getStepSize(),
            integrator.getTemperature(),
            integrator.getFriction(),
            len(renewed),
        ),
    )


def _damping(thermostat: Langevin, bodies: RigidBodies, flexible: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the frictions of bodies relative to their mean; bodies in flexible molecules may have other frictions."""
    rates = zip(thermostat.frictions, thermostat.flexible_frictions, strict=True)
    translation, rotation = (np.where(flexible, other, rate) for rate, other in rates)
    rotation = rotation[: bodies.n_turning]
    freedom = np.full(len(bodies), 3.0)
    if len(bodies.clusters):
        freedom[bodies.clustered] *= bodies.clusters.degrees_of_freedom / (3.0 * len(bodies.clusters.mass))
    turning = (bodies.principal_moments > 0.0).sum(axis=0)
    mean = (translation @ freedom + rotation @ turning) / (freedom.sum() + turning.sum())
    return translation / mean, rotation / mean
