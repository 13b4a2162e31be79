"""Every kernel compiles for CUDA without spilling registers, on machines without a GPU too."""

from types import SimpleNamespace

import cuda
import pytest
from zoo import every_kind, water

from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.engines.device.assembly import Assembly
from openmm_exactrb.schemes.catalogue import scheme_for_thermostat
from openmm_exactrb.thermostats import NoseHooverChain, StochasticRescaling

UPDATES = SimpleNamespace(pushes=True, removes_motion=True, moves=True)


def sources(scheme, thermostat, start):
    system, positions, *named = start
    bodies = find_bodies(system, positions, *named)
    factors = None if thermostat is None else thermostat.factors
    steps = scheme if thermostat is None else thermostat.steps(scheme)
    launches = Assembly(bodies, steps, UPDATES, True, factors).program.launches
    return dict.fromkeys(launch.source.text for launch in launches)


@pytest.mark.parametrize("arch", ["80", "90", "120"])
@pytest.mark.parametrize("precision", ["single", "mixed", "double"])
@pytest.mark.parametrize(
    ("scheme", "thermostat", "start"),
    [
        ("W2_1", None, water(8)),
        ("W4_4", None, every_kind()),
        ("BAOA", StochasticRescaling(300.0, 1.0), water(8)),
        ("S2_2", NoseHooverChain(300.0, 1.0), water(8)),
    ],
    ids=["water", "every kind", "rescaling", "chain"],
)
def test_kernels_compile_for_cuda_and_spill_nothing(scheme, thermostat, start, precision, arch, tmp_path):
    for text in sources(scheme_for_thermostat(scheme), thermostat, start):
        found = cuda.needs(cuda.as_compiled(text, precision), arch, tmp_path)
        assert found
        assert {name: spilled for name, (_, spilled) in found.items() if spilled} == {}
