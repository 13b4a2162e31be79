"""What is wrong with a command line is told in one line, with status 2, and no file is touched."""

import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.command.main import main
from openmm_exactrb.command.topology import topology_of
from starts import context_of

CASES = [
    (["droplet.pdb"], "droplet.pdb contains no force field: add --forcefield"),
    (["--solvate", "27"], "--solvate needs a force field: add --forcefield"),
    (["nowhere.pdb"], "the file nowhere.pdb does not exist"),
    (["nowhere.pdb", "--forcefield", "tip3p.xml"], "the file nowhere.pdb does not exist"),
    (["system.xml", "nowhere.xml"], "the file nowhere.xml does not exist"),
    (["droplet.pdb", "--forcefield", "tip9p.xml"], "tip9p.xml"),
    (["droplet.pdb", "--forcefield", "spce.xml", "--scheme", "RK4"], "scheme 'RK4' is unknown"),
    (["droplet.pdb", "--forcefield", "spce.xml", "--scheme", "BAOA"], "BAOA contains a thermostat"),
    (
        ["droplet.pdb", "--forcefield", "spce.xml", "--ensemble", "nvt", "--scheme", "BAOA"],
        "BAOA contains a thermostat",
    ),
    (
        ["droplet.pdb", "--forcefield", "tip3p.xml", "--step", "4fs", "--force-interval", "2fs"],
        "--step and --force-interval are mutually exclusive",
    ),
    (["droplet.pdb", "--forcefield", "tip3p.xml", "--platform", "Abacus"], "platform 'Abacus' is not available"),
    (["droplet.pdb", "--forcefield", "tip3p.xml", "--ensemble", "npt"], "needs a periodic box"),
    (
        ["droplet.pdb", "--forcefield", "amber14-all.xml", "--solvate", "9"],
        "--solvate needs a water model, but no force field file is named after one: add --water",
    ),
    (["cut.pdb", "--forcefield", "tip3p.xml"], "cut.pdb is truncated, because its last line is incomplete"),
    (["system.xml"], "pass one file (PDB .pdb or PDBx .cif), or two (system.xml and state.xml"),
    (["state.xml", "system.xml"], "contains an object of type State, not System"),
    (
        ["system.xml", "state.xml", "--forcefield", "tip3p.xml"],
        "neither --forcefield nor --solvate applies to system.xml, which already contains the solvent and the forces",
    ),
    ([], "exactrb run: molecules are missing: pass one file"),
    (["--resume"], "--resume needs the files and options with which the run"),
    (["--solvate", "27", "--forcefield", "tip3p.xml"], "--cutoff must be at most half the width of the box"),
    (["system.xml", "state.xml", "--out", "cut.pdb"], "cut.pdb is a file"),
]
PDB = ["droplet.pdb", "--forcefield", "tip3p.xml"]
XML = ["system.xml", "state.xml"]
IDLE = [
    ([*XML, "--constraints", "HBonds"], "--constraints has no effect because the System already contains forces"),
    ([*XML, "--cutoff", "0.9"], "--cutoff has no effect because the System already"),
    ([*XML, "--ewald-tolerance", "1e-5"], "--ewald-tolerance has no effect because the System already"),
    ([*XML, "--water", "tip3p"], "--water has no effect because the System already"),
    (
        [*XML, "--ensemble", "nvt", "--equilibrate", "0.001"],
        "--equilibrate has no effect because a State with velocities",
    ),
    ([*XML, "--temperature", "310"], "--temperature has no effect because a State with velocities"),
    ([*PDB, "--cutoff", "0.4"], "--cutoff has no effect without a periodic box"),
    ([*PDB, "--ewald-tolerance", "1e-4"], "--ewald-tolerance has no effect without a periodic box"),
    ([*PDB, "--water", "tip3p"], "--water has no effect without --solvate"),
    ([*PDB, "--ensemble", "nvt", "--pressure", "1"], "--pressure has no effect without --ensemble npt"),
    ([*PDB, "--friction", "1"], "--friction has no effect without --ensemble nvt or npt"),
    ([*PDB, "--target", "1e-3"], "--target has no effect without --step auto"),
    ([*PDB, "--budget", "60"], "--budget has no effect without --step auto"),
]


@pytest.fixture
def files(droplet, serialised, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = droplet.read_text(encoding="utf-8").splitlines()
    (tmp_path / "cut.pdb").write_text("\n".join(lines[:10])[:-40])


@pytest.mark.parametrize(("arguments", "message"), CASES, ids=[message for _, message in CASES])
@pytest.mark.usefixtures("files")
def test_a_wrong_call_is_one_line(tmp_path, capsys, arguments, message):
    assert main(["run", "--out", "out", *arguments]) == 2
    out, errors = capsys.readouterr()
    assert errors.startswith("exactrb run: ")
    assert message in errors
    assert (errors.count("\n"), out) == (1, "")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("files")
def test_names_are_taken_in_any_case(tmp_path, capsys):
    options = ["--ensemble", "NVT", "--constraints", "hbonds", "--trajectory", "XTC", "--rotor", "Exact"]
    short = ["--step", "2fs", "--duration", "4fs", "--equilibrate", "0", "--platform", "reference", "--no-picture"]
    assert main(["run", *PDB, *options, *short, "--out", "out"]) == 0
    assert (tmp_path / "out" / "trajectory.xtc").exists()
    assert "ExactRigidBodyLangevinIntegrator" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["run", *PDB, "--ensemble", "nph"])
    assert "invalid choice: 'nph'" in capsys.readouterr().err


@pytest.mark.parametrize(("arguments", "message"), IDLE, ids=[message for _, message in IDLE])
@pytest.mark.usefixtures("files")
def test_an_option_that_does_nothing_is_refused(tmp_path, capsys, arguments, message):
    assert main(["run", *arguments, "--step", "2fs", "--duration", "2fs", "--out", "out"]) == 2
    out, errors = capsys.readouterr()
    assert f": {message}" in errors
    assert f": omit {message.split()[0]}\n" in errors
    assert (errors.count("\n"), out) == (1, "")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--step", "2"], "argument --step: '2' has no unit: write 2fs for femtoseconds, or 2ps"),
        (["--force-interval", "2"], "argument --force-interval: '2' has no unit: write 2fs for femtoseconds, or 2ps"),
        (["--step", "4kg"], "'4kg' is not a positive time"),
        (["--duration=-1"], "'-1' is not a positive time"),
        (["--temperature", "nan"], "'nan' is not a positive number"),
        (["--solvate", "2.5"], "'2.5' is not a whole number of at least 1"),
        (["--seed", "0"], "'0' is not a whole number from 1 to"),
        (["--seed", "2147483648"], "'2147483648' is not a whole number from 1 to 2147483647"),
        (["--equilibrate=-1ps"], "'-1ps' is not a time of at least 0"),
        (["--equilibrate", "1kg"], "'1kg' is not a time of at least 0"),
        (["--ensemble", "nvp"], "invalid choice: 'nvp'"),
    ],
)
def test_a_wrong_option_is_one_line(capsys, arguments, message):
    with pytest.raises(SystemExit) as ended:
        main(["run", *arguments])
    assert ended.value.code == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.count("\n") == 1


def test_a_barostat_of_the_system_is_not_one_of_the_command(tmp_path, capsys):
    _, system, positions = rb.rigid_water(27, nonbondedMethod=app.PME, nonbondedCutoff=0.4 * unit.nanometer)
    system.addForce(openmm.MonteCarloBarostat(1 * unit.bar, 300 * unit.kelvin))
    context = context_of(system, openmm.VerletIntegrator(0.001), positions)
    files = tmp_path / "system.xml", tmp_path / "state.xml"
    for file, content in zip(files, (system, context.getState(positions=True)), strict=True):
        file.write_text(openmm.XmlSerializer.serialize(content))
    assert main(["run", *map(str, files), "--out", str(tmp_path / "out")]) == 2
    assert "remove MonteCarloBarostat from the System" in capsys.readouterr().err


def test_a_run_is_not_replaced(serialised, tmp_path, capsys):
    command = ["run", *map(str, serialised), "--step", "2fs", "--duration", "0.004", "--platform", "Reference"]
    command += ["--no-picture", "--quiet", "--out", str(tmp_path / "out")]
    assert main(command) == 0
    capsys.readouterr()
    before = {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()}
    assert main(command) == 2
    errors = capsys.readouterr().err
    assert "--overwrite" in errors
    assert (errors.count("\n"), "Traceback" in errors) == (1, False)
    assert {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()} == before


@pytest.mark.parametrize("name", ["energies.csv", "trajectory.dcd", "picture.png", "start.xml"])
def test_files_of_others_are_seen_before_anything_is_prepared(droplet, tmp_path, capsys, name):
    out = tmp_path / "out"
    out.mkdir()
    (out / name).write_text("something else")
    steps = "--step", "2fs", "--duration", "2fs", "--equilibrate", "0.002", "--platform", "Reference"
    assert main(["run", str(droplet), "--forcefield", "tip3p.xml", *steps, "--out", str(out)]) == 2
    errors = capsys.readouterr().err
    assert f"{name} belongs to an earlier run" in errors
    assert errors.count("\n") == 1
    assert {file.name: file.read_text(encoding="utf-8") for file in out.iterdir()} == {name: "something else"}


@pytest.mark.parametrize("nothing", [None, 3, b"state.xml"])
def test_a_state_is_one_or_a_file_of_one(serialised, nothing):
    system = openmm.XmlSerializer.deserialize(serialised[0].read_text(encoding="utf-8"))
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    with pytest.raises(ValueError, match=f"saveState wrote, not {type(nothing).__name__}"):
        rb.loadState(context, nothing)


def test_molecules_that_are_interleaved_need_a_topology():
    system = openmm.System()
    for _ in range(4):
        system.addParticle(1.0)
    system.addConstraint(0, 2, 0.1)
    system.addConstraint(1, 3, 0.1)
    context = context_of(system, openmm.VerletIntegrator(0.001), [openmm.Vec3(i, 0, 0) for i in range(4)])
    with pytest.raises(ValueError, match="pass a PDB or PDBx file and --forcefield instead"):
        topology_of(system, context.getState(positions=True))
