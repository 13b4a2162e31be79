"""``exactrb exec``: scripts that were written for OpenMM, as a user would run them."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import openmm
import pytest

from openmm_exactrb.command.main import main

DATA = Path(__file__).parents[1] / "data"
PEPTIDE = Path(__file__).parents[2] / "examples" / "data" / "alanine_dipeptide.pdb"

# As OpenMM's simulateAmber.py.
SIMULATE = """
    import sys
    from openmm.app import *
    from openmm import *
    from openmm.unit import *

    inpcrd = AmberInpcrdFile(r"{data}/two_waters.rst7")
    prmtop = AmberPrmtopFile(r"{data}/two_waters.prmtop")
    system = prmtop.createSystem(nonbondedMethod=NoCutoff, constraints=HBonds, rigidWater=True)
    integrator = LangevinMiddleIntegrator(300*kelvin, 1/picosecond, 0.002*picoseconds)
    simulation = Simulation(prmtop.topology, system, integrator, Platform.getPlatform("Reference"))
    simulation.context.setPositions(inpcrd.positions)
    simulation.minimizeEnergy(maxIterations=10)
    simulation.reporters.append(StateDataReporter(sys.stdout, 20, step=True, time=True))
    simulation.step(40)
    print(type(integrator).__mro__[2].__name__, sys.argv[1:], system.getParticleMass(1)._value)
"""

# Organised as the openmm_run.py that CHARMM-GUI provides: stages with input files, a restart file, and reporters.
STAGES = '''
    """Minimise, equilibrate and produce, with the settings of a file."""
    import argparse
    import sys
    from openmm import *
    from openmm.app import *
    from openmm.unit import *

    parser = argparse.ArgumentParser()
    parser.add_argument("-i", dest="settings")
    parser.add_argument("-p", dest="structure")
    parser.add_argument("-irst", dest="begin")
    parser.add_argument("-orst", dest="end")
    parser.add_argument("-odcd", dest="frames")
    args = parser.parse_args()

    inputs = {}
    with open(args.settings) as settings:
        for line in settings:
            name, value = line.split("=")
            inputs[name.strip()] = float(value)

    structure = PDBFile(args.structure)
    field = ForceField("amber14-all.xml", "amber14/tip3p.xml")
    model = Modeller(structure.topology, structure.positions)
    model.addSolvent(field, boxSize=Vec3(2.2, 2.2, 2.2)*nanometers)
    system = field.createSystem(model.topology, nonbondedMethod=PME, nonbondedCutoff=0.9*nanometers,
                                constraints=HBonds, ewaldErrorTolerance=0.0005)
    if inputs["pressure"]:
        system.addForce(MonteCarloBarostat(inputs["pressure"]*bar, inputs["temp"]*kelvin, int(inputs["p_freq"])))
    integrator = LangevinIntegrator(inputs["temp"]*kelvin, inputs["fric"]/picosecond, inputs["dt"]*picoseconds)
    simulation = Simulation(model.topology, system, integrator, Platform.getPlatform("CPU"))
    simulation.context.setPositions(model.positions)
    if args.begin:
        with open(args.begin) as begin:
            simulation.context.setState(XmlSerializer.deserialize(begin.read()))
    else:
        simulation.minimizeEnergy(maxIterations=int(inputs["mini"]))
        simulation.context.setVelocitiesToTemperature(inputs["temp"]*kelvin, 1)
    if args.frames:
        simulation.reporters.append(DCDReporter(args.frames, int(inputs["nstdcd"])))
    simulation.reporters.append(StateDataReporter(sys.stdout, int(inputs["nstout"]), step=True, time=True,
        potentialEnergy=True, temperature=True, progress=True, remainingTime=True, speed=True,
        totalSteps=int(inputs["nstep"]), separator="\\t"))
    simulation.step(int(inputs["nstep"]))
    state = simulation.context.getState(getPositions=True, getVelocities=True)
    with open(args.end, "w") as end:
        end.write(XmlSerializer.serialize(state))
    print("ended at", state.getTime(), "after", simulation.currentStep)
'''
EQUILIBRATION = "mini = 50\nnstep = 40\ndt = 0.001\nnstout = 20\nnstdcd = 20\ntemp = 300\nfric = 1\npressure = 0\n"
PRODUCTION = "nstep = 80\ndt = 0.002\nnstout = 40\nnstdcd = 20\ntemp = 300\nfric = 1\npressure = 1\np_freq = 100\n"


@pytest.fixture
def script(tmp_path):
    """Return a function that writes a script and returns its name."""

    def written(text, **values):
        file = tmp_path / "script.py"
        text = textwrap.dedent(text)
        file.write_text(text.format(**values) if values else text, encoding="utf-8")
        return str(file)

    return written


def test_a_script_runs_with_ours_and_its_arguments(script, capsys):
    assert main(["exec", script(SIMULATE, data=DATA), "--interval", "3fs", "more"]) == 0
    out, told = capsys.readouterr()
    assert out.splitlines()[1:3] == ["20,0.04000000000000002", "40,0.08000000000000006"]
    assert "ExactRigidBodyLangevinIntegrator ['--interval', '3fs', 'more'] 1.0" in out
    assert told.splitlines()[0].endswith(
        "ExactRigidBodyLangevinIntegrator (BAOA) instead of LangevinMiddleIntegrator: a step is 2 fs with one force "
        "evaluation"
    )
    assert "replaced 1 LangevinMiddleIntegrator, which made 40 steps of 0.08 ps together" in told
    assert "1.0 times as many" in told
    assert type(openmm.LangevinMiddleIntegrator(300, 1, 0.002)) is openmm.LangevinMiddleIntegrator


@pytest.mark.parametrize(
    ("options", "times", "mass", "gain"),
    [
        (["--interval", "4fs"], "0.08 0.16", "1.0", "2.0"),
        (["--interval", "8fs", "--heavy-hydrogens"], "0.16 0.32", "3.0", "4.0"),
        (["--interval", "8fs", "--heavy-hydrogens", "--same-time"], "0.04 0.08", "3.0", "4.0"),
    ],
)
def test_intervals(script, capsys, options, times, mass, gain):
    assert main(["exec", *options, script(SIMULATE, data=DATA)]) == 0
    out, told = capsys.readouterr()
    rows = [line.split(",") for line in out.splitlines()[1:3]]
    assert [step for step, _ in rows] == ["20", "40"]
    assert [float(time) for _, time in rows] == pytest.approx([float(time) for time in times.split()])
    assert f"[] {mass}" in out
    assert f"{gain} times as many" in told


def test_stages_of_a_protocol(script, tmp_path, capsys):
    file = script(STAGES)
    for name, text in (("eq.inp", EQUILIBRATION), ("prod.inp", PRODUCTION)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    given = ["-p", str(PEPTIDE), "-orst", str(tmp_path / "eq.rst"), "-i", str(tmp_path / "eq.inp")]
    assert main(["exec", file, *given]) == 0
    assert "ended at 0.04" in capsys.readouterr().out
    begin = str(tmp_path / "eq.rst")
    given = ["-p", str(PEPTIDE), "-orst", str(tmp_path / "prod.rst"), "-i", str(tmp_path / "prod.inp"), "-irst", begin]
    frames = ["-odcd", str(tmp_path / "prod.dcd")]
    assert main(["exec", "--interval", "8fs", "--heavy-hydrogens", file, *given, *frames]) == 0
    out, told = capsys.readouterr()
    assert "ended at 0.68" in out
    assert "n steps of the script stay n steps, and have 4 times the simulated time" in told
    assert "80 force evaluations; OpenMM's integrators, at the steps of the script, need 320" in told
    assert int.from_bytes((tmp_path / "prod.dcd").read_bytes()[8:12], sys.byteorder) == 4  # frames


def test_an_error_of_the_script_is_shown_as_by_python(script, capsys):
    file = script(
        "import openmm\n\ndef fail():\n    openmm.VerletIntegrator(0.001)\n    raise ValueError('mine')\n\nfail()\n"
    )
    assert main(["exec", file]) == 1
    errors = capsys.readouterr().err
    assert errors.count("File ") == 2
    assert f'Traceback (most recent call last):\n  File "{file}", line 7, in <module>' in errors
    assert "ValueError: mine" in errors
    assert "replaced 1 VerletIntegrator" in errors


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["no_such.py"], "the file no_such.py does not exist"),
        (["--same-time", __file__], "same_time needs an interval"),
    ],
)
def test_wrong_input_is_one_line(options, message, capsys):
    assert main(["exec", *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("exactrb exec: ")
    assert message in line


@pytest.mark.parametrize(
    ("end", "status"), [("sys.exit(3)", 3), ("", 0), ("sys.exit()", 0), ("raise KeyboardInterrupt", 130)]
)
def test_the_status_is_that_of_the_script_and_threads_are_awaited(script, end, status):
    """In a process of its own, with a module beside the script."""
    text = f"""
        import sys, threading, time
        import beside
        from openmm import VerletIntegrator

        def later():
            time.sleep(0.3)
            print(type(VerletIntegrator(0.001)).__name__, __name__, beside.name)

        threading.Thread(target=later).start()
        {end}
    """
    file = Path(script(text))
    file.with_name("beside.py").write_text("name = 'found'\n", encoding="utf-8")
    command = [sys.executable, "-m", "openmm_exactrb.command.main", "exec", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ, check=False, cwd=file.parent)
    assert done.returncode == status
    assert done.stdout == "VerletReplacement __main__ found\n"
