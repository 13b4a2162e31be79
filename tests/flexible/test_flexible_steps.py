"""Flexible molecules in kernels move as on the host: constraints, inner steps, thermostats, and what is refused."""

import copy

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from bonded_terms import tether
from both_engines import apart, nested, pair, twice_from
from openmm_exactrb.engines.native.flexible import blocks
from openmm_exactrb.engines.native.flexible.molecules import require_few_terms
from openmm_exactrb.errors import NotServedError
from peptides import in_water, peptide, violations
from places import device_platform
from starts import held

pytestmark = [pytest.mark.library, pytest.mark.opencl]
# Of the order of summation in the forces, in double precision; of fast forces in single precision and constraints.
DOUBLE, MIXED = 1e-12, 1e-6


def moved(start, make, n=5, **options):
    """Return how far positions (nm) of both engines are apart behind n steps, and the Context of the native engine."""
    _, system, x = start
    host, device = pair(system, x, make, **options)
    for context in (host, device):
        context.getIntegrator().step(2)
        context.getIntegrator().step(n - 2)
    assert device.getIntegrator().getEngine() == "native"
    return apart(host, device), device


@pytest.mark.parametrize(
    ("scheme", "h", "constraints"),
    [
        ("S2_2", 0.004, "HBonds"),
        ("S2_2", 0.002, "None"),
        ("W2_1", 0.002, "AllBonds"),
        ("SRKN4_6b", 0.006, "HAngles"),
        ("SRKN4_6b", 0.006, "HBonds"),
    ],
)
def test_a_peptide_in_water_moves_as_on_the_host(scheme, h, constraints):
    distance, device = moved(in_water(constraints, 30), nested(scheme, h))
    assert distance < DOUBLE
    length, slip = violations(device.getSystem(), *held(device))
    assert length < 1e-13
    assert slip < 1e-11


@pytest.mark.parametrize(("scheme", "constraints"), [("BAOA", "None"), ("W2_3m", "AllBonds")])
def test_noise_is_that_of_the_host(scheme, constraints):
    make = nested(scheme, 0.002, friction=3.0, flexibleFriction=20.0)
    assert moved(in_water(constraints, 30), make)[0] < DOUBLE


@pytest.mark.parametrize(("scheme", "friction"), [("S2_2", None), ("W2_3m", 0.0)])
def test_blocks_with_terms_in_common_move_as_one(scheme, friction, monkeypatch):
    monkeypatch.setattr(blocks, "COST_OF_BLOCK", 150)
    monkeypatch.setattr(blocks, "COST_OF_MOLECULE", 150)
    distance, device = moved(in_water(waters=30), nested(scheme, 0.006, friction))
    assert distance < DOUBLE
    (flexible,) = (part for part in device.getIntegrator()._propagator._assembly.parts if hasattr(part, "blocks"))  # noqa: SLF001
    assert len(flexible.blocks) > 3


def test_blocks_with_terms_in_common_and_water_take_four_launches_a_force(monkeypatch):
    """In mixed precision; in double precision, rigid bodies have a launch of their own."""
    monkeypatch.setattr(blocks, "COST_OF_BLOCK", 150)
    monkeypatch.setattr(blocks, "COST_OF_MOLECULE", 150)
    _, device = moved(in_water(waters=30), nested("BAOA", 0.008, 5.0), precision="mixed")
    machine, launches = device.getIntegrator()._propagator.machine, []  # noqa: SLF001
    for steps in (2, 8):
        before = machine.launches
        device.getIntegrator().step(steps)
        launches.append(machine.launches - before)
    assert launches[1] - launches[0] == 6 * 4


@pytest.mark.parametrize("scheme", ["S2_2", "BAOA", "W2_3m"])
def test_clusters_without_bonded_forces_end_their_steps_as_on_the_host(scheme):
    """Beside a chain with inner steps, which ends a step of BAOA and W2_3m at the heat exchange."""
    system, x = openmm.System(), [[0.15 * k, 0.0, 0.02 * (k % 2)] for k in range(4)]
    bonds, trap = openmm.HarmonicBondForce(), openmm.CustomExternalForce("500*(x^2+2*y^2+3*z^2)")
    x += [[0.0, 1.0, 0.0], [0.1, 1.0, 0.0], [0.0, 1.1, 0.0], [0.0, 1.0, 0.1], [0.0, 2.0, 0.0], [0.0, 2.0, 0.12]]
    for mass in (12.0,) * 4 + (14.0, 1.0, 1.0, 1.0) + (14.0, 16.0):
        trap.addParticle(system.addParticle(mass))
    for k in range(3):
        bonds.addBond(k, k + 1, 0.15, 2e5)
        system.addConstraint(4, 5 + k, 0.1)
    system.addConstraint(8, 9, 0.12)
    for force in (bonds, trap):
        system.addForce(force)
    distance, device = moved((None, system, np.array(x)), nested(scheme, 0.002, friction=0.0), n=10)
    assert distance < DOUBLE
    parts = [part for part in device.getIntegrator()._propagator._assembly.parts if hasattr(part, "blocks")]  # noqa: SLF001
    assert [part.n for part in parts] == [4, 6]


def test_mixed_precision_keeps_lengths_to_roundoff():
    distance, device = moved(in_water(waters=30), nested("S2_2", 0.004), precision="mixed")
    assert distance < MIXED
    assert violations(device.getSystem(), *held(device))[0] < 1e-13


def test_constraints_without_inner_steps():
    assert moved(in_water(waters=30), nested("S2_2", 0.0005, fast=None))[0] < DOUBLE


def test_a_new_step_size_has_its_own_inner_steps():
    _, system, x = in_water(waters=30)
    contexts = pair(system, x, nested("S2_2", 0.001))
    for h in (0.001, 0.006):
        for context in contexts:
            context.getIntegrator().setStepSize(h)
            context.getIntegrator().step(3)
        assert apart(*contexts) < DOUBLE


def test_atoms_without_mass_stay_where_they_are_put():
    _, system, x = in_water("None", 30)
    system.setParticleMass(4, 0.0)
    contexts = pair(system, x, nested("S2_2", 0.002))
    for shift in (0.0, 0.01):
        x = x.copy()
        x[4] += shift
        for context in contexts:
            now = held(context)[0]
            now[4] = x[4]
            context.setPositions(now)
            context.getIntegrator().step(3)
            np.testing.assert_allclose(held(context)[0][4], x[4], atol=1e-14)
        assert apart(*contexts) < DOUBLE


def test_a_checkpoint_continues_to_the_bit_whenever_it_is_loaded():
    """The run that wrote it has its atoms in another order, in which OpenMM sums forces."""
    _, system, x = in_water(waters=30)
    _, device = pair(system, x, nested("W2_3m", 0.006, friction=2.0))
    device.getIntegrator().step(3)
    checkpoint = device.createCheckpoint()
    device.getIntegrator().step(3)
    end = held(device)
    again = twice_from(checkpoint, device, 3)
    np.testing.assert_array_equal(*again)
    np.testing.assert_allclose(again[0], end, rtol=0.0, atol=5e-12)


@pytest.mark.parametrize(
    ("scheme", "friction", "constraints", "of_water"),
    [("S2_2", None, "HBonds", False), ("W2_1", None, "AllBonds", True), ("W2_3m", 5.0, "AllBonds", True)],
)
def test_fast_groups_without_a_kernel_are_openmms(scheme, friction, constraints, of_water):
    """Of periodic forces, or on rigid bodies; their parameter changes in the run."""
    topology, system, x = in_water(constraints, 30)
    atoms = topology.getNumAtoms()
    system.addForce(tether(0, atoms - 3 if of_water else 9))
    assert rb.separate_bonded(system) == 1
    make = nested(scheme, 0.002, friction, fast=(1,), innerSteps=3)
    contexts = pair(system, x, make)
    with pytest.warns(UserWarning, match="no kernel for .*: OpenMM evaluates all forces of the fast groups"):
        contexts[1].getIntegrator().step(1)
    contexts[0].getIntegrator().step(1)
    for pull in (1e3, 2e3):
        for context in contexts:
            context.setParameter("pull", pull)
            context.getIntegrator().step(3)
        assert apart(*contexts) < DOUBLE
    ours, theirs = (context.getIntegrator().timings.fast_evaluations for context in contexts[::-1])
    assert 0 < ours <= theirs + 8


def test_averages_with_fast_groups_without_a_kernel_are_not_corrected(tmp_path):
    topology, system, x = in_water("HBonds", 30)
    system.addForce(tether(0, 9))
    assert rb.separate_bonded(system) == 1
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002, "W2_3m", engine="native", fast=(1,))
    simulation = app.Simulation(topology, system, integrator, device_platform())
    simulation.context.setPositions(x)
    with pytest.warns(UserWarning, match="no kernel for"), pytest.raises(ValueError, match="use engine='host'"):
        rb.AverageReporter(tmp_path / "frames.csv", 1).describeNextReport(simulation)


def test_the_balance_with_fast_groups_without_a_kernel_is_refused_where_drifts_end_a_step():
    _, system, x = in_water("HBonds", 30)
    system.addForce(tether(0, 9))
    assert rb.separate_bonded(system) == 1
    for scheme in ("BAOAB", "BAOA"):
        integrator = rb.ExactRigidBodyRescalingIntegrator(300.0, 0.1, 0.002, scheme, engine="native", fast=(1,))
        context = openmm.Context(copy.deepcopy(system), integrator, device_platform())
        context.setPositions(x)
        with pytest.warns(UserWarning, match="no kernel for"):
            integrator.step(1)
        if scheme == "BAOAB":
            assert np.isfinite(integrator.effectiveEnergy()._value)
        else:
            with pytest.raises(ValueError, match="it cannot compute the energy at the heat exchange of BAOA"):
                integrator.effectiveEnergy()


def refusal(system, x, **options):
    """Return what the integrator says when the native engine is asked for."""
    integrator = rb.ExactRigidBodyIntegrator(0.002, engine="native", **({"scheme": "S2_2"} | options))
    context = openmm.Context(copy.deepcopy(system), integrator, device_platform())
    context.setPositions(x)
    with pytest.raises(ValueError) as error:  # noqa: PT011  # the sentence is what is tested
        integrator.step(1)
    return str(error.value)


@pytest.mark.parametrize("kind", ["HarmonicBondForce", "HarmonicAngleForce", "PeriodicTorsionForce"])
def test_periodic_bonded_forces_are_named_as_such(kind):
    """The flag keeps them from the kernels, so that the message names it; in a group of their own, OpenMM has them."""
    _, system, x = in_water("HBonds", 30)
    (force,) = (force for force in system.getForces() if type(force).__name__ == kind)
    force.setUsesPeriodicBoundaryConditions(True)
    assert f"{kind}, which uses periodic boundary conditions: put the fast forces" in refusal(system, x, fast="bonded")
    rb.separate_bonded(system)
    contexts = pair(system, x, nested("S2_2", 0.002, fast=(1,)))
    with pytest.warns(UserWarning, match=f"no kernel for the fast force {kind}, which uses periodic boundary"):
        contexts[1].getIntegrator().step(1)
    contexts[0].getIntegrator().step(1)
    assert apart(*contexts) < DOUBLE


def test_a_hub_of_many_terms_is_refused_only_on_a_gpu():
    _, hub, x = peptide()
    (bonds,) = (force for force in hub.getForces() if isinstance(force, openmm.HarmonicBondForce))
    for _ in range(401):
        bonds.addBond(0, 14, 0.5, 1.0)
    distance, device = moved((None, hub, x), nested("S2_2", 0.002))
    assert distance < DOUBLE
    terms = device.getIntegrator()._propagator._served.molecules[0].particles_of_terms  # noqa: SLF001
    require_few_terms(terms, 418)
    with pytest.raises(NotServedError, match=r"particle 0 is in 418 bonded terms, .* supports at most 417 on a GPU"):
        require_few_terms(terms, 417)
