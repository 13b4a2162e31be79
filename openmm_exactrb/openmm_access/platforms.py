"""The choice of OpenMM's platform and precision if the user does not create the Context."""

from __future__ import annotations

import os
import re
from functools import cache
from typing import Any

import openmm

_PRECISION = "Precision"
#: Platforms that keep positions and forces on a device.
DEVICES = ("CUDA", "HIP", "OpenCL")
#: Platforms that keep positions and forces in the memory of the processor, in double precision.
PROCESSORS = ("Reference", "CPU")
# Names of CPUs in OpenCL's DeviceName and OpenCLPlatformName: Intel, AMD, Arm and PoCL (pthread-..., cpu-..., basic).
_CPU = re.compile(r"\b(cpu|pthread|basic|core\(tm\)|xeon|pentium|celeron|epyc|ryzen|threadripper|opteron|cortex)", re.I)


def platforms() -> list[openmm.Platform]:
    """Return the available platforms, fastest first."""
    found = [openmm.Platform.getPlatform(i) for i in range(openmm.Platform.getNumPlatforms())]
    return sorted(found, key=lambda platform: -platform.getSpeed())


def platform_of(name: str | openmm.Platform | None = None) -> openmm.Platform:
    """Return the platform with a given name, by default the one in OPENMM_DEFAULT_PLATFORM, or else the fastest.

    The fastest platform is chosen from those that `why_not_by_default` does not exclude.

    Raises
    ------
    ValueError
        If the name is unknown.
    """
    if isinstance(name, openmm.Platform):
        return name
    found = {platform.getName(): platform for platform in platforms()}
    by_case = {known.lower(): known for known in found}
    wanted = name if name is not None else os.environ.get("OPENMM_DEFAULT_PLATFORM")
    if not wanted:
        return next(platform for name, platform in found.items() if not why_not_by_default(name))
    if str(wanted).lower() not in by_case:
        raise ValueError(f"platform {wanted!r} is not available: choose one of {', '.join(found)}")
    return found[by_case[str(wanted).lower()]]


@cache
def why_not_by_default(name: str) -> str | None:
    """Return the reason why a platform is used only if the user names it, or None."""
    if name != "OpenCL":
        return None
    system = openmm.System()
    system.addParticle(1.0)
    try:
        why = no_gpu(openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform(name)))
    except openmm.OpenMMException as error:
        return f"cannot create a Context: {error}"
    return why and f"{why}, where OpenMM's minimiser may crash"


def no_gpu(context: Any) -> str | None:
    """Return the reason why the platform of a Context is not a GPU, or None."""
    platform = context.getPlatform()
    name = platform.getName()
    if name not in DEVICES:
        return f"{name} is not a GPU platform"
    if name != "OpenCL":
        return None
    device, vendor = (platform.getPropertyValue(context, key) for key in ("DeviceName", "OpenCLPlatformName"))
    return f"the OpenCL device {device} is a CPU" if _CPU.search(f"{device} {vendor}") else None


def mixed(platform: openmm.Platform) -> dict[str, str]:
    """Return properties for mixed precision if a platform supports it; single precision loses digits of the energy."""
    return {_PRECISION: "mixed"} if _PRECISION in platform.getPropertyNames() else {}


def rounding(context: Any) -> float:
    """Return a bound of the rounding errors of forces in a Context, relative to the root mean square force."""
    platform = context.getPlatform()
    double = _PRECISION in platform.getPropertyNames() and precision(context) == "double"
    return 1e-9 if double or platform.getName() == "Reference" else 1e-4


def precision(context: Any) -> str:
    """Return whether a Context stores positions in single, mixed or double precision."""
    platform = context.getPlatform()
    if platform.getName() in PROCESSORS:
        return "double"
    return str(platform.getPropertyValue(context, _PRECISION))
