"""The description of a System that ``exactrb info FILE`` prints: its contents, motion and suitable step sizes."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray
from openmm import app, unit
from openmm.app.internal.unitcell import computeLengthsAndAngles

from openmm_exactrb.context.solver import mended
from openmm_exactrb.context.updates import names_of_updates
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.integrators.integrator import DEFAULT, ExactRigidBodyIntegrator
from openmm_exactrb.mechanics.bodies import Kind, RigidBodies
from openmm_exactrb.multiple_time_steps import virtual_sites
from openmm_exactrb.multiple_time_steps.fast_forces import MultipleTimeSteps, fast_forces
from openmm_exactrb.multiple_time_steps.resonance import Resonances
from openmm_exactrb.multiple_time_steps.stiffness import frequencies
from openmm_exactrb.openmm_access import arrays, parameters
from openmm_exactrb.schemes import splitting
from openmm_exactrb.support.types import Array
from openmm_exactrb.thermostats import Langevin
from openmm_exactrb.tuning.floor import causes

_SHOWN = 3  # largest number of periods that are printed
_WATER = 18.015  # mass of a water molecule in amu
_LIGHTEST = 2.9  # mass in amu above which hydrogens are heavy enough for a force evaluation every 8 fs
# Step times frequency of an isolated bond above which OpenMM's integrators are unstable; 2 if bonds were not coupled.
_STABLE = 1.6
_THEIRS = "openmm.LangevinMiddleIntegrator(300*kelvin, 5/picosecond, {}*femtoseconds)"

#: The schemes for proteins in water at constant temperature: the default, and one with the temperatures of water.
PROTEIN, PROTEIN_AND_WATER = Langevin.scheme, "W2_3m"


def described(
    system: openmm.System, positions: unit.Quantity | None = None, topology: app.Topology | None = None
) -> Iterator[str]:
    """Yield the lines that describe a System.

    Parameters
    ----------
    system : openmm.System
    positions : Quantity, optional
        Positions (n_particles, 3). Without positions, the constraints alone determine the shapes of bodies.
    topology : openmm.app.Topology, optional
        Topology from which the names of atoms and residues are taken.
    """
    names = _Names(system, topology)
    yield from _particles(system)
    if others := names_of_updates(system):
        yield f"acting between steps: {', '.join(others)}"
    try:
        bodies, masses, noted = _found(system, positions)
    except ValueError as error:
        unplaced = positions is None and "constraint" in str(error)
        hint = "; its shape may need positions: add a State, PDB or gro file" if unplaced else ""
        yield f"not supported: {' '.join(str(error).split())}{hint}"
        return
    yield from _bodies(bodies, names)
    yield from _periods(system, names, masses)
    yield from _advice(system, bodies, masses)
    yield from (f"limits the energy error of any integrator: {cause}" for cause in causes(system))
    if any(causes(system)):
        yield "exactrb tune measures this limit (documentation: Questions, answers and limits, on remedies and costs)"
    if positions is None:
        yield "no positions were given, so distances were not compared with the constraints"
    else:
        yield from (*noted, "everything is supported")


def _found(system: openmm.System, positions: unit.Quantity | None) -> tuple[RigidBodies, Array, list[str]]:
    """Return the bodies, the masses of particles and of virtual sites with bonded terms, and warnings of a first step.

    Without positions, constraints alone define the bodies, and virtual sites have no mass.
    """
    if positions is None:
        x = np.random.default_rng(1).standard_normal((system.getNumParticles(), 3))
        return find_bodies(system, x), parameters.masses(system), []
    integrator = ExactRigidBodyIntegrator(0.001)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    corrected = mended(context)
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        bodies, _ = integrator.bodyState()
    notes = [str(note.message) for note in noted]
    if corrected:
        notes.insert(
            0,
            f"constrained bonds are stretched by up to {corrected:.2g} nm, which exactrb run corrects before its "
            "minimisation: in a script, call context.applyConstraints(1e-6) after setPositions",
        )
    masses = virtual_sites.masses(system, lambda: arrays.positions(context.getState(positions=True)))
    return bodies, masses, notes


class _Names:
    """The names of particles and of their residues."""

    def __init__(self, system: openmm.System, topology: app.Topology | None) -> None:
        n = system.getNumParticles()
        atoms = [] if topology is None else list(topology.atoms())
        self._atoms = [f"{atom.name} {atom.index}" for atom in atoms] or [str(i) for i in range(n)]
        self._residues = [atom.residue.name for atom in atoms] or n * [""]

    def joined(self, particles: Iterable[int]) -> str:
        """Return the names of given particles, separated by commas."""
        return ", ".join(self._atoms[i] for i in particles)

    def residues(self, particles: NDArray[np.integer[Any]]) -> str:
        """Return the distinct names of the residues of the first particles of bodies, at most three."""
        found = dict.fromkeys(self._residues[i] for i in particles[:, 0].tolist())
        shown = [name for name in islice(found, 3) if name]
        return f" ({', '.join(shown)}{', ...' if len(found) > 3 else ''})" if shown else ""


def _particles(system: openmm.System) -> Iterator[str]:
    n = system.getNumParticles()
    sites = sum(system.isVirtualSite(i) for i in range(n))
    massless = sum(system.getParticleMass(i)._value == 0.0 for i in range(n)) - sites
    parts = [f"{n} particles", *([f"{sites} virtual sites"] if sites else [])]
    if massless:
        parts.append(f"{massless} without mass, which do not move")
    parts.append(f"{system.getNumConstraints()} constraints")
    yield ", ".join(parts)
    if system.usesPeriodicBoundaryConditions():
        vectors = [vector.value_in_unit(unit.nanometer) for vector in system.getDefaultPeriodicBoxVectors()]
        *edges, alpha, beta, gamma = computeLengthsAndAngles(vectors)
        angles = [f"{math.degrees(angle):.4g}" for angle in (alpha, beta, gamma)]
        slanted = f", angles {', '.join(angles)} degrees" if angles != ["90"] * 3 else ""
        yield f"periodic box, {' x '.join(f'{edge:.4g}' for edge in edges)} nm{slanted}"


def _bodies(bodies: RigidBodies, names: _Names) -> Iterator[str]:
    """Yield lines about rigid bodies, constrained clusters, single particles and degrees of freedom."""
    several: dict[tuple[int, bool, bool], list[Kind]] = {}
    for kind in bodies.kinds:
        if len(kind.masses) > 1:
            several.setdefault((len(kind.masses), kind.linear, kind.turns), []).append(kind)
    for (k, linear, turns), kinds in sorted(several.items()):
        inertia = np.concatenate([kind.inertia for kind in kinds])
        moments = " ".join(f"{moment:.4g}" for moment in inertia[0])
        if np.ptp(inertia, axis=0).max() > 1e-6 * inertia.max():
            moments += " and others"
        count = sum(len(kind.particles) for kind in kinds)
        particles = np.concatenate([kind.particles for kind in kinds])
        what = f"{'straight ' if linear else ''}rigid {'body' if count == 1 else 'bodies'}"
        yield (
            f"{count} {what} of {k} particles{names.residues(particles)}: "
            f"{3 + turns * (3 - linear)} degrees of freedom, moments {moments} amu nm²"
        )
    for cluster in sorted(bodies.clusters.kinds, key=lambda kind: len(kind.masses)):
        count = len(cluster.particles)
        line = (
            f"{count} cluster{'s' if count > 1 else ''} of {len(cluster.masses)} "
            f"particles{names.residues(cluster.particles)}: {cluster.freedom} degrees of freedom and "
            f"{len(cluster.pairs)} constraints"
        )
        if len(cluster.implied):
            i, j = cluster.particles[0, cluster.implied[0]]
            line += f"; {len(cluster.implied)} more are redundant, such as that of particles {names.joined((i, j))}"
        yield line
    single = np.concatenate(
        [np.zeros((0, 1), dtype=int), *(kind.particles for kind in bodies.kinds if len(kind.masses) == 1)]
    )[len(bodies.clusters.mass) :]
    if len(single):
        yield f"{len(single)} single particles{names.residues(single)}"
    freedom = bodies.translational_freedom, bodies.rotational_freedom
    yield f"degrees of freedom: {freedom[0]} of translation and vibration, {freedom[1]} of rotation"


def _periods(system: openmm.System, names: _Names, masses: Array) -> Iterator[str]:
    """Yield a line with the shortest distinct periods of bonds and angles."""
    distinct: dict[float, tuple[int, ...]] = {}
    for some, particles in frequencies(system, masses=masses):
        for frequency, own in zip(some.tolist(), particles.tolist(), strict=True):
            distinct.setdefault(float(f"{frequency:.4g}"), tuple(own))
    fastest = [frequency for frequency in sorted(distinct, reverse=True) if frequency > 0.0][:_SHOWN]
    if fastest:
        what = {2: "bond", 3: "angle"}
        periods = (
            f"{2000.0 * math.pi / f:.3g} fs ({what[len(distinct[f])]} of {names.joined(distinct[f])})" for f in fastest
        )
        yield f"shortest periods: {', '.join(periods)}"


def _advice(system: openmm.System, bodies: RigidBodies, masses: Array) -> Iterator[str]:
    """Yield the settings that docs/which.md recommends, or a line without settings if there is no rigid water."""
    if not any(len(kind.masses) == 3 and abs(kind.mass - _WATER) < 0.1 for kind in bodies.kinds):
        yield "step: not measured for such molecules; exactrb tune finds one"
        return
    flexible = fast_forces(system, bodies, MultipleTimeSteps.of("auto", None, None), masses) is not None
    yield from _of_proteins(system, masses) if flexible else _of_water()
    page = "Which integrator, scheme and step, which names where OpenMM is as good"
    yield f"these steps were measured on {'proteins in water' if flexible else 'rigid water'} (documentation: {page})"


def _of_water() -> Iterator[str]:
    yield f"constant energy: {_at_constant_energy(2.0, 'W4_4')}"
    yield f"constant temperature: {_THEIRS.format(4)}"
    yield f"constant temperature, with correct temperatures in reports: {_with_thermostat(4.0, 'W2_4g')}"


def _of_proteins(system: openmm.System, masses: Array) -> Iterator[str]:
    """Yield the settings for the masses of the System, and what heavier hydrogens allow."""
    real = parameters.masses(system)
    heavy = real[real > 0.0].min() > _LIGHTEST
    resonances, asked = Resonances(system, masses=masses), 8.0 if heavy else 4.0

    def within(name: str) -> float:
        """Return the asked interval in fs, or the longest one below the first resonance."""
        resonance = resonances.first(splitting(name))
        return asked if resonance is None else min(asked, 1000.0 * resonance.below(splitting(name)))

    fastest = max((float(some.max()) for some, _ in frequencies(system, masses=masses) if len(some)), default=0.0)
    without_inner_steps = not heavy and 1e-3 * asked * fastest < _STABLE
    yield f"constant energy: {_at_constant_energy(4.0, DEFAULT)}"
    yield f"constant temperature: {_THEIRS.format(4) if without_inner_steps else _with_thermostat(within(PROTEIN))}"
    if heavy:
        precise = _with_thermostat(within(PROTEIN_AND_WATER), PROTEIN_AND_WATER)
        yield f"constant temperature, with correct temperatures of water in reports: {precise}"
        yield f"as fast, but hotter in reports, with constraints=AllBonds: {_THEIRS.format(8)}"
    else:
        yield (
            "half the cost at constant temperature: constraints=HBonds and hydrogens of 3 amu, also in water "
            f"(--hydrogen-mass 3, or rb.heavy_hydrogens), allow {_with_thermostat(8.0)}"
        )


def _at_constant_energy(interval: float, scheme: str) -> str:
    """Return the call that creates an integrator, for a time in fs between two force evaluations."""
    return f"rb.ExactRigidBodyIntegrator({_pace(interval, scheme, DEFAULT)})"


def _with_thermostat(interval: float, scheme: str = PROTEIN) -> str:
    """Return the same at constant temperature."""
    pace = _pace(interval, scheme, Langevin.scheme)
    return f"rb.ExactRigidBodyLangevinIntegrator(300*kelvin, 5/picosecond, {pace})"


def _pace(interval: float, scheme: str, default: str) -> str:
    if scheme == default:
        return f"{interval:g}*femtoseconds"
    return f'forceInterval={interval:g}*femtoseconds, scheme="{scheme}"'
