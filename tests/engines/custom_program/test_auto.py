"""The rule of engine="auto", and how a run keeps its engine."""

import copy
from dataclasses import dataclass

import numpy as np
import openmm
import pytest
from devices import REFERENCE, gpu_platform, opencl, shown, stepped
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.command.main import main
from openmm_exactrb.openmm_access import platforms
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.substeps import Kick
from peptides import peptide

S2_2 = rb.SCHEMES["S2_2"]


@pytest.fixture(scope="module")
def platform():
    return gpu_platform()


@pytest.fixture(scope="module")
def water():
    return rb.rigid_water(4)


@pytest.fixture
def gpu(monkeypatch):
    """Have the rule take PoCL, or the Reference platform, for a GPU."""
    monkeypatch.setattr(platforms, "no_gpu", lambda context: None)


def auto(water, platform, thermostat=False, precision="double", engine="auto", scheme="S2_2"):
    """Return a Simulation whose engine is selected."""
    topology, system, positions = water
    if thermostat:
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 1.0, 0.001, scheme, engine=engine)
        integrator.setRandomNumberSeed(7)
    else:
        integrator = rb.ExactRigidBodyIntegrator(0.001, scheme, engine=engine)
    properties = {"Precision": precision} if "Precision" in platform.getPropertyNames() else {}
    simulation = app.Simulation(topology, copy.deepcopy(system), integrator, platform, properties)
    simulation.context.setPositions(positions)
    return simulation


class Platform:
    """A platform of OpenMM that has a name and reports properties."""

    def __init__(self, name, device="", vendor=""):
        self.name, self.properties = name, {"DeviceName": device, "OpenCLPlatformName": vendor}

    def getPlatform(self):
        return self

    def getName(self):
        return self.name

    def getPropertyValue(self, context, name):
        return self.properties[name]


@pytest.mark.parametrize(
    "platform",
    [
        ("CUDA", "Intel(R) Xeon(R)"),
        ("HIP",),
        ("OpenCL", "NVIDIA A100-SXM4-40GB", "NVIDIA CUDA"),
        ("OpenCL", "NVIDIA A100-SXM4-40GB", "Portable Computing Language"),
        ("OpenCL", "gfx90a:sramecc+:xnack-", "AMD Accelerated Parallel Processing"),
        ("OpenCL", "AMD Radeon(TM) Graphics", "AMD Accelerated Parallel Processing"),
        ("OpenCL", "Intel(R) Arc(TM) A770 Graphics", "Intel(R) OpenCL Graphics"),
        ("OpenCL", "Apple M2 Max", "Apple"),
    ],
)
def test_gpus_are_recognised(platform):
    assert platforms.no_gpu(Platform(*platform)) is None


@pytest.mark.parametrize(
    "platform",
    [
        ("Reference",),
        ("CPU",),
        ("OpenCL", "pthread-skylake-avx512-AMD EPYC", "Portable Computing Language"),
        ("OpenCL", "cpu-haswell-Intel(R) Core(TM) i7-4790", "Portable Computing Language"),
        ("OpenCL", "cpu-cortex-a76", "Portable Computing Language"),
        ("OpenCL", "Intel(R) Core(TM) Ultra 7 155H", "Intel(R) OpenCL"),
        ("OpenCL", "Intel(R) Xeon(R) CPU E5-2670 0 @ 2.60GHz", "Intel(R) CPU Runtime for OpenCL(TM) Applications"),
        ("OpenCL", "AMD Ryzen 7 5800H with Radeon Graphics", "AMD Accelerated Parallel Processing"),
        ("OpenCL", "NVIDIA A100-SXM4-40GB,AMD EPYC 7543", "AMD Accelerated Parallel Processing"),
    ],
)
def test_cpus_are_recognised(platform):
    assert isinstance(platforms.no_gpu(Platform(*platform)), str)


@pytest.mark.parametrize("engine", ["host", "device"])
def test_a_checkpoint_keeps_its_engine_with_auto_and_is_refused_by_the_other_one(engine, water):
    _, system, positions = water
    contexts = {}
    for name in ("host", "device", "auto"):
        integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2", engine=name)
        contexts[name] = openmm.Context(copy.deepcopy(system), integrator, REFERENCE)
        contexts[name].setPositions(positions)
        integrator.step(1)
    assert contexts["auto"].getIntegrator().getEngine() == "host"
    checkpoint, x = contexts[engine].createCheckpoint(), stepped(contexts[engine], 3)
    contexts["auto"].loadCheckpoint(checkpoint)
    np.testing.assert_allclose(stepped(contexts["auto"], 3), x, rtol=0.0, atol=1e-12)
    assert contexts["auto"].getIntegrator().getEngine() == engine
    other = contexts["host" if engine == "device" else "device"]
    other.loadCheckpoint(checkpoint)
    with pytest.raises(ValueError, match=f'of a run with engine="{engine}"'):
        other.getIntegrator().step(1)


def test_copies_are_as_undecided_as_their_original(water):
    _, system, positions = water
    integrator = rb.ExactRigidBodyIntegrator(0.001, "S2_2")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    integrator.step(1)
    assert copy.copy(integrator).getSettings() == integrator.getSettings()
    assert integrator.getSettings()["arguments"]["engine"] == "auto"


@pytest.mark.opencl
def test_an_opencl_device_that_is_a_cpu_is_the_hosts_unless_the_device_is_asked_for(water):
    platform = opencl()
    simulation = auto(water, platform, precision="mixed")
    if "Portable" not in platform.getPropertyValue(simulation.context, "OpenCLPlatformName"):
        pytest.skip("OpenCL is not PoCL here")
    assert simulation.integrator.getEngine() == "host"
    assert "CPU" in simulation.integrator.engineNote()
    named = auto(water, platform, engine="device")
    named.step(1)
    assert named.integrator.getEngine() == "device"


@pytest.mark.opencl
def test_an_opencl_device_that_is_a_cpu_is_taken_only_if_it_is_named(monkeypatch, capsys):
    """OpenMM's minimiser crashes the process on PoCL."""
    opencl()
    monkeypatch.delenv("OPENMM_DEFAULT_PLATFORM", raising=False)
    monkeypatch.setattr(platforms, "no_gpu", lambda context: "it is a CPU")
    assert platforms.platform_of().getName() != "OpenCL"
    assert platforms.platform_of("OpenCL").getName() == "OpenCL"
    assert main(["info"]) == 0
    assert "used only if named: it is a CPU" in capsys.readouterr().out


def test_the_program_comes_behind_the_same_objects(gpu, water):
    simulation = auto(water, REFERENCE, True)
    context, integrator = simulation.context, simulation.integrator
    context.setTime(3.0)
    context.setStepCount(10)
    simulation.step(5)
    assert integrator.getEngine() == "device"
    assert simulation.context is context
    assert context.getIntegrator() is integrator
    assert (context.getStepCount(), simulation.currentStep) == (15, 15)
    assert context.getTime()._value == pytest.approx(3.005)
    other = auto(water, REFERENCE, True, engine="device")
    other.context.setStepCount(10)
    np.testing.assert_array_equal(stepped(other.context, 5), shown(context))
    np.testing.assert_array_equal(stepped(other.context, 4), stepped(context, 4))
    context.reinitialize(preserveState=True)
    np.testing.assert_allclose(stepped(context, 4), stepped(other.context, 4), rtol=0.0, atol=1e-9)


@pytest.mark.opencl
def test_a_checkpoint_of_the_host_stays_with_the_host_on_a_gpu(gpu, platform, water):
    """With noise, whose seed the checkpoint brings along."""
    host = auto(water, platform, True, engine="host")
    host.step(3)
    checkpoint, x = host.context.createCheckpoint(), stepped(host.context, 1)
    again = auto(water, platform, True)
    again.context.loadCheckpoint(checkpoint)
    np.testing.assert_allclose(stepped(again.context, 1), x, rtol=0.0, atol=1e-8)
    assert again.integrator.getEngine() == "host"
    assert again.integrator.getSeedInUse() == 7


def test_a_run_in_a_folder_continues_with_its_engine_and_its_bits(gpu, water, tmp_path):
    whole = auto(water, REFERENCE, True)
    rb.Run(tmp_path / "whole").advance(whole, 8)
    rb.Run(tmp_path / "parts").advance(auto(water, REFERENCE, True), 3)
    simulation = auto(water, REFERENCE, True)
    rb.Run(tmp_path / "parts", resume=True).advance(simulation, 8)
    assert simulation.integrator.getEngine() == whole.integrator.getEngine() == "device"
    # A call evaluates the forces of its first positions anew, on the device in sums of another order.
    np.testing.assert_allclose(shown(simulation.context), shown(whole.context), rtol=0.0, atol=1e-12)
    with pytest.raises(ValueError, match="engine is"):
        rb.Run(tmp_path / "parts", resume=True).advance(auto(water, REFERENCE, True, engine="host"), 10)


@pytest.mark.opencl
def test_single_precision_is_the_hosts_and_refused_to_the_device(gpu, platform, water):
    simulation = auto(water, platform, precision="single")
    assert simulation.integrator.getEngine() == "host"
    assert "Precision" in simulation.integrator.engineNote()
    with pytest.raises(ValueError, match="Precision"):
        auto(water, platform, precision="single", engine="device").step(1)


@pytest.mark.opencl
def test_single_precision_is_warned_of_once(platform, water):
    simulation = auto(water, platform, precision="single")
    with pytest.warns(UserWarning, match=r'"Precision": "mixed"'):
        simulation.step(1)
    simulation.context.reinitialize(preserveState=True)
    simulation.step(1)
    auto(water, platform, precision="mixed").step(1)


@pytest.mark.opencl
@pytest.mark.parametrize("name", ["c", "exactrb_turns", "v"])
def test_parameters_with_the_names_of_the_program_are_the_hosts(name, gpu, platform, water):
    topology, system, positions = copy.deepcopy(water)
    force = openmm.CustomExternalForce(f"{name}*x")
    force.addGlobalParameter(name, 1.0)
    force.addParticle(0)
    system.addForce(force)
    simulation = auto((topology, system, positions), platform)
    assert simulation.integrator.getEngine() == "host"
    assert "parameter" in simulation.integrator.engineNote()
    simulation.step(1)


@pytest.mark.opencl
def test_substeps_of_ones_own_are_the_hosts(gpu, platform, water):
    """Also those that derive from a substep of the package: the program has no kernels but its own."""
    bound = []

    @dataclass(frozen=True)
    class Mine(Kick):
        def bind(self, environment):
            bound.append(self)
            return super().bind(environment)

        def device_rows(self, part):
            return None

    sequence = tuple((Mine() if isinstance(substep, Kick) else substep, part) for substep, part in S2_2.sequence)
    integrator = (simulation := auto(water, platform, scheme=Scheme("mine", 2, sequence))).integrator
    assert integrator.getEngine() == "host"
    assert "substep" in integrator.engineNote()
    simulation.step(1)
    assert bound == [Mine()]
    assert auto(water, platform).integrator.getEngine() == "device"


def test_inner_steps_are_the_hosts_unless_the_device_is_named_or_began(gpu):
    """A flexible molecule, until steps get so long that bonded forces need steps of their own."""
    topology, system, positions = peptide("None")
    simulation = auto((topology, system, positions), REFERENCE)
    integrator = simulation.integrator
    integrator.setStepSize(0.0005)
    integrator.setVelocitiesToTemperature(300.0, 1)
    simulation.step(20)
    assert integrator.getEngine() == "device"
    energy = integrator.totalEnergy()._value
    integrator.setStepSize(0.004)
    assert integrator.getEngine() == "device"
    fresh = auto((topology, system, positions), REFERENCE)
    fresh.integrator.setStepSize(0.004)
    assert fresh.integrator.getEngine() == "host"
    assert "inner steps" in fresh.integrator.engineNote()
    assert integrator.totalEnergy()._value == pytest.approx(energy, abs=1e-4)
    simulation.step(20)
    assert integrator.timings.fast_evaluations > 0
    assert integrator.totalEnergy()._value == pytest.approx(energy, abs=2.0)
