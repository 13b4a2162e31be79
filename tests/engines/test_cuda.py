"""Every kernel compiles for CUDA without spilling registers, on machines without a GPU too."""

from types import SimpleNamespace

import cuda
import openmm
import pytest

import openmm_exactrb as rb
from alchemical import alchemical
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines.native.assembly import Assembly
from openmm_exactrb.schemes.catalogue import scheme_for_thermostat
from openmm_exactrb.thermostats import Langevin, NoseHooverChain, StochasticRescaling
from peptides import in_water
from places import device_platform
from zoo import every_kind, water

pytestmark = pytest.mark.library

# Each precision and each kind of GPU once; all combinations with --validate.
BUILDS = pytest.mark.parametrize(
    ("precision", "arch"),
    [
        pytest.param(precision, arch, marks=[] if i == j else pytest.mark.validate)
        for i, precision in enumerate(("single", "mixed", "double"))
        for j, arch in enumerate(("80", "90", "120"))
    ],
)
UPDATES = SimpleNamespace(has_thermostats=True, removes_motion=True)


def sources(scheme, thermostat, start):
    system, positions, *named = start
    bodies = find_bodies(system, positions, *named)
    steps = scheme if thermostat is None else thermostat.steps(scheme)
    launches = Assembly(bodies, steps, UPDATES, True, thermostat).program.launches
    return dict.fromkeys(launch.source.text for launch in launches)


def of_flexible(scheme, constraints, precision, changed=lambda system: system):
    """Return the kernels of a peptide in water with inner steps, of a changed System."""
    _, system, x = in_water(constraints, 30)
    settings = {"scheme": scheme, "engine": "native", "fast": "bonded"}
    if scheme in rb.SCHEMES:
        integrator = rb.ExactRigidBodyIntegrator(0.002, **settings)
    else:
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 3.0, 0.002, **settings)
    context = openmm.Context(changed(system), integrator, device_platform(), {"Precision": precision})
    context.setPositions(x)
    integrator.step(0)
    launches = integrator._propagator._assembly.program.launches  # noqa: SLF001
    return dict.fromkeys(launch.source.text for launch in launches)


def assert_none_spills(texts, arch, precision, folder):
    for text in texts:
        found = cuda.needs(cuda.as_compiled(text, precision), arch, folder)
        assert found
        assert {name: spilled for name, (_, spilled) in found.items() if spilled} == {}


@BUILDS
@pytest.mark.parametrize(
    ("scheme", "thermostat", "start"),
    [
        ("W2_1", None, water(8)),
        ("W4_4", None, every_kind()),
        ("BAOA", Langevin(300.0, 1.0), every_kind()),
        ("BAOA", StochasticRescaling(300.0, 1.0), water(8)),
        ("S2_2", NoseHooverChain(300.0, 1.0), water(8)),
    ],
    ids=["water", "every kind", "friction", "rescaling", "chain"],
)
def test_kernels_compile_for_cuda_and_spill_nothing(scheme, thermostat, start, precision, arch, tmp_path):
    assert_none_spills(sources(scheme_for_thermostat(scheme), thermostat, start), arch, precision, tmp_path)


@pytest.mark.opencl
@BUILDS
@pytest.mark.parametrize(("scheme", "constraints"), [("W2_3m", "HBonds"), ("BAOA", "AllBonds"), ("W4_4", "HAngles")])
def test_inner_steps_compile_for_cuda_and_spill_nothing(scheme, constraints, precision, arch, tmp_path):
    cuda.installed("nvidia/cuda_nvcc/bin/ptxas")
    assert_none_spills(of_flexible(scheme, constraints, precision), arch, precision, tmp_path)


@pytest.mark.opencl
@BUILDS
def test_custom_forces_compile_for_cuda_and_spill_nothing(precision, arch, tmp_path):
    cuda.installed("nvidia/cuda_nvcc/bin/ptxas")
    assert_none_spills(of_flexible("BAOA", "HBonds", precision, alchemical), arch, precision, tmp_path)
