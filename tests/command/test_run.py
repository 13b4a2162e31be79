"""``exactrb run``: from files to a trajectory, as the same steps in Python, and on after a kill."""

import itertools
import json
import time
from argparse import Namespace
from pathlib import Path

import mdtraj
import numpy as np
import openmm
import pytest
from openmm import app, unit
from processes_of_command import launch

import openmm_exactrb as rb
from openmm_exactrb.command.equilibration import candidates
from openmm_exactrb.command.main import main
from openmm_exactrb.command.setup import correct_pressure, couple, integrator_of, pace
from openmm_exactrb.tuning import CANDIDATES, Choice
from peptides import in_water
from starts import context_of


def carry_out(capsys, *arguments):
    """Carry out the command in this process; return its exit status, output and errors."""
    return main(list(map(str, arguments))), *capsys.readouterr()


PLAIN = "--platform", "Reference", "--quiet"
BOX = ["--cutoff", "0.4", "--ewald-tolerance", "0.01", "--equilibrate", "0.01", "--duration", "0.01", "--no-picture"]
SHORT = "--step", "2fs", "--scheme", "S2_2", "--interval", "4fs", *PLAIN


@pytest.mark.parametrize("trajectory", ["dcd", "xtc"])
def test_a_pdb_file_becomes_a_trajectory(droplet, tmp_path, capsys, trajectory):
    out = tmp_path / "out"
    options = "--duration", "0.04", "--equilibrate", "0.02", "--trajectory", trajectory, "--out", out
    status, said, errors = carry_out(capsys, "run", droplet, "--forcefield", "tip3p.xml", *SHORT, *options)
    assert (status, errors) == (0, "")
    assert "ns/day" in said
    frames = mdtraj.load(str(out / f"trajectory.{trajectory}"), top=str(out / "topology.pdb"))
    table = np.loadtxt(out / "energies.csv", delimiter=",", skiprows=1)
    assert (frames.n_atoms, len(frames), len(table)) == (24, 11, 11)
    np.testing.assert_allclose(table[:, 1], 0.004 * np.arange(11), atol=1e-12)
    assert (out / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_a_system_and_a_state_move_as_in_python(serialised, tmp_path, capsys):
    """The same steps without the command."""
    options = "--duration", "0.02", "--no-picture", "--out", tmp_path / "out"
    status, _, errors = carry_out(capsys, "run", *serialised, *SHORT, *options)
    assert (status, errors) == (0, "")
    system = openmm.XmlSerializer.deserialize(serialised[0].read_text(encoding="utf-8"))
    context = openmm.Context(
        system, rb.ExactRigidBodyIntegrator(0.002, scheme="S2_2"), openmm.Platform.getPlatform("Reference")
    )
    rb.loadState(context, serialised[1])
    context.getIntegrator().step(10)
    energies = [energy._value for energy in context.getIntegrator().kineticEnergies()]
    last = np.loadtxt(tmp_path / "out" / "energies.csv", delimiter=",", skiprows=1)[-1]
    np.testing.assert_allclose(last[[0, 1]], [10, 0.02], rtol=1e-12)
    np.testing.assert_allclose(last[[2, 3]], energies, rtol=1e-15)
    residues = [residue.name for residue in app.PDBFile(str(tmp_path / "out" / "topology.pdb")).topology.residues()]
    assert residues == 8 * ["HOH"]


def test_an_interval_of_forces_is_a_step(serialised, tmp_path, capsys):
    """W4_4 evaluates forces four times a step."""
    files = []
    for name, given in (("step", ("--step", "8fs")), ("interval", ("--force-interval", "2fs"))):
        folder = tmp_path / name
        options = *given, "--scheme", "W4_4", "--interval", "8fs", "--duration", "0.04", "--platform", "Reference"
        assert carry_out(capsys, "run", *serialised, *options, "--no-picture", "--out", folder)[0] == 0
        files.append((folder / "energies.csv").read_bytes())
    assert files[0] == files[1]


def test_a_run_that_was_killed_ends_in_the_same_bytes(serialised, tmp_path, capsys):
    """The run is longer than any test: what it has reached when it is killed depends on how busy the machine is."""
    once, killed = tmp_path / "once", tmp_path / "killed"
    command = "run", *serialised, *SHORT, "--checkpoint", 0, "--no-picture", "--out"
    process = launch(*command, killed, "--duration", "1000")
    energies = killed / "energies.csv"

    def lines():
        return energies.read_text(encoding="utf-8").count("\n") if energies.exists() else 0

    while process.poll() is None and lines() <= 8:
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert lines() > 8
    end = f"{4 * (lines() + 20)}fs"
    assert carry_out(capsys, *command, once, "--duration", end)[0] == 0
    status, _, errors = carry_out(capsys, *command, killed, "--duration", end, "--resume")
    assert (status, errors) == (0, "")
    assert energies.read_bytes() == (once / "energies.csv").read_bytes()
    top = str(once / "topology.pdb")
    frames = [mdtraj.load(str(folder / "trajectory.dcd"), top=top).xyz for folder in (once, killed)]
    np.testing.assert_array_equal(*frames)


def test_a_run_can_be_made_longer(serialised, tmp_path, capsys):
    command = "run", *serialised, *SHORT, "--no-picture", "--out", tmp_path / "out", "--duration"
    assert carry_out(capsys, *command, "0.02")[0] == 0
    assert carry_out(capsys, *command, "0.04")[0] == 2
    assert carry_out(capsys, *command, "0.04", "--resume")[0] == 0
    table = np.loadtxt(tmp_path / "out" / "energies.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(table[:, 0], np.arange(0, 21, 2))


def test_the_measured_step_is_kept(serialised, tmp_path, capsys):
    """It depends on how busy the machine was: a run that goes on must not measure again."""
    options = "--scheme", "S2_2", "--target", "0.05", "--budget", "4", "--no-picture", "--out", tmp_path / "out", *PLAIN
    assert carry_out(capsys, "run", *serialised, "--duration", "0.05", *options)[0] == 0
    kept = json.loads((tmp_path / "out" / "step.json").read_text(encoding="utf-8"))
    assert kept["scheme"] == "S2_2"
    status, said, errors = carry_out(capsys, "run", *serialised, "--duration", "0.08", "--resume", *options)
    assert (status, errors) == (0, "")
    assert said.count("a step is") == 1
    assert f"a step is {1e3 * kept['step']:.6g} fs" in said.splitlines()[0]


def test_no_scheme_is_measured_that_a_thermostat_would_refuse():
    for ensemble, scheme in itertools.product(("nvt", "npt"), CANDIDATES):
        args = Namespace(ensemble=ensemble, rotor="exact", temperature=300.0, friction=1.0, seed=3, scheme=None)
        if scheme in candidates(args):
            integrator_of(args, {"scheme": scheme}, 0.004)
        else:
            with pytest.raises(ValueError, match="choose a scheme without a processor"):
                integrator_of(args, {"scheme": scheme}, 0.004)
    assert len(candidates(args)) > 6


@pytest.mark.parametrize("ensemble", ["nve", "nvt"])
@pytest.mark.parametrize(("method", "fast"), [("S2_2 nested", "bonded"), ("W2_4", None)])
def test_a_measured_choice_is_run_as_it_was_measured(ensemble, method, fast):
    """With bonded forces within the drifts, or without."""
    args = Namespace(ensemble=ensemble, rotor="exact", temperature=300.0, friction=1.0, seed=3)
    choice = Choice(method, 0.004, 0.01, 1.0, True)
    integrator = integrator_of(args, choice.options(), choice.step)
    assert integrator.getScheme().name == choice.method.split()[0]
    assert getattr(integrator.getMultipleTimeSteps(), "fast", None) == fast


def test_water_is_made_in_a_box(tmp_path, capsys):
    status, _, errors = carry_out(
        capsys, "run", "--solvate", 27, "--forcefield", "tip4pew.xml", *BOX, *SHORT, "--out", tmp_path / "out"
    )
    assert (status, errors) == (0, "")
    topology = app.PDBFile(str(tmp_path / "out" / "topology.pdb")).topology
    assert topology.getNumAtoms() == 4 * 27
    assert topology.getUnitCellDimensions()[0]._value == pytest.approx(3 * 0.3104, abs=1e-3)


@pytest.mark.filterwarnings("ignore::openmm_exactrb.ShapeWarning")  # of water of a file with three digits
def test_water_is_put_around_what_is_in_a_file(droplet, tmp_path, capsys):
    options = *BOX, "--solvate", 40
    status, _, errors = carry_out(
        capsys, "run", droplet, "--forcefield", "tip3p.xml", *options, *SHORT, "--out", tmp_path / "out"
    )
    assert (status, errors) == (0, "")
    assert app.PDBFile(str(tmp_path / "out" / "topology.pdb")).topology.getNumResidues() == 48


@pytest.fixture
def box(tmp_path):
    """27 molecules in motion in a periodic box, and the files of their System and State."""
    topology, system, positions = rb.rigid_water(27, nonbondedMethod=app.PME, nonbondedCutoff=0.4 * unit.nanometer)
    context = context_of(system, openmm.VerletIntegrator(0.001), positions, kelvin=280 * unit.kelvin, seed=2)
    state = context.getState(positions=True, velocities=True)
    files = tmp_path / "system.xml", tmp_path / "state.xml"
    for file, content in zip(files, (system, state), strict=True):
        file.write_text(openmm.XmlSerializer.serialize(content))
    return topology, system, state, files


def test_constant_temperature_is_that_of_the_integrator(box, tmp_path, capsys):
    topology, system, state, files = box
    options = "--ensemble", "nvt", "--temperature", "280", "--friction", "2", "--seed", "7", "--duration", "0.1"
    status, _, errors = carry_out(capsys, "run", *files, *SHORT, *options, "--out", tmp_path / "out")
    assert (status, errors) == (0, "")
    integrator = rb.ExactRigidBodyLangevinIntegrator(280.0, 2.0, 0.002, scheme="S2_2")
    integrator.setRandomNumberSeed(7)
    simulation = app.Simulation(topology, system, integrator, openmm.Platform.getPlatform("Reference"))
    rb.loadState(simulation, state)
    simulation.step(50)
    energies = [energy._value for energy in integrator.kineticEnergies()]
    last = np.loadtxt(tmp_path / "out" / "energies.csv", delimiter=",", skiprows=1)[-1]
    np.testing.assert_allclose(last[[2, 3]], energies, rtol=1e-12)
    assert (tmp_path / "out" / "picture.png").exists()


def test_constant_pressure_moves_the_box(box, tmp_path, capsys):
    *_, files = box
    options = "--ensemble", "npt", "--pressure", "500", "--duration", "0.2", "--out", tmp_path / "out"
    status, said, errors = carry_out(capsys, "run", *files, *SHORT, *options)
    assert (status, errors) == (0, "")
    assert "density" in said
    volume = np.loadtxt(tmp_path / "out" / "volume.csv", delimiter=",", skiprows=1)[:, 2]
    assert volume[0] == pytest.approx((3 * 0.3104) ** 3, rel=1e-6)
    assert 1 < len(set(volume)) <= 1 + 100 // 25  # an attempt every 25 steps


@pytest.mark.parametrize(("moving", "warmth"), [(False, 400), pytest.param(True, 280, marks=pytest.mark.validate)])
def test_a_state_does_not_bring_the_pressure_that_it_was_saved_at(box, tmp_path, capsys, moving, warmth):
    """It has that of a barostat which is out of the System since, and the temperature of that too."""
    _, system, state, files = box
    saved = openmm.XmlSerializer.clone(system)
    saved.addForce(openmm.MonteCarloBarostat(1e4 * unit.bar, warmth * unit.kelvin))
    context = openmm.Context(saved, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    rb.loadState(context, state)
    with_parameters = tmp_path / "with_parameters.xml"
    for file, parameters in ((files[1], False), (with_parameters, True)):
        content = context.getState(positions=True, velocities=moving, parameters=parameters)
        file.write_text(openmm.XmlSerializer.serialize(content))
    assert "MonteCarloPressure" in with_parameters.read_text(encoding="utf-8")
    options = "--ensemble", "npt", "--pressure", "500", "--temperature", "280", "--duration", "0.1", "--no-picture"
    options += () if moving else ("--equilibrate", "0.01")
    volumes = []
    for file in (files[1], with_parameters):
        out = tmp_path / file.stem
        status, _, errors = carry_out(capsys, "run", files[0], file, *SHORT, *options, "--out", out)
        assert (status, errors) == (0, "")
        kept = openmm.XmlSerializer.deserialize((out / "start.xml").read_text(encoding="utf-8")).getParameters()
        assert (kept["MonteCarloPressure"], kept["MonteCarloTemperature"]) == (500.0, 280.0)
        volumes.append((out / "volume.csv").read_text(encoding="utf-8"))
    assert volumes[0] == volumes[1]


def test_a_few_lines_of_energies_have_no_deviation(serialised, tmp_path, capsys):
    options = "--duration", "4fs", "--no-picture", "--out", tmp_path / "out"
    status, said, _ = carry_out(capsys, "run", *serialised, *SHORT, *options)
    assert status == 0
    assert "standard deviation" not in said


def test_an_equilibration_has_units(droplet, tmp_path, capsys):
    """The same as its number of ps; without one the start is only minimised."""
    command = "run", droplet, "--forcefield", "tip3p.xml", *SHORT, "--duration", "0.01", "--no-picture"
    for name, length in (("unit", "20fs"), ("number", "0.02"), ("zero", "0"), ("none", "0fs")):
        assert carry_out(capsys, *command, "--equilibrate", length, "--out", tmp_path / name)[0] == 0
    unit_, number, zero, none = (
        (tmp_path / name / "energies.csv").read_bytes() for name in ("unit", "number", "zero", "none")
    )
    assert unit_ == number != zero == none


def test_an_equilibration_is_told_before_it_begins_and_is_a_fifth_of_the_run(droplet, tmp_path, capsys):
    command = "run", droplet, "--forcefield", "tip3p.xml", *SHORT[:-1], "--no-picture"
    for duration, told in ((0.05, "equilibrating for 0.01 ps (--equilibrate)"), (1e-3, None)):
        out = tmp_path / str(duration)
        status, _, errors = carry_out(capsys, *command, "--duration", duration, "--out", out)
        assert status == 0
        assert errors.startswith("equilibrating") == bool(told)
        if told:
            assert errors.splitlines()[0] == told
            longer = "--duration", 0.06, "--out", out, "--resume", "--quiet"  # no other start
            assert carry_out(capsys, *command, *longer)[0] == 0


def test_positions_of_a_file_are_minimised_without_a_warning(tmp_path, capsys):
    """Programs that add hydrogens place them at distances that differ from the constraints by up to 0.001 nm."""
    topology, _, positions = in_water("HBonds")
    hydrogens = [atom.element is app.element.hydrogen for atom in topology.atoms()]
    positions[hydrogens] += 0.001 / np.sqrt(3.0)
    with (tmp_path / "peptide.pdb").open("w") as file:
        app.PDBFile.writeFile(topology, positions * unit.nanometer, file)
    force_field = "--forcefield", "amber14-all.xml", "amber14/tip3p.xml", "--constraints", "HBonds"
    run = "--step", "1fs", "--equilibrate", 0, "--duration", "1fs", "--platform", "Reference", "--out", tmp_path / "out"
    status, _, errors = carry_out(capsys, "run", tmp_path / "peptide.pdb", *force_field, *run)
    assert status == 0, errors
    assert "shapes" not in errors


@pytest.mark.validate
def test_a_protein_gets_water_and_ions_and_runs(tmp_path, capsys):
    """OpenMM's own test file is a protein in water: the water is taken away, and the command adds its own."""
    solvated = app.PDBFile(str(Path(app.__file__).parent / "data" / "test.pdb"))
    modeller = app.Modeller(solvated.topology, solvated.positions)
    modeller.deleteWater()
    modeller.delete([residue for residue in modeller.topology.residues() if residue.name == "Cl"])
    with (tmp_path / "protein.pdb").open("w") as file:
        app.PDBFile.writeFile(modeller.topology, modeller.positions, file)
    force_field = "--forcefield", "amber14-all.xml", "amber14/tip3p.xml"
    water = "--solvate", 1200, "--water", "tip3p", "--constraints", "HBonds", "--cutoff", 0.8
    run = "--ensemble", "nvt", "--step", "2fs", "--duration", "1ps", "--interval", "0.1ps", "--platform", "CPU"
    out = tmp_path / "out"
    status, said, errors = carry_out(capsys, "run", tmp_path / "protein.pdb", *force_field, *water, *run, "--out", out)
    assert status == 0, errors
    assert "equilibrating for 0.2 ps" in errors
    names = [residue.name for residue in app.PDBFile(str(out / "topology.pdb")).topology.residues()]
    assert names.count("HOH") + names.count("CL") + names.count("NA") == 1200
    assert "CL" in names or "NA" in names
    table = np.loadtxt(out / "energies.csv", delimiter=",", skiprows=1)
    assert np.isfinite(table).all()
    assert "ns/day" in said


def test_the_barostat_has_the_settings_of_the_options(box):
    _, system, _, _ = box
    couple(system, Namespace(ensemble="npt", pressure=500.0, temperature=280.0, seed=7))
    barostat = system.getForce(system.getNumForces() - 1)
    assert barostat.getDefaultPressure() == 500 * unit.bar
    assert barostat.getDefaultTemperature() == 280 * unit.kelvin
    assert barostat.getRandomNumberSeed() == 7
    for step, frequency in ((0.002, 25), (0.018, 3), (0.2, 1)):
        pace(system, step)
        assert barostat.getFrequency() == frequency


def test_thermostats_and_barostats_that_never_act_are_replaced(box):
    _, system, _, _ = box
    n = system.getNumForces()
    for force in (openmm.MonteCarloBarostat(9.0, 200.0, 0), openmm.AndersenThermostat(200.0, 0.0)):
        system.addForce(force)
    couple(system, Namespace(ensemble="npt", pressure=500.0, temperature=280.0, seed=7))
    assert system.getNumForces() == n + 1
    assert system.getForce(n).getDefaultTemperature() == 280 * unit.kelvin
    system.addForce(openmm.AndersenThermostat(200.0, 1.0))
    with pytest.raises(ValueError, match="the System already contains MonteCarloBarostat and AndersenThermostat"):
        couple(system, Namespace(ensemble="nvt"))


def test_the_offset_of_averages_is_added_to_the_pressure_for_the_same_settings_alone(box, tmp_path):
    """A slope of 1e6 bar/ps² and no covariances: the offset is -8e-3 to -1e-2 (0.012 ps)² of it, by the friction."""
    settings = {
        "scheme": "W2_3m", "step": 0.012, "alpha": 1e-3, "beta": 5e-3, "slopes": [7e-3, 1e-3],
        "barostat_slope": 8e-3, "quartic": 0.0, "temperature": 300.0, "kT": 2.494, "frictions": [5.0],
        "freedom": 384, "mass": 1153.0,
    }  # fmt: skip
    names = ["step", "potential", "volume", "square", "inner square", "work", "inner work", "damped work", "pressure"]
    names += ["pressure slope", "pressure inner slope"]
    row = "1,-2500,2,2e6,0,2e6,0,2e6,0,1e6,0\n"
    file = tmp_path / "averages.csv"
    file.write_text(f"# {json.dumps(settings)}\n{','.join(names)}\n{row * 50}")
    (_, system, _, _), langevin = box, rb.ExactRigidBodyLangevinIntegrator
    couple(system, Namespace(ensemble="npt", pressure=1.0, temperature=300.0, seed=7))
    correct_pressure(system, None, langevin(300.0, 5.0, 0.012, scheme="W2_3m"), 300.0)
    correct_pressure(system, rb.pressure_offset(file), langevin(300.0, 5.0, 0.012, scheme="W2_3m"), 300.0)
    barostat = system.getForce(system.getNumForces() - 1)
    assert barostat.getDefaultPressure()._value == pytest.approx(1.0 - 9e-3 * 0.012**2 * 1e6)
    for step, kelvin, scheme in ((0.011, 300.0, "W2_3m"), (0.012, 310.0, "W2_3m"), (0.012, 300.0, "BAOA")):
        with pytest.raises(ValueError, match=r"W2_3m with a step of 0.012 ps at 300 K, but this run has"):
            correct_pressure(system, rb.pressure_offset(file), langevin(kelvin, 5.0, step, scheme=scheme), kelvin)


def test_a_missing_file_of_the_offset_ends_the_command_before_the_equilibration(droplet, tmp_path, capsys):
    command = "run", droplet, "--forcefield", "tip3p.xml", *SHORT, "--ensemble", "npt"
    status, _, errors = carry_out(capsys, *command, "--pressure-offset", tmp_path / "no.csv", "--out", tmp_path / "out")
    assert status == 2
    assert "no.csv" in errors
    assert not (tmp_path / "out").exists()
