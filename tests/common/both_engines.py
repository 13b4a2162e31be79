"""Contexts of both engines for the same start, and how far they are apart."""

import copy

import numpy as np

import openmm_exactrb as rb
import starts
from openmm_exactrb.openmm_access.platforms import DEVICES
from places import device_platform
from starts import held


def maker(scheme=None, h=0.002, friction=None, seed=5, **options):
    """Return a function of an engine that makes integrators: at 300 K, if there is a friction."""

    def make(engine):
        if friction is None:
            return rb.ExactRigidBodyIntegrator(h, scheme, engine=engine, **options)
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, friction, h, scheme, engine=engine, **options)
        integrator.setRandomNumberSeed(seed)
        return integrator

    return make


def nested(scheme, h, friction=None, **options):
    """Return what makes integrators with inner steps."""
    return maker(scheme, h, friction, **{"fast": "bonded"} | options)


def begun(system, positions, integrator, *, precision="double", kelvin=300.0, platform=None):
    """Return a Context of a copy of a System, on a device or a platform, with bodies at a temperature."""
    platform = platform or device_platform()
    properties = {"Precision": precision} if platform.getName() in DEVICES else {}
    context = starts.context_of(copy.deepcopy(system), integrator, positions, platform=platform, properties=properties)
    context.computeVirtualSites()
    if kelvin is not None:
        integrator.setVelocitiesToTemperature(kelvin, 1)
    return context


def pair(system, positions, make, **options):
    """Return Contexts of integrators make(engine=...) of host and kernels, from one start on one platform."""
    host, kernels = (
        begun(system, positions, make(engine=engine), kelvin=None, **options) for engine in ("host", "native")
    )
    host.getIntegrator().setVelocitiesToTemperature(300.0, 1)
    starts.put(kernels, host.getState(positions=True, velocities=True))
    return host, kernels


def apart(one, other):
    """Return how far positions (nm) of two Contexts are apart at most."""
    return np.abs(held(one)[0] - held(other)[0]).max()


def twice_from(checkpoint, context, n):
    """Return where n steps from a checkpoint end, twice."""
    ends = []
    for _ in range(2):
        context.loadCheckpoint(checkpoint)
        context.getIntegrator().step(n)
        ends.append(held(context))
    return ends
