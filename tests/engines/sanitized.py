"""A process in which a library with sanitizers, at the path in the first argument, moves every kind of body.

A sanitizer ends the process if a kernel reads or writes beyond an array, divides an integer by zero, and so on.
"""

import copy
import itertools
import sys
import warnings
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from alchemical import alchemical
from bonded_terms import FORMS, N, tether
from bonded_terms import system_of as bonded
from custom_forces import ENERGIES, KINDS, chain, force_of
from graphs import GRAPHS
from graphs import system_of as clusters
from openmm_exactrb.library import library
from peptides import in_water
from places import CPU, REFERENCE
from starts import positions_of
from zoo import every_kind, water

EVERY_KIND = every_kind()
PEPTIDES = {constraints: in_water(constraints, 8)[1:] for constraints in ("None", "HBonds", "AllBonds", "HAngles")}


def constant(scheme, h=0.001, **options):
    return rb.ExactRigidBodyIntegrator(h, scheme, engine="native", **options)


def langevin(scheme, h=0.002, **options):
    return rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, h, scheme, engine="native", **options)


def rescaling(h=0.002, **options):
    return rb.ExactRigidBodyRescalingIntegrator(300.0, 0.1, h, engine="native", **options)


def chains(h=0.002, **options):
    return rb.ExactRigidBodyNoseHooverIntegrator(300.0, 20.0, h, engine="native", **options)


def with_forces(system, *forces):
    system = copy.deepcopy(system)
    for force in forces:
        system.addForce(copy.deepcopy(force))
    return system


def started(system, positions, integrator, platform=REFERENCE):
    """Return a Context of a copy of a System at 300 K."""
    properties = {"Threads": "2"} if platform is CPU else {}
    context = openmm.Context(copy.deepcopy(system), integrator, platform, properties)
    context.setPositions(positions)
    context.computeVirtualSites()
    integrator.setVelocitiesToTemperature(300.0, 1)
    return context


def moved(system, positions, integrator, platform=REFERENCE):
    """Return the Context after a few steps, checkpoints and a copy of the integrator."""
    context = started(system, positions, integrator, platform)
    integrator.step(1)
    integrator.step(4)
    assert integrator.getEngine() == "native", integrator.engineNote()
    context.loadCheckpoint(context.createCheckpoint())
    integrator.step(2)
    integrator.temperatures()
    copied = copy.deepcopy(integrator)
    other = openmm.Context(copy.deepcopy(system), copied, platform)
    other.setState(context.getState(positions=True, velocities=True, integratorParameters=True, parameters=True))
    copied.step(2)
    for c in (context, other):
        assert np.isfinite(positions_of(c)).all()
    context.reinitialize(preserveState=True)
    integrator.step(1)
    return context


def rigid_bodies():
    small, many = water(8), water(600)
    for scheme in ("S2_2", "W2_1", "W4_4", "Chin4A", "SRKN6_14a"):
        yield *small, constant(scheme)
        yield *EVERY_KIND[:2], constant(scheme, bodies=EVERY_KIND[2])
    for scheme in ("BAOA", "BAOAB", "W2_3m"):
        yield *EVERY_KIND[:2], langevin(scheme, bodies=EVERY_KIND[2])
    for make in (rescaling, chains):
        yield *EVERY_KIND[:2], make(bodies=EVERY_KIND[2])
    yield *water(8, "tip4pew"), constant("W2_1")
    yield *water(1, method=app.NoCutoff), constant("W2_1")
    yield *many, constant("S2_2"), CPU
    yield *many, langevin("W2_3m"), CPU
    system, positions = small
    for barostat in (
        openmm.MonteCarloBarostat(1.0, 300.0, 1),
        openmm.MonteCarloAnisotropicBarostat(openmm.Vec3(1, 1, 1), 300.0, True, True, True, 1),
    ):
        for integrator in (langevin("W2_3m"), constant("W2_1")):
            yield with_forces(system, barostat, openmm.CMMotionRemover(2)), positions, integrator
    yield with_forces(system, openmm.AndersenThermostat(300.0, 100.0)), positions, constant("W2_1")


def flexible_molecules():
    for system, positions in PEPTIDES.values():
        yield system, positions, constant("S2_2", 0.002, fast="bonded")
        yield system, positions, langevin("W2_3m", 0.004, fast="bonded", flexibleFriction=20.0), CPU
        yield alchemical(system), positions, langevin("BAOA", fast="bonded")
    system, positions = PEPTIDES["AllBonds"]
    for scheme in ("W2_1", "W4_4"):
        yield system, positions, constant(scheme, 0.002, fast="bonded")
    yield system, positions, langevin("BAOA", 0.004, fast="bonded", innerSteps=3)
    for make in (rescaling, chains):
        yield system, positions, make(fast="bonded")
    yield with_forces(system, openmm.CMMotionRemover(1)), positions, rescaling(fast="bonded")
    tethered = with_forces(system, tether(0, 30))
    rb.separate_bonded(tethered)
    yield tethered, positions, langevin("W2_3m", fast=(1,), innerSteps=3)
    turns = np.radians(100.0) * np.arange(N)
    helix = np.stack([0.1 * np.cos(turns), 0.1 * np.sin(turns), 0.08 * np.arange(N)], axis=1)
    energies = [force_of(kind, energy, n=20) for kind in KINDS for energy in ENERGIES]
    yield chain(openmm.CustomExternalForce("x^2"), *energies, n=20), helix[:20], constant("S2_2", 1e-6, fast="bonded")
    trap = openmm.CustomExternalForce("x^2")
    trap.addParticle(0)
    yield bonded(trap, *(make() for make in FORMS)), helix, constant("S2_2", 1e-6, fast="bonded", innerSteps=2)
    system, positions = clusters(GRAPHS.values())
    for integrator in (constant("S6_10"), langevin("BAOA")):
        yield system, positions, integrator


def failures():
    """Steps that are far too long, and lines that are no program."""
    integrator = constant("S2_2", 0.1)
    _context = started(*water(8), integrator)
    device = library.Machine(library.library(), integrator)
    for act in (lambda: integrator.step(20), lambda: device.load("sequence a\nrun b")):
        try:
            act()
        except openmm.OpenMMException:
            continue
        raise AssertionError("nothing failed")


def main(path):
    library.BUNDLED = Path(path)
    warnings.simplefilter("ignore")
    for start in itertools.chain(rigid_bodies(), flexible_molecules()):
        moved(*start)
    failures()
    assert library.library().path == Path(path)
    print("moved all")


if __name__ == "__main__":
    main(sys.argv[1])
