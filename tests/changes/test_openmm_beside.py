"""What OpenMM does beside us: barostats, parameters, reinitialize, checkpoints, reporters, platforms; equilibrium."""

import mdtraj
import numpy as np
import openmm
import pytest
from openmm import app, unit
from scipy import stats

import openmm_exactrb as rb
from places import CPU, REFERENCE
from starts import periodic_water, positions_of, simulation_of, warm

pytestmark = pytest.mark.usefixtures("every_engine")

# -- what OpenMM does beside us ---------------------------------------------------------------------------------


def test_a_shift_by_the_barostat_keeps_attitudes_to_the_bit():
    topology, system, positions = periodic_water(125)
    simulation = warm(topology, system, positions, platform=CPU)
    simulation.step(1)
    _, before = simulation.integrator.bodyState()
    simulation.context.setPositions(positions_of(simulation) + 0.25)
    _, after = simulation.integrator.bodyState()
    np.testing.assert_array_equal(after.q, before.q)
    np.testing.assert_array_equal(after.m, before.m)
    np.testing.assert_array_equal(after.P, before.P)
    np.testing.assert_allclose(after.R, before.R + 0.25, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("scheme", ["V2", "PEFRL", "Chin4A", "V2_C17", "W4_4"])
def test_parameters_of_the_context_count_from_the_next_step_on(scheme):
    """With a scheme for each structure of steps: kick first, drift first, displaced forces, a processor, and both."""
    topology, system, positions = rb.rigid_water(4)
    pull = openmm.CustomExternalForce("-strength*x")
    pull.addGlobalParameter("strength", 0.0)
    for i in range(0, 12, 3):
        pull.addParticle(i, [])
    system.addForce(pull)
    momenta = []
    for strength in (0.0, 7.0):
        simulation = warm(topology, system, positions, scheme=scheme)
        simulation.context.setVelocities(np.zeros((12, 3)))
        simulation.step(1)
        simulation.context.setParameter("strength", strength)
        simulation.step(1)
        momenta.append(simulation.integrator.bodyState()[1].P.sum(axis=1))
    # Four oxygens, one step of 2 fs at the full strength: the first kick included.
    np.testing.assert_allclose(momenta[1] - momenta[0], [4 * 7.0 * 0.002, 0.0, 0.0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("platform", [REFERENCE, CPU], ids=["Reference", "CPU"])
def test_a_step_far_too_large_names_the_bodies_and_keeps_the_last_good_state(platform):
    simulation = warm(*rb.rigid_water(27), h=0.5, scheme="SRKN4_6b", platform=platform)
    with pytest.raises(rb.IntegrationError, match=r"bodies \d+ and \d+") as error:
        simulation.step(50)
    assert error.match(f"step {simulation.context.getStepCount() + 1},")
    assert np.isfinite(positions_of(simulation)).all()


def test_reinitialize_continues_right():
    runs = [warm(*rb.rigid_water(4)) for _ in range(2)]
    for simulation in runs:
        simulation.step(10)
    runs[1].context.reinitialize(preserveState=True)
    for simulation in runs:
        simulation.step(10)
    np.testing.assert_array_equal(*map(positions_of, runs))


def test_forces_added_before_reinitialize_take_part():
    """The box shrank and the molecules stayed."""
    simulation = warm(*periodic_water(125, nonbondedMethod=app.CutoffPeriodic), platform=CPU)
    simulation.step(1)
    barostat = openmm.MonteCarloBarostat(1e4 * unit.bar, 300.0 * unit.kelvin, 1)
    barostat.setRandomNumberSeed(1)
    simulation.system.addForce(barostat)
    simulation.system.addForce(openmm.CMMotionRemover(1))
    simulation.integrator.setRandomNumberSeed(1)  # on CPU the barostat draws from it
    simulation.context.reinitialize(preserveState=True)
    assert simulation.integrator.degreesOfFreedom() == (3 * 125 - 3, 3 * 125)

    def edge():
        return simulation.context.getState().getPeriodicBoxVectors()[0][0]._value

    simulation.integrator.setStepSize(1e-7)  # nothing but the barostat moves a molecule
    length, before = edge(), positions_of(simulation)[::3, 0].copy()
    simulation.step(40)
    inner = (0.2 * length < before) & (before < 0.8 * length)  # the barostat brings others back into the box
    scale, _ = np.polyfit(before[inner], positions_of(simulation)[::3, 0][inner], 1)
    assert edge() < 0.995 * length
    assert scale == pytest.approx(edge() / length, abs=5e-4)


def test_constraints_removed_before_reinitialize_leave_particles_free():
    simulation = warm(*rb.rigid_water(4))
    simulation.step(1)
    system = simulation.system
    for i in reversed(range(system.getNumConstraints())):
        if system.getConstraintParameters(i)[0] < 3:
            system.removeConstraint(i)
    simulation.context.reinitialize(preserveState=True)
    assert simulation.integrator.degreesOfFreedom() == (3 * (3 + 3), 3 * 3)
    simulation.step(1)


def opencl_properties():
    names = [openmm.Platform.getPlatform(i).getName() for i in range(openmm.Platform.getNumPlatforms())]
    return "OpenCL" in names


@pytest.mark.opencl
@pytest.mark.skipif(not opencl_properties(), reason="no OpenCL: apt-get install pocl-opencl-icd ocl-icd-libopencl1")
@pytest.mark.parametrize("precision", ["mixed", "double"])
def test_opencl_agrees_with_reference_and_keeps_the_state_in_float64(precision):
    topology, system, positions = rb.rigid_water(8)
    reference = warm(topology, system, positions)
    state = reference.context.getState(positions=True, velocities=True)
    simulation, often = (
        app.Simulation(
            topology,
            system,
            rb.ExactRigidBodyIntegrator(0.002, scheme="S2_2", engine="host"),
            openmm.Platform.getPlatform("OpenCL"),
            {"Precision": precision},
        )
        for _ in range(2)
    )
    for run in (simulation, often):
        run.context.setState(state)
    reference.integrator.step(10)
    simulation.integrator.step(10)
    for _ in range(5):
        often.integrator.step(2)
    # Forces are float32 in mixed precision, and summed in fixed point with 32 bits after the point in either.
    tolerance = 1e-8 if precision == "double" else 1e-6
    for run in (simulation, often):
        np.testing.assert_allclose(positions_of(run), positions_of(reference), rtol=0.0, atol=tolerance)
        x = positions_of(run).reshape(-1, 3, 3)
        np.testing.assert_allclose(np.linalg.norm(x[:, 1] - x[:, 0], axis=1), 0.09572, rtol=0.0, atol=1e-11)
    # The state is not fitted to the platform's positions between calls: both runs agree beyond float32.
    _, state = simulation.integrator.bodyState()
    _, other = often.integrator.bodyState()
    np.testing.assert_allclose(other.R, state.R, rtol=0.0, atol=1e-12 if precision == "double" else 1e-8)


# -- equilibrium ------------------------------------------------------------------------------------------------


@pytest.mark.validate
def test_water_stays_in_equilibrium():
    """NVE from a canonical start: equal temperatures, and the structure of OpenMM's own rigid water.

    The difference of the temperatures is correlated over some 0.2 ps: its error comes from sixteen blocks that are far
    longer. The means of shorter blocks scatter half as much as they should.
    """
    cutoff = 0.85
    options = {"nonbondedCutoff": cutoff * unit.nanometer, "switchDistance": (cutoff - 0.1) * unit.nanometer}
    topology, system, positions = periodic_water(216, **options)
    langevin = openmm.LangevinMiddleIntegrator(300.0, 2.0, 0.002)
    langevin.setRandomNumberSeed(1)
    theirs = simulation_of(topology, system, langevin, positions, platform=CPU)
    theirs.minimizeEnergy()
    theirs.context.setVelocitiesToTemperature(300.0, 1)
    theirs.step(2500)
    integrator = rb.ExactRigidBodyIntegrator(0.006, scheme="S2_3")
    ours = app.Simulation(topology, system, integrator, CPU)
    frames, reference, differences = [], [], []
    ours.context.setState(theirs.context.getState(positions=True))
    integrator.setVelocitiesToTemperature(300.0, 0)
    for _ in range(333):  # 20 ps
        ours.step(10)
        frames.append(positions_of(ours))
        translation, rotation = integrator.temperatures()
        differences.append((translation - rotation)._value)
        theirs.step(30)
        reference.append(positions_of(theirs))
    blocks = [block.mean() for block in np.array_split(differences, 16)]
    assert stats.ttest_1samp(blocks, 0.0).pvalue > 1e-3
    box = np.array([v.value_in_unit(unit.nanometer) for v in system.getDefaultPeriodicBoxVectors()])
    curves = []
    for xyz in (frames, reference):
        trajectory = mdtraj.Trajectory(np.array(xyz, dtype=np.float32), mdtraj.Topology.from_openmm(topology))
        trajectory.unitcell_vectors = np.tile(box, (len(xyz), 1, 1))
        oxygens = trajectory.topology.select("name O")
        pairs = trajectory.topology.select_pairs(oxygens, oxygens)
        halves = np.array_split(np.arange(len(xyz)), 4)
        curves.append([mdtraj.compute_rdf(trajectory[h], pairs, r_range=(0.2, cutoff), n_bins=40)[1] for h in halves])
    ours_rdf, theirs_rdf = (np.array(c) for c in curves)
    error = np.sqrt(ours_rdf.var(axis=0, ddof=1) / 4 + theirs_rdf.var(axis=0, ddof=1) / 4)
    assert np.abs(ours_rdf.mean(axis=0) - theirs_rdf.mean(axis=0)).mean() < 3.0 * error.mean()
    assert ours_rdf.mean(axis=0).max() > 2.0
