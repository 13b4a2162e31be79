"""Contexts whose steps the host or the device makes, and Systems with all kinds of bodies."""

import copy

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.openmm_access.platforms import DEVICES, platforms

REFERENCE = openmm.Platform.getPlatform("Reference")
# A scheme for each structure of rows: kick first, drift first, displaced places, a processor, and both of these.
STRUCTURES = ("V2", "PEFRL", "Chin4A", "V2_C17", "W4_4")


def gpu_platform(names=DEVICES):
    """Return the first platform of these that has a device here: a GPU, or a CPU for OpenCL. Skip if there is none."""
    present = {platform.getName(): platform for platform in platforms()}
    system = openmm.System()
    system.addParticle(1.0)
    missing = []
    for name in names:
        try:
            openmm.Context(system, openmm.VerletIntegrator(0.001), present[name])
        except KeyError:
            missing.append(f"OpenMM has no platform {name}")
        except openmm.OpenMMException as error:
            missing.append(f"no device for {name}: {error}")
        else:
            return present[name]
    return pytest.skip("; ".join(missing))


def opencl():
    """Return the OpenCL platform where there is a device for it, else skip."""
    return gpu_platform(["OpenCL"])


def context_of(system, positions, engine, *, platform=REFERENCE, precision=None, kelvin=300.0, h=0.001, **options):
    """Return a Context of a copy of a System, with bodies at a temperature."""
    integrator = rb.ExactRigidBodyIntegrator(h, engine=engine, **{"scheme": "S2_2"} | options)
    properties = {"Precision": precision} if precision else {}
    context = openmm.Context(copy.deepcopy(system), integrator, platform, properties)
    context.setPositions(positions)
    context.computeVirtualSites()
    integrator.setVelocitiesToTemperature(kelvin, 1)
    return context


def pair(*arguments, **options):
    """Return Contexts of the host and of the device."""
    return tuple(context_of(*arguments, engine, **options) for engine in ("host", "device"))


def seeded(force):
    """Return a thermostat or barostat of OpenMM with a seed: whether a test passes is no matter of luck."""
    force.setRandomNumberSeed(1)
    return force


def shown(context):
    """Return positions and velocities."""
    state = context.getState(positions=True, velocities=True)
    return np.array([state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value])


def stepped(context, n):
    """Make n steps and return positions and velocities."""
    context.getIntegrator().step(n)
    return shown(context)


def all_kinds():
    """Return a System of water, a linear body, two ions and two named bodies, its positions and the named bodies."""
    _, system, positions = rb.rigid_water(2)
    (nonbonded,) = [force for force in system.getForces() if isinstance(force, openmm.NonbondedForce)]
    places = [tuple(place) for place in positions._value]

    def add(mass, charge, place):
        nonbonded.addParticle(charge, 0.3, 0.5)
        places.append(tuple(place))
        return system.addParticle(mass)

    def apart(particles):
        for k, i in enumerate(particles):
            for j in particles[:k]:
                nonbonded.addException(i, j, 0.0, 1.0, 0.0)

    nitrogen = [add(14.0, 0.1, (0.0, 0.6, 0.0)), add(14.0, -0.1, (0.11, 0.6, 0.0))]
    system.addConstraint(*nitrogen, 0.11)
    ions = [add(23.0, 1.0, (0.0, 0.0, 0.7)), add(35.0, -1.0, (0.0, 0.4, 0.7))]
    linear = [add(12.0, 0.0, (0.8, 0.0, 0.0)), add(16.0, 0.1, (0.8, 0.116, 0.0)), add(16.0, -0.1, (0.8, -0.116, 0.0))]
    corners = 0.06 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    spherical = [add(1.0, 0.1 * (-1) ** k, corner + 0.7) for k, corner in enumerate(corners)] + [
        add(12.0, 0.0, [0.7] * 3)
    ]
    for particles in (nitrogen, linear, spherical):
        apart(particles)
    assert len(ions) == 2
    return system, places, [linear, spherical]
