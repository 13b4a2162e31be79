"""Small rigid molecules, whose constraints are redundant or on a line, through all commands and from all files."""

import math
import re

import numpy as np
import openmm
import pytest

import small_molecules
from openmm_exactrb.command.main import main
from places import device_platform
from small_molecules import MOLECULES

# Degrees of freedom of a molecule: of translation, and of rotation.
FREEDOM = {"CO2": (3, 2), "N2": (3, 2), "CH4": (3, 3), "SF6": (3, 3), "C6H6": (3, 3), "MEOH": (3, 3)}
CASES = [(name, "xml", "CPU") for name in MOLECULES]
CASES += [("CH4", form, "CPU") for form in ("pdb", "gromacs", "amber")]
CASES += [
    ("CH4", "xml", "Reference"),
    ("N2", "amber", "CPU"),
    ("MEOH", "amber", "CPU"),
    ("CO2", "gromacs", "CPU"),
    ("C6H6", "pdb", "CPU"),
    ("CO2", "mixture", "CPU"),
]
CASES += [("CO2", "xml", "OpenCL")]
N = dict.fromkeys(MOLECULES, 27) | {"C6H6": 8}  # whose 66 constraints make Contexts slow
# Those of Amber, whose files have none.
CONSTRAINTS = {"N2": "AllBonds", "CH4": "HAngles", "MEOH": "HAngles"}
BRIEF = "--step", "2fs", "--duration", "8fs", "--interval", "4fs", "--no-picture", "--quiet"


def files_of(name, form, folder):
    """Return the arguments that name molecules."""
    arguments = getattr(small_molecules, f"as_{form}")(MOLECULES[name], N[name], folder)
    if form != "xml":
        arguments += ["--cutoff", "0.7", "--ewald-tolerance", "1e-3"]  # so that PME is cheap
    if form == "amber":
        arguments += ["--constraints", CONSTRAINTS[name]]
    return [*map(str, arguments)]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # OpenMM leaves files open
@pytest.mark.filterwarnings("ignore::openmm_exactrb.ShapeWarning")  # decimals of files
@pytest.mark.parametrize(
    ("name", "form", "platform"),
    [pytest.param(*case, marks=[pytest.mark.opencl] * (case[2] == "OpenCL"), id="-".join(case)) for case in CASES],
)
def test_they_are_found_prepared_and_run(name, form, platform, tmp_path, capsys):
    if platform == "OpenCL":
        device_platform(["OpenCL"])
    files = files_of(name, form, tmp_path)
    assert main(["info", *files]) == 0
    said = capsys.readouterr().out
    water = math.ceil(N[name] / 2) if form == "mixture" else 0
    translation, rotation = ((N[name] - water) * freedom + 3 * water for freedom in FREEDOM[name])
    assert f"degrees of freedom: {translation} of translation and vibration, {rotation} of rotation" in said
    assert "everything is supported" in said
    options = ["--ensemble", "nvt", "--temperature", "200", "--equilibrate", "0.3", "--platform", platform]
    assert main(["run", *files, *BRIEF, *options, "--out", str(tmp_path / "out")]) == 0
    table = np.loadtxt(tmp_path / "out" / "energies.csv", delimiter=",", skiprows=1)
    kinetic = table[0, 2:4] / (0.5 * 0.00831446 * 200.0)
    # Five standard deviations, and as much for what 0.3 ps leave of the start.
    for energy, freedom in zip(kinetic, (translation, rotation), strict=True):
        assert abs(energy / freedom - 1.0) < 10.0 * np.sqrt(2.0 / freedom)


@pytest.mark.validate
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::openmm_exactrb.ShapeWarning")
@pytest.mark.parametrize(
    ("name", "form", "platform"),
    [
        pytest.param("CH4", "xml", "OpenCL", marks=pytest.mark.opencl),
        ("CO2", "gromacs", "CPU"),
        ("CH4", "mixture", "CPU"),
        ("N2", "amber", "CPU"),
    ],
)
def test_a_step_is_found_for_them(name, form, platform, tmp_path, capsys):
    if platform == "OpenCL":
        device_platform(["OpenCL"])
    files = files_of(name, form, tmp_path)
    options = ["--temperature", "200", "--target", "0.05", "--schemes", "W2_1", "--duration", "0.05"]
    options += ["--horizon", "0.1ps", "--budget", "60", "--platform", platform, "--quiet"]
    assert main(["tune", *files, *options]) == 0
    assert "target 0.05: W2_1 with a step of" in capsys.readouterr().out


def test_temperatures_do_not_count_the_drift_between_removals(tmp_path, capsys):
    """Of two molecules, whose centre of mass a CMMotionRemover stops only every 10 000 steps."""
    system, state = small_molecules.as_xml(MOLECULES["CO2"], 2, tmp_path, cutoff=0.5)
    content = openmm.XmlSerializer.deserialize(system.read_text(encoding="utf-8"))
    content.removeForce(0)
    content.addForce(openmm.CMMotionRemover(10_000))
    system.write_text(openmm.XmlSerializer.serialize(content))
    options = "--ensemble nvt --temperature 260 --friction 5000 --step 2fs --interval 2fs --duration 0.2ps --seed 3"
    where = "--equilibrate", "0", "--platform", "Reference", "--no-picture", "--quiet", "--out", str(tmp_path / "out")
    assert main(["run", str(system), str(state), *options.split(), *where]) == 0
    found = re.search(r"temperature: translation (.*) K, rotation (.*) K", capsys.readouterr().out)
    for kelvin, freedom in zip(map(float, found.groups()), (3, 4), strict=True):
        assert abs(kelvin / 260.0 - 1.0) < 4.0 * math.sqrt(2.0 / (100 * freedom))
