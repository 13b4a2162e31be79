"""Where tests of an engine run: the host on Reference, the native engine on a GPU, or on the CPU by OpenCL."""

import os
from contextlib import contextmanager
from functools import cache

import openmm
import pytest

import openmm_exactrb as rb
from openmm_exactrb.engines import selection
from openmm_exactrb.library.library import SLOWER, missing
from openmm_exactrb.openmm_access.platforms import DEVICES, platforms

REFERENCE = openmm.Platform.getPlatform("Reference")
CPU = openmm.Platform.getPlatform("CPU")
#: Engines, each where `platform_for` has it run.
HOST_AND_NATIVE = ["host", pytest.param("native", marks=pytest.mark.opencl)]
#: Platforms for which there are kernels, for the fixture `platform`.
PLATFORMS = ["Reference", "CPU", pytest.param("device", marks=pytest.mark.opencl)]
#: Places of the native engine, for the fixture `where`.
WHERE = [pytest.param("native", marks=pytest.mark.opencl), "Reference"]


def device_platform(names=DEVICES):
    """Return the first platform of these that has a device here; skip the test if there is none.

    If OPENMM_DEFAULT_PLATFORM names one of them, it is that one or none.
    """
    names = tuple(name for name in names if name == os.environ.get("OPENMM_DEFAULT_PLATFORM")) or tuple(names)
    found, missing = _first(names)
    return found or pytest.skip(missing)


@contextmanager
def no_library():
    """Create integrators as where there is no library."""
    _begin_with_library()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "adopt", lambda integrator: None)
        yield


@cache
def _begin_with_library():
    """Create a Context with the library, so that all such Contexts have the methods of OpenMM.

    The first integrator without a library replaces these methods for the whole process.
    """
    system = openmm.System()
    system.addParticle(1.0)
    openmm.Context(system, rb.ExactRigidBodyIntegrator(0.001), REFERENCE)


def has_device():
    """Whether a platform has a device here."""
    return _first(tuple(DEVICES))[0] is not None


@cache
def _first(names):
    """Return the first platform of these that has a device, or None and what is missing."""
    present = {platform.getName(): platform for platform in platforms()}
    system = openmm.System()
    system.addParticle(1.0)
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
            return present[name], ""
    return None, "; ".join(missing)


def errors_of(stderr):
    """Return what a process wrote to stderr, without the line that says what a missing library means."""
    return stderr.replace(f"{SLOWER % missing()}\n", "")


def platform_for(engine, precision="double"):
    """Return the platform and its properties for an engine."""
    return (device_platform(), {"Precision": precision}) if engine == "native" else (REFERENCE, {})
