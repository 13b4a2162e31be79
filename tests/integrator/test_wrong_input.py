"""Wrong settings, states and positions: one sentence that names the remedy, and nothing changed."""

import copy
import io
from functools import partial

import mdtraj
import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
import starts
from few_dipoles import simulation_of, snapshot
from places import HOST_AND_NATIVE, REFERENCE, platform_for

# -- wrong input ------------------------------------------------------------------------------------------------


def test_arrays_of_numpy_without_a_dimension_are_numbers():
    """OpenMM takes them too."""
    step, warmth = np.array(2.0) * unit.femtoseconds, np.array(300.0)
    integrator = rb.ExactRigidBodyLangevinIntegrator(warmth * unit.kelvin, np.array(5), forceInterval=step)
    assert integrator.getStepSize()._value == 0.002
    integrator.setTemperature(np.array(310))
    integrator.setStepSize(np.array(0.001))
    assert (integrator.getTemperature()._value, integrator.getStepSize()._value) == (310.0, 0.001)
    with pytest.raises(ValueError, match=r"finite number of ps, not array\(\[0.002\]\)"):
        integrator.setStepSize(np.array([0.002]))


def test_a_force_group_may_be_named_twice():
    integrator = rb.ExactRigidBodyIntegrator(0.002)
    integrator.setIntegrationForceGroups([5, 5])
    assert integrator.getIntegrationForceGroups() == 1 << 5


def test_a_step_that_is_refused_changes_nothing():
    integrator = rb.ExactRigidBodyIntegrator(0.002)
    with pytest.raises(ValueError, match="must be at least 0"):
        integrator.setStepSize(-0.001)
    assert integrator.getStepSize()._value == 0.002
    assert "2 fs" in repr(integrator)
    assert copy.copy(integrator).getStepSize()._value == 0.002


def test_a_step_size_may_have_a_unit():
    assert rb.ExactRigidBodyIntegrator(2.0 * unit.femtosecond).getStepSize()._value == pytest.approx(0.002)


ALL = {
    "constant energy": rb.ExactRigidBodyIntegrator,
    "Langevin": partial(rb.ExactRigidBodyLangevinIntegrator, 300.0, 1.0),
    "rescaling": partial(rb.ExactRigidBodyRescalingIntegrator, 300.0, 1.0),
    "Nosé-Hoover": partial(rb.ExactRigidBodyNoseHooverIntegrator, 300.0, 1.0),
    "hybrid": partial(rb.ExactRigidBodyHybridIntegrator, 300.0, 1.0, stepsPerProposal=3),
}


@pytest.mark.parametrize("name", ALL)
def test_a_force_interval_sets_the_length_of_a_step(name):
    integrator = ALL[name](forceInterval=2.0 * unit.femtosecond, scheme="S2_2")
    forces = 6 if name == "hybrid" else 2
    assert integrator.getStepSize()._value == pytest.approx(0.002 * forces)
    assert copy.copy(integrator).getStepSize() == integrator.getStepSize()


@pytest.mark.parametrize("name", ALL)
def test_a_default_evaluates_forces_once_a_step(name):
    """As OpenMM's integrators do, through `Simulation` with reports; a proposal of hybrid Monte Carlo twice."""
    topology, system, positions = rb.rigid_water(8)
    system.addForce(openmm.CMMotionRemover())
    integrator = ALL[name](0.002, checkDivergence=False)
    simulation = starts.simulation_of(topology, system, integrator, positions, kelvin=300)
    simulation.reporters.append(app.StateDataReporter(io.StringIO(), 100, totalEnergy=True))
    simulation.step(10)
    integrator.timings.reset()
    simulation.step(500)
    assert integrator.getScheme().forces == (2 if name == "hybrid" else 1)
    if name != "hybrid":
        # Again at the start of each call, which has ten steps: for the first kick, or to notice changed forces.
        again = integrator.getScheme().name in ("BAOAB", "W2_1")
        assert integrator.timings.evaluations <= (550 if again else 515)


@pytest.mark.parametrize("engine", HOST_AND_NATIVE)
def test_a_frozen_particle_without_a_position_is_refused(engine):
    system, forces = openmm.System(), openmm.NonbondedForce()
    for mass in (16.0, 0.0, 12.0):
        system.addParticle(mass)
        forces.addParticle(0.0, 0.3, 0.5)
    system.addForce(forces)
    integrator = rb.ExactRigidBodyIntegrator(0.001, engine=engine)
    platform, properties = platform_for(engine)
    x = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [1.0, 0.0, 0.0]])
    context = starts.context_of(system, integrator, x, platform=platform, properties=properties)
    integrator.step(1)
    x[1, 2] = np.nan
    context.setPositions(x)
    with pytest.raises(ValueError, match="the position of particle 1 is not finite"):
        integrator.step(1)


def test_a_blow_up_names_step_and_bodies_and_keeps_what_was(tmp_path):
    simulation = simulation_of()
    x, _ = snapshot(simulation)
    dcd = str(tmp_path / "run.dcd")
    simulation.reporters.append(app.DCDReporter(dcd, 1))
    simulation.step(2)
    x, _ = snapshot(simulation)
    x[5:10] += x[3] - x[8]  # the centre of body 1 on that of body 0, up to roundoff
    simulation.context.setParameter("soft_repulsion", 1e250)
    simulation.context.setPositions(x)
    with pytest.raises(rb.NonFiniteError, match=r"step 3,.* body 0 .*bodies 0 and 1,"):
        simulation.step(5)
    assert np.isfinite(snapshot(simulation)[0]).all()
    assert simulation.context.getStepCount() == 2
    simulation.reporters.clear()
    with (tmp_path / "run.pdb").open("w") as file:
        app.PDBFile.writeFile(simulation.topology, x * unit.nanometer, file)
    assert len(mdtraj.load(dcd, top=str(tmp_path / "run.pdb"))) == 2


def test_places_that_leave_the_numbers_in_a_last_drift_are_a_blow_up_too():
    """No kick follows that drift in the step, and there may be no force that would notice."""
    _, system, positions = rb.dipole_fluid(2)
    while system.getNumForces():
        system.removeForce(0)
    integrator = rb.ExactRigidBodyIntegrator(1e4, scheme="V2_drift")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    context.setVelocities([openmm.Vec3(2e150, 0.0, 0.0)] * system.getNumParticles())  # 1e154 in half a step
    with pytest.raises(rb.NonFiniteError, match="step 1, after 0 ps: positions or momenta became non-finite"):
        integrator.step(1)
    assert np.isfinite(context.getState(positions=True).getPositions(asNumpy=True)._value).all()


def test_a_step_far_too_large_stops_when_bodies_fly_apart():
    """Their energy is absurd and finite, and they would never meet again."""
    _, system, positions = rb.dipole_fluid(125, seed=3, inertia=(1.88, 1.88, 1.88))
    integrator = rb.ExactRigidBodyIntegrator(0.5, scheme="S6_10")
    context = starts.context_of(system, integrator, positions)
    with pytest.raises(
        rb.NonFiniteError, match=r"step 1, after 0 ps: .* exceeded the speed of light \(bodies affected: \d+\): body"
    ):
        integrator.step(10)
    np.testing.assert_allclose(
        context.getState(positions=True).getPositions(asNumpy=True)._value, positions._value, rtol=0.0, atol=1e-9
    )


@pytest.mark.parametrize("engine", ["host", "native"])
@pytest.mark.parametrize("scheme", ["SRKN4_6b", "V2_C17"])
def test_an_error_in_a_force_leaves_a_state_of_the_bodies(scheme, engine):
    """Between its steps a processed scheme holds another state, which must not be seen."""
    calls, last = [], None

    def springs(state):
        calls.append(None)
        if len(calls) == last:
            raise RuntimeError("not today")
        x = state.getPositions(asNumpy=True)._value
        return 0.5 * float((x * x).sum()), -x

    _, system, positions = rb.dipole_fluid(2, seed=1)
    system.removeForce(0)
    system.addForce(openmm.PythonForce(springs))
    ends = []
    for breaks in (True, False):
        integrator = rb.ExactRigidBodyIntegrator(0.05, scheme=scheme, engine=engine)
        context = starts.context_of(system, integrator, positions)
        integrator.setVelocitiesToTemperature(20.0, 1)
        if breaks:
            last = len(calls) + integrator.getScheme().processing // 2 + 4 * integrator.getScheme().stages
            with pytest.raises(openmm.OpenMMException, match="not today"):
                integrator.step(10)
            done = context.getStepCount()
        elif done:
            integrator.step(done)
        ends.append(context.getState(positions=True).getPositions(asNumpy=True)._value)
        assert context.getTime()._value == pytest.approx(0.05 * done)
    assert done == (0 if integrator.getScheme().processor and engine == "host" else 3)
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-14)
