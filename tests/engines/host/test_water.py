"""Any System with rigid molecules: water models, ions, linear molecules, bodies by hand, and OpenMM's own tools."""

import subprocess
import sys

import mdtraj
import numpy as np
import openmm
import pytest
from openmm import app, unit
from scipy import stats

import openmm_exactrb as rb

REFERENCE = openmm.Platform.getPlatform("Reference")
CPU = openmm.Platform.getPlatform("CPU")
R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


def start(topology, system, positions, h=0.002, scheme="S2_2", platform=REFERENCE, properties=None, **options):
    """Return a Simulation, minimised and at 300 K."""
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, **options)
    simulation = app.Simulation(topology, system, integrator, platform, properties or {})
    simulation.context.setPositions(positions)
    simulation.minimizeEnergy(tolerance=50)
    simulation.context.setVelocitiesToTemperature(300.0, 3)
    return simulation


def total_energy(simulation):
    state = simulation.context.getState(energy=True)
    return (state.getPotentialEnergy() + state.getKineticEnergy())._value


def positions_of(simulation):
    return simulation.context.getState(positions=True).getPositions(asNumpy=True)._value.copy()


def energy_noise(simulation, n_samples=20, steps=5):
    energies = []
    for _ in range(n_samples):
        simulation.step(steps)
        energies.append(total_energy(simulation))
    return np.std(energies)


# -- molecules --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["tip3p", "spce", "tip4pew", "tip5p", "tip4p2005"])
def test_water_models_run_and_keep_their_energy_and_shape(model):
    topology, system, positions = rb.rigid_water(8, model=model)
    simulation = start(topology, system, positions, h=0.001)
    bodies, _ = simulation.integrator.bodyState()
    assert len(bodies) == bodies.n_turning == 8
    coarse = energy_noise(simulation)
    simulation.integrator.setStepSize(0.0005)
    fine = energy_noise(simulation, steps=10)
    assert fine < coarse
    assert fine / 8 < 5e-3
    x = positions_of(simulation)
    for i in range(system.getNumConstraints()):
        p, q, d = system.getConstraintParameters(i)
        assert abs(np.linalg.norm(x[p] - x[q]) - d._value) < 1e-13
    if model in ("tip4pew", "tip5p", "tip4p2005"):
        assert system.isVirtualSite(3)


def test_the_wrong_water_is_refused():
    with pytest.raises(ValueError, match="choose one of tip3p, spce"):
        rb.rigid_water(2, model="tip2p")
    with pytest.raises(ValueError, match="n must be a whole number of at least 1"):
        rb.rigid_water(0)


@pytest.fixture
def salt_water():
    """Water with two ions beside it: free particles."""
    topology, system, positions = rb.rigid_water(16)
    nonbonded = next(f for f in system.getForces() if isinstance(f, openmm.NonbondedForce))
    x = positions._value
    for k, (mass, charge, sigma, epsilon) in enumerate([(22.99, 1.0, 0.2439, 0.3658), (35.45, -1.0, 0.4478, 0.1489)]):
        system.addParticle(mass)
        nonbonded.addParticle(charge, sigma, epsilon)
        chain = topology.addChain()
        topology.addAtom(
            "ION", app.element.sodium if k == 0 else app.element.chlorine, topology.addResidue("ION", chain)
        )
        x = np.vstack([x, [-0.3 - 0.1 * k, 0.3 + 0.5 * k, 0.3]])
    return topology, system, x


def test_ions_move_beside_rigid_water(salt_water):
    simulation = start(*salt_water, h=0.001)
    bodies, _ = simulation.integrator.bodyState()
    assert (len(bodies), bodies.n_turning) == (18, 16)
    assert simulation.integrator.degreesOfFreedom() == (54, 48)
    coarse = energy_noise(simulation)
    simulation.integrator.setStepSize(0.00025)
    assert energy_noise(simulation, steps=20) < coarse / 5


def linear_molecules(n=27):
    """CO2 as three atoms in line, held by three constraints, with Lennard-Jones interactions and charges."""
    system, topology = openmm.System(), app.Topology()
    force = openmm.NonbondedForce()
    chain, x = topology.addChain(), []
    for k in range(n):
        first = system.getNumParticles()
        residue = topology.addResidue("CO2", chain)
        for name, mass, charge, sigma, epsilon in (
            ("C", 12.011, 0.6512, 0.2757, 0.2339),
            ("O1", 15.999, -0.3256, 0.3033, 0.6693),
            ("O2", 15.999, -0.3256, 0.3033, 0.6693),
        ):
            system.addParticle(mass)
            force.addParticle(charge, sigma, epsilon)
            topology.addAtom(name, app.element.carbon if name == "C" else app.element.oxygen, residue)
        for i, j, d in ((0, 1, 0.1149), (0, 2, 0.1149), (1, 2, 0.2298)):
            system.addConstraint(first + i, first + j, d)
            force.addException(first + i, first + j, 0.0, 1.0, 0.0)
        centre = 0.45 * np.array(np.unravel_index(k, (3, 3, 3)))
        axis = np.roll([0.0, 0.0, 0.1149], k % 3)
        x += [centre, centre + axis, centre - axis]
    system.addForce(force)
    return topology, system, np.array(x)


def test_linear_molecules_have_five_degrees_of_freedom_and_the_right_temperature():
    topology, system, x = linear_molecules()
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme="S2_2")
    simulation = app.Simulation(topology, system, integrator, REFERENCE)
    simulation.context.setPositions(x)
    assert integrator.degreesOfFreedom() == (81, 54)
    samples = []
    for seed in range(200):
        integrator.setVelocitiesToTemperature(250.0 * unit.kelvin, seed)
        samples.append([t._value for t in integrator.temperatures()])
    # A temperature of f degrees of freedom has the relative standard deviation sqrt(2/f).
    for mean, freedom in zip(np.mean(samples, axis=0), (81, 54), strict=True):
        assert abs(mean / 250.0 - 1.0) < 4.0 * np.sqrt(2.0 / freedom / 200)
    coarse = energy_noise(simulation)
    integrator.setStepSize(0.0005)
    assert energy_noise(simulation, steps=20) < coarse / 5
    _, state = integrator.bodyState()
    assert not state.m[0].any()


def test_temperatures_that_are_none_are_refused(salt_water):
    simulation = start(*salt_water)
    integrator = simulation.integrator
    with pytest.raises(ValueError, match="is not a temperature"):
        integrator.setVelocitiesToTemperature(300.0 * unit.nanometer)
    with pytest.raises(ValueError, match="must not be negative"):
        integrator.setVelocitiesToTemperature(-1.0)


def flexible_ring(n_rings=4):
    """Rings of six atoms with bonds and angles but no constraints."""
    system, topology = openmm.System(), app.Topology()
    bonds, angles, pairs = openmm.HarmonicBondForce(), openmm.HarmonicAngleForce(), openmm.NonbondedForce()
    chain, x = topology.addChain(), []
    for ring in range(n_rings):
        residue = topology.addResidue("RNG", chain)
        first = 6 * ring
        for k in range(6):
            system.addParticle(13.0)
            pairs.addParticle(0.0, 0.35, 0.3)
            topology.addAtom(f"C{k}", app.element.carbon, residue)
            phi = np.pi / 3 * k
            x.append([0.14 * np.cos(phi), 0.14 * np.sin(phi), 0.42 * ring])
        for k in range(6):
            i, j, l = (first + (k + d) % 6 for d in range(3))
            bonds.addBond(i, j, 0.139, 3e5)
            angles.addAngle(i, j, l, 2.09, 500.0)
        for i in range(6):
            for j in range(i):
                pairs.addException(first + i, first + j, 0.0, 1.0, 0.0)
    for force in (bonds, angles, pairs):
        system.addForce(force)
    return topology, system, np.array(x)


def test_bodies_given_by_hand_are_rigid_and_their_inner_energy_is_a_constant():
    topology, system, x = flexible_ring()
    rings = [range(6 * k, 6 * k + 6) for k in range(4)]
    integrator = rb.ExactRigidBodyIntegrator(0.002, scheme="SRKN4_6b", bodies=rings)
    simulation = app.Simulation(topology, system, integrator, REFERENCE)
    simulation.context.setPositions(x)
    for group, force in enumerate(system.getForces()):
        force.setForceGroup(group)
    simulation.context.reinitialize(preserveState=True)
    integrator.setVelocitiesToTemperature(200.0, 1)
    inner = [simulation.context.getState(energy=True, groups={0, 1}).getPotentialEnergy()._value]
    energies = [total_energy(simulation)]
    for _ in range(10):
        simulation.step(5)
        inner.append(simulation.context.getState(energy=True, groups={0, 1}).getPotentialEnergy()._value)
        energies.append(total_energy(simulation))
    assert np.ptp(inner) < 1e-9
    assert inner[0] > 1.0
    assert np.ptp(energies) < 1e-6 * np.ptp([e - i for e, i in zip(energies, range(11), strict=True)])
    bodies, _ = integrator.bodyState()
    assert len(bodies.kinds) == 1


def test_a_rigid_cluster_without_all_its_distances_takes_its_shape_from_the_positions(rng):
    system, x = openmm.System(), rng.random((5, 3))
    for _ in range(5):
        system.addParticle(2.0)
    for i in range(5):
        for j in range(i):
            if (i, j) != (4, 0):
                system.addConstraint(j, i, float(np.linalg.norm(x[i] - x[j])))
    integrator = rb.ExactRigidBodyIntegrator(0.01)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(x)
    context.setVelocities(rng.standard_normal((5, 3)))
    integrator.step(50)
    y = context.getState(positions=True).getPositions(asNumpy=True)._value
    assert np.linalg.norm(y[4] - y[0]) == pytest.approx(np.linalg.norm(x[4] - x[0]), rel=1e-13)


def test_particles_without_mass_stay_where_they_are(salt_water):
    topology, system, x = salt_water
    system.setParticleMass(system.getNumParticles() - 1, 0.0)
    simulation = start(topology, system, x)
    simulation.step(20)
    np.testing.assert_array_equal(positions_of(simulation)[-1], x[-1])


# -- what OpenMM does beside us ---------------------------------------------------------------------------------


def periodic_water(n=216, **options):
    settings = {
        "nonbondedMethod": app.PME,
        "nonbondedCutoff": 0.7 * unit.nanometer,
        "switchDistance": 0.6 * unit.nanometer,
    }
    return rb.rigid_water(n, **(settings | options))


def test_a_barostat_moves_whole_molecules():
    topology, system, positions = periodic_water(125)
    barostat = openmm.MonteCarloBarostat(1.0 * unit.bar, 300.0 * unit.kelvin, 3)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    simulation = start(topology, system, positions, platform=CPU)
    volumes = set()
    for _ in range(30):
        simulation.step(2)
        volumes.add(simulation.context.getState().getPeriodicBoxVolume()._value)
    assert len(volumes) > 3
    x = positions_of(simulation).reshape(-1, 3, 3)
    np.testing.assert_allclose(np.linalg.norm(x[:, 1] - x[:, 0], axis=1), 0.09572, rtol=0.0, atol=1e-12)
    assert np.isfinite(total_energy(simulation))


def test_a_barostat_does_not_tear_bodies_named_by_hand():
    """It scales the places of OpenMM's molecules, which only bonds and constraints make."""
    topology, system, positions = periodic_water(125, nonbondedMethod=app.CutoffPeriodic)
    while system.getNumConstraints():
        system.removeConstraint(0)
    barostat = openmm.MonteCarloBarostat(1e3 * unit.bar, 300.0 * unit.kelvin, 1)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    named = [[3 * k, 3 * k + 1, 3 * k + 2] for k in range(125)]

    def fresh():  # not minimised: nothing would hold the molecules together
        integrator = rb.ExactRigidBodyIntegrator(1e-7, bodies=named)
        simulation = app.Simulation(topology, system, integrator, CPU)
        simulation.context.setPositions(positions)
        return simulation

    barostat.setScaleMoleculesAsRigid(False)
    with pytest.raises(ValueError, match=r"MonteCarloBarostat .*AsRigid\(True\)"):
        fresh().step(1)
    barostat.setScaleMoleculesAsRigid(True)
    with pytest.raises(ValueError, match=r"tear body 0 .* by bonds"):
        fresh().step(1)
    bonds = openmm.HarmonicBondForce()
    for oxygen, *hydrogens in named:
        for hydrogen in hydrogens:
            bonds.addBond(oxygen, hydrogen, 0.1, 0.0)
    system.addForce(bonds)
    simulation = fresh()
    edge = simulation.context.getState().getPeriodicBoxVectors()[0][0]
    simulation.step(10)
    assert simulation.context.getState().getPeriodicBoxVectors()[0][0] != edge


def test_a_shift_by_the_barostat_keeps_attitudes_to_the_bit():
    topology, system, positions = periodic_water(125)
    simulation = start(topology, system, positions, platform=CPU)
    simulation.step(1)
    _, before = simulation.integrator.bodyState()
    simulation.context.setPositions(positions_of(simulation) + 0.25)
    _, after = simulation.integrator.bodyState()
    np.testing.assert_array_equal(after.q, before.q)
    np.testing.assert_array_equal(after.m, before.m)
    np.testing.assert_array_equal(after.P, before.P)
    np.testing.assert_allclose(after.R, before.R + 0.25, rtol=0.0, atol=1e-14)


def test_the_motion_remover_of_create_system_changes_nothing_but_the_drift():
    topology, system, positions = periodic_water(125, removeCMMotion=True)
    simulation = start(topology, system, positions, platform=CPU)
    simulation.step(5)
    assert simulation.integrator.degreesOfFreedom() == (3 * 125 - 3, 3 * 125)
    _, state = simulation.integrator.bodyState()
    # The remover works on particles in float64; what is left is its roundoff and one step's noise of float32 forces.
    assert np.abs(state.P.sum(axis=1)).max() < 1e-3
    simulation.integrator.setVelocitiesToTemperature(300.0, 1)
    _, state = simulation.integrator.bodyState()
    np.testing.assert_allclose(state.P.sum(axis=1), 0.0, atol=1e-11)


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
        simulation = start(topology, system, positions, scheme=scheme)
        simulation.context.setVelocities(np.zeros((12, 3)))
        simulation.step(1)
        simulation.context.setParameter("strength", strength)
        simulation.step(1)
        momenta.append(simulation.integrator.bodyState()[1].P.sum(axis=1))
    # Four oxygens, one step of 2 fs at the full strength: the first kick included.
    np.testing.assert_allclose(momenta[1] - momenta[0], [4 * 7.0 * 0.002, 0.0, 0.0], rtol=0.0, atol=1e-9)


def test_only_the_integration_force_groups_act():
    topology, system, positions = rb.rigid_water(4)
    for force in system.getForces():
        force.setForceGroup(1)
    simulation = start(topology, system, positions)
    simulation.integrator.setIntegrationForceGroups({0})
    before = simulation.integrator.bodyState()[1]
    simulation.step(10)
    np.testing.assert_array_equal(simulation.integrator.bodyState()[1].P, before.P)


@pytest.mark.parametrize("platform", [REFERENCE, CPU], ids=["Reference", "CPU"])
def test_a_step_far_too_large_names_the_bodies_and_keeps_the_last_good_state(platform):
    simulation = start(*rb.rigid_water(27), h=0.5, scheme="SRKN4_6b", platform=platform)
    with pytest.raises(rb.IntegrationError, match=r"bodies \d+ and \d+") as error:
        simulation.step(50)
    assert error.match(f"step {simulation.context.getStepCount() + 1},")
    assert np.isfinite(positions_of(simulation)).all()


def test_reinitialize_continues_right():
    runs = [start(*rb.rigid_water(4)) for _ in range(2)]
    for simulation in runs:
        simulation.step(10)
    runs[1].context.reinitialize(preserveState=True)
    for simulation in runs:
        simulation.step(10)
    np.testing.assert_array_equal(*map(positions_of, runs))


def test_forces_added_before_reinitialize_take_part():
    """The box shrank and the molecules stayed."""
    simulation = start(*periodic_water(125, nonbondedMethod=app.CutoffPeriodic), platform=CPU)
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
    simulation = start(*rb.rigid_water(4))
    simulation.step(1)
    system = simulation.system
    for i in reversed(range(system.getNumConstraints())):
        if system.getConstraintParameters(i)[0] < 3:
            system.removeConstraint(i)
    simulation.context.reinitialize(preserveState=True)
    assert simulation.integrator.degreesOfFreedom() == (3 * (3 + 3), 3 * 3)
    simulation.step(1)


RESTART = """
import sys
import openmm, openmm_exactrb as rb
from openmm import app
topology, system, positions = rb.rigid_water(8, model="tip4pew")
integrator = rb.ExactRigidBodyIntegrator(0.004, scheme="S2_3")
simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
simulation.loadCheckpoint(sys.argv[1])
simulation.step(100)
simulation.saveCheckpoint(sys.argv[2])
"""


def test_a_checkpoint_in_a_new_process_ends_in_the_same_bits(tmp_path):
    topology, system, positions = rb.rigid_water(8, model="tip4pew")
    simulation = start(topology, system, positions, h=0.004, scheme="S2_3")
    simulation.step(100)
    simulation.saveCheckpoint(str(tmp_path / "half"))
    simulation.step(100)
    arguments = [sys.executable, "-c", RESTART, str(tmp_path / "half"), str(tmp_path / "end")]
    subprocess.run(arguments, check=True)
    expected = positions_of(simulation)
    simulation.loadCheckpoint(str(tmp_path / "end"))
    np.testing.assert_array_equal(positions_of(simulation), expected)


@pytest.mark.filterwarnings("ignore:Casting xyz")  # mdtraj's reporter warns of its own conversion to float32
def test_reporters_of_openmm_and_mdtraj_agree(tmp_path):
    simulation = start(*rb.rigid_water(8))
    names = {kind: str(tmp_path / f"run.{kind}") for kind in ("dcd", "xtc", "pdb", "mdtraj.dcd")}
    simulation.reporters += [
        app.DCDReporter(names["dcd"], 5),
        app.XTCReporter(names["xtc"], 5),
        app.PDBReporter(names["pdb"], 5),
        mdtraj.reporters.DCDReporter(names["mdtraj.dcd"], 5),
    ]
    simulation.step(20)
    end = positions_of(simulation)
    for reporter in simulation.reporters:
        if hasattr(reporter, "close"):
            reporter.close()
    simulation.reporters.clear()
    for kind, name in names.items():
        read = mdtraj.load(name, top=None if kind == "pdb" else names["pdb"])
        assert len(read) == 4
        np.testing.assert_allclose(read.xyz[-1], end, atol=1.1e-3 if kind == "xtc" else 1e-4)


def opencl_properties():
    names = [openmm.Platform.getPlatform(i).getName() for i in range(openmm.Platform.getNumPlatforms())]
    return "OpenCL" in names


@pytest.mark.opencl
@pytest.mark.skipif(not opencl_properties(), reason="no OpenCL: apt-get install pocl-opencl-icd ocl-icd-libopencl1")
@pytest.mark.parametrize("precision", ["mixed", "double"])
def test_opencl_agrees_with_reference_and_keeps_the_state_in_float64(precision):
    topology, system, positions = rb.rigid_water(8)
    reference = start(topology, system, positions)
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


def check_equilibrium(n, starts, picoseconds, cutoff):
    """NVE from canonical starts: equal temperatures, and the structure of OpenMM's own rigid water.

    The difference of the temperatures is correlated over some 0.2 ps: its error comes from sixteen blocks, each a
    run of its own or far longer than that. The means of shorter blocks scatter half as much as they should.
    """
    options = {"nonbondedCutoff": cutoff * unit.nanometer, "switchDistance": (cutoff - 0.1) * unit.nanometer}
    topology, system, positions = periodic_water(n, **options)
    langevin = openmm.LangevinMiddleIntegrator(300.0, 2.0, 0.002)
    langevin.setRandomNumberSeed(1)
    theirs = app.Simulation(topology, system, langevin, CPU)
    theirs.context.setPositions(positions)
    theirs.minimizeEnergy()
    theirs.context.setVelocitiesToTemperature(300.0, 1)
    theirs.step(round(0.25 * starts * picoseconds / 0.002))
    integrator = rb.ExactRigidBodyIntegrator(0.006, scheme="S2_3")
    ours = app.Simulation(topology, system, integrator, CPU)
    frames, reference, differences = [], [], []
    for start in range(starts):
        ours.context.setState(theirs.context.getState(positions=True))
        integrator.setVelocitiesToTemperature(300.0, start)
        for _ in range(round(picoseconds / 0.06)):
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


@pytest.mark.validate
def test_water_stays_in_equilibrium():
    check_equilibrium(125, 16, 0.24, 0.7)


@pytest.mark.validate
def test_216_waters_stay_in_equilibrium_over_20_ps():
    check_equilibrium(216, 1, 20.0, 0.85)
