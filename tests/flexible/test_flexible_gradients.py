"""Force-gradient kicks of flexible molecules in kernels are those of the host: along geodesics, with inner steps."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from bonded_terms import tether
from both_engines import apart, nested, pair, twice_from
from openmm_exactrb.engines.native.flexible import blocks
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.steps.substeps import DRIFT, GradientKick
from peptides import in_water, peptide, violations
from places import WHERE, device_platform
from products import spread_over
from starts import held

pytestmark = pytest.mark.library

# The tolerance (nm) on each platform: OpenCL sums forces in fixed point, and force gradients multiply their rounding.
TOLERANCES = {"native": 2e-12, "Reference": 1e-14}


def assert_as_on_host(start, make, where, n=10):
    """Compare positions of both engines after n steps, and return the Context of the native engine."""
    _, system, x = start
    contexts = pair(system, x, make, platform=where[1])
    begin = held(contexts[0])[0]
    for context in contexts:
        context.getIntegrator().step(2)
        context.getIntegrator().step(n - 2)
    assert contexts[1].getIntegrator().getEngine() == "native"
    assert apart(*contexts) < TOLERANCES[where[0]]
    assert np.abs(held(contexts[1])[0] - begin).max() > 1e-3
    return contexts[1]


CASES = [
    ("TI2", 0.002, "HBonds", None),
    ("Chin4A", 0.004, "HBonds", "bonded"),
    ("Chin4B", 0.002, "AllBonds", "bonded"),
    ("Chin4C", 0.002, "None", "bonded"),
    ("W4_4", 0.004, "HBonds", "bonded"),
    ("W4_4", 0.001, "HAngles", None),
    ("W4_4", 0.001, "AllBonds", None),
    ("V2_gradient_C17", 0.004, "None", "bonded"),
    ("V2_gradient_C17", 0.001, "HAngles", None),
]


# Kernels of a device are compiled for each Context.
@spread_over({"scheme, h, constraints, fast": CASES, "where": [*WHERE, "Reference"]}, indirect=["where"])
def test_a_peptide_in_water_moves_as_on_the_host(scheme, h, constraints, fast, where):
    device = assert_as_on_host(in_water(constraints, 30), nested(scheme, h, fast=fast), where)
    if constraints != "None":
        length, slip = violations(device.getSystem(), *held(device))
        assert length < 1e-13
        assert slip < 1e-11


@spread_over({"scheme": ["Chin4A", "Chin4B"], "where": WHERE}, indirect=["where"])
def test_noise_is_that_of_the_host(scheme, where):
    make = nested(scheme, 0.002, friction=3.0, flexibleFriction=20.0)
    assert_as_on_host(in_water("AllBonds", 30), make, where)


@pytest.mark.opencl
@pytest.mark.parametrize("scheme", ["Chin4B", "W4_4"])
def test_blocks_with_terms_in_common_are_displaced_as_one(scheme, monkeypatch):
    monkeypatch.setattr(blocks, "COST_OF_BLOCK", 150)
    monkeypatch.setattr(blocks, "COST_OF_MOLECULE", 150)
    device = assert_as_on_host(in_water(waters=30), nested(scheme, 0.004), ("native", device_platform()))
    (part,) = (part for part in device.getIntegrator()._propagator._assembly.parts if hasattr(part, "blocks"))  # noqa: SLF001
    assert len(part.blocks) > 3


@pytest.mark.filterwarnings("ignore:the native engine has no kernel for")
@spread_over(
    {
        "scheme, constraints": [("Chin4A", "HBonds"), ("Chin4B", "AllBonds"), ("W4_4", "HAngles")],
        "where": [*WHERE, "Reference"],
    },
    indirect=["where"],
)
def test_displaced_forces_are_slow_forces_where_openmm_evaluates_the_fast_ones(scheme, constraints, where):
    topology, system, x = in_water(constraints, 30)
    system.addForce(tether(0, topology.getNumAtoms() - 3))
    assert rb.separate_bonded(system) == 1
    assert_as_on_host((None, system, x), nested(scheme, 0.002, fast=(1,), innerSteps=3), where)


def test_atoms_without_mass_are_not_displaced(where):
    _, system, x = in_water("None", 30)
    system.setParticleMass(4, 0.0)
    device = assert_as_on_host((None, system, x), nested("Chin4B", 0.002), where)
    np.testing.assert_allclose(held(device)[0][4], x[4], atol=1e-14)


def test_a_processed_run_continues_to_the_bit(where):
    """With the forces and the force gradients that its output uses."""
    _, system, x = in_water("AllBonds", 30)
    _, device = pair(system, x, nested("W4_4", 0.001, fast=None), platform=where[1])
    device.getIntegrator().step(4)
    checkpoint = device.createCheckpoint()
    np.testing.assert_array_equal(*twice_from(checkpoint, device, 1))


@spread_over({"constraints": ["HBonds", "AllBonds", "None"], "where": WHERE}, indirect=["where"])
def test_displacements_that_are_too_long_fail_loudly(constraints, where):
    _, system, x = peptide(constraints)
    scheme = Scheme("far", 2, ((GradientKick(1e12), 1.0), (DRIFT, 1.0)))
    _, device = pair(system, x, nested(scheme, 0.002, fast=None), platform=where[1])
    before = held(device)
    with pytest.raises(rb.IntegrationError):
        device.getIntegrator().step(3)
    np.testing.assert_array_equal(held(device), before)


def test_a_long_cluster_is_displaced_along_its_geodesic(where):
    """Of more atoms than a GPU supports."""
    rng, system, trap = np.random.default_rng(4), openmm.System(), openmm.CustomExternalForce("40*(x^2+2*y^2+3*z^4)")
    x = np.cumsum(rng.normal(0.0, 0.07, (50, 3)), axis=0)
    for i in range(len(x)):
        trap.addParticle(system.addParticle(1.0 + 12.0 * (i % 2)))
        if i:
            system.addConstraint(i - 1, i, float(np.linalg.norm(x[i] - x[i - 1])))
    system.addForce(trap)
    assert_as_on_host((None, system, x), nested("W4_4", 0.004, fast=None), where)
