"""Nosé-Hoover chains keep their bits, in new Contexts, checkpoints and runs, and are never read from other numbers."""

import openmm
import pytest

import openmm_exactrb as rb
from chains import H, nose_hoover
from starts import droplet_of
from thermostatted import load, saved, snapshot


def test_chains_outlive_a_reinitialisation():
    run = droplet_of(nose_hoover())
    run.integrator.step(6)
    before = run.integrator.effectiveEnergy()._value
    run.context.reinitialize(preserveState=True)
    assert run.integrator.effectiveEnergy()._value == pytest.approx(before, rel=1e-12)


def test_a_step_that_fails_leaves_the_chains_of_the_step_before():
    run, twin = droplet_of(nose_hoover()), droplet_of(nose_hoover())
    for each in (run, twin):
        each.integrator.step(5)
    run.integrator.setStepSize(1e3)
    with pytest.raises(rb.IntegrationError):
        run.integrator.step(1)
    run.integrator.setStepSize(H)
    for each in (run, twin):
        each.integrator.step(5)
    assert snapshot(run) == snapshot(twin)


# Whose checkpoints are rows of other numbers.
def langevin(engine="host"):
    return rb.ExactRigidBodyLangevinIntegrator(30.0, 2.0, H, engine=engine)


OTHERS = {
    "Langevin": langevin,
    "Langevin, auto": lambda: langevin("auto"),
    "constant energy": lambda: rb.ExactRigidBodyIntegrator(H, scheme="S2_2"),
    "processed": lambda: rb.ExactRigidBodyIntegrator(H, scheme="W4_4"),
    "shorter": lambda: nose_hoover(chainLength=2),
    "longer": lambda: nose_hoover(chainLength=4),
    "together": lambda: nose_hoover(together=True),
    "as many numbers": lambda: nose_hoover(together=True, chainLength=6),
}


@pytest.mark.parametrize("kind", ["checkpoint", "State"])
@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("there", [True, False], ids=["there", "back"])
def test_a_chain_is_never_read_from_other_numbers(other, there, kind):
    """Nor they from a chain: OpenMM puts the numbers of a checkpoint into any variables, in their order.

    States have names, and those of variables that an integrator does not have are refused when the State is loaded.
    """
    makers = (nose_hoover, OTHERS[other]) if there else (OTHERS[other], nose_hoover)
    source, target = (droplet_of(make()) for make in makers)
    for run in (source, target):
        run.integrator.step(4)
    good, bad = saved(target.context, kind), saved(source.context, kind)
    target.integrator.step(3)
    expected, refusals = snapshot(target), []

    def use_bad(how):
        load(target.context, kind, bad)
        how()

    for how in (lambda: target.integrator.step(1), target.integrator.temperatures):
        with pytest.raises((ValueError, openmm.OpenMMException)) as refusal:
            use_bad(how)
        refusals.append(str(refusal.value))
    assert all("is from another kind of integrator" in text for text in refusals)
    load(target.context, kind, good)
    target.integrator.step(3)
    parted = kind == "State" and "Langevin" in type(target.integrator).__name__  # it goes on with noise of its own
    assert (snapshot(target) == expected) != parted


def test_equilibration_at_a_langevin_thermostat_is_handed_over_without_its_numbers():
    first = droplet_of(langevin())
    first.integrator.step(5)
    second = droplet_of(nose_hoover())
    rb.loadState(second, first.context.getState(positions=True, velocities=True, integratorParameters=True))
    assert snapshot(second) == snapshot(first)
    second.integrator.step(2)
    assert second.context.getStepCount() == 7
