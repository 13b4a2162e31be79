"""``exactrb info FILE``: what is found in files of each format, the steps that suit it, and what is refused."""

import itertools
import re
import shutil
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.command.description import PROTEIN, PROTEIN_AND_WATER, described
from openmm_exactrb.command.main import main
from peptides import in_water
from starts import context_of

DATA = Path(__file__).parent.parent / "data"
ROOT = Path(__file__).parents[2]

TOP = """[ defaults ]
1 2 no 1.0 1.0
[ atomtypes ]
OW 8 15.9994 0.0 A 0.3166 0.65017
HW 1 1.00794 0.0 A 0.0 0.0
[ moleculetype ]
SOL 2
[ atoms ]
1 OW 1 SOL OW 1 -0.8476
2 HW 1 SOL HW1 1 0.4238
3 HW 1 SOL HW2 1 0.4238
[ settles ]
1 1 0.1 0.16330
[ exclusions ]
1 2 3
2 1 3
3 1 2
[ system ]
two
[ molecules ]
SOL 2
"""
GRO = """two waters
    6
    1SOL     OW    1   0.000   0.000   0.000
    1SOL    HW1    2   0.100   0.000   0.000
    1SOL    HW2    3  -0.033   0.094   0.000
    2SOL     OW    4   0.500   0.000   0.000
    2SOL    HW1    5   0.600   0.000   0.000
    2SOL    HW2    6   0.467   0.094   0.000
   2.50000   2.50000   2.50000
"""


def said(capsys, *arguments):
    assert main(["info", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_water_in_a_pdb_file_is_bodies_with_virtual_sites_and_has_a_step(droplet, capsys):
    lines = said(capsys, droplet, "--forcefield", "tip4pew.xml")
    assert "32 particles, 8 virtual sites, 24 constraints" in lines
    assert "8 rigid bodies of 3 particles (HOH): 6 degrees of freedom, moments 0.006145 0.01155 0.0177 amu nm²" in lines
    assert "degrees of freedom: 24 of translation and vibration, 24 of rotation" in lines
    assert 'ExactRigidBodyIntegrator(forceInterval=2*femtoseconds, scheme="W4_4")' in lines
    assert "constant temperature: openmm.LangevinMiddleIntegrator(300*kelvin, 5/picosecond, 4*femtoseconds)" in lines
    assert "everything is supported" in lines


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # OpenMM leaves the file open
def test_a_topology_of_gromacs_is_read_with_its_positions_in_either_order(tmp_path, capsys):
    files = tmp_path / "two.gro", tmp_path / "two.top"
    for file, text in zip(files, (GRO, TOP), strict=True):
        file.write_text(text)
    for order in (files, files[::-1]):
        lines = said(capsys, *order)
        assert "periodic box, 2.5 x 2.5 x 2.5 nm" in lines
        assert "2 rigid bodies of 3 particles (HOH)" in lines
        assert "positions deviated from the shapes of bodies and were corrected (bodies affected: 2)" in lines
    *atoms, _ = GRO.splitlines()
    files[0].write_text("\n".join([*atoms, "   0.0 0.0 0.0", ""]))  # as GROMACS writes it without a box
    assert "periodic box" not in said(capsys, *files)
    files[0].write_text("\n".join(atoms[:-2]))
    assert main(["info", *map(str, files)]) == 2
    assert "two.gro is incomplete, or has another format" in capsys.readouterr().err
    files[0].write_text(GRO)
    files[1].write_text(TOP.removesuffix("2\n") + "3\n")
    assert main(["info", *map(str, files)]) == 2
    assert "(6) and in" in capsys.readouterr().err


def test_a_topology_of_amber_is_read_with_its_positions_in_either_order(tmp_path, capsys):
    """Two of TIP3P as LEaP writes them, with a bond between the hydrogens."""
    files = [DATA / "two_waters.prmtop", DATA / "two_waters.rst7"]
    for order in (files, files[::-1]):
        lines = said(capsys, *order)
        assert "6 particles, 6 constraints" in lines
        assert "periodic box, 2.5 x 2.5 x 2.5 nm" in lines
        assert "2 rigid bodies of 3 particles (HOH): 6 degrees of freedom, moments 0.006149 0.01155 0.0177" in lines
        assert "everything is supported" in lines
    short = tmp_path / "one.rst7"
    header, count, *rows, box = files[1].read_text(encoding="utf-8").splitlines()
    short.write_text("\n".join([header, count.replace("6", "5", 1), *rows[:2], rows[2][:36], box, ""]))
    assert main(["info", str(files[0]), str(short)]) == 2
    assert "(5) and in" in capsys.readouterr().err
    cut = tmp_path / "cut.rst7"
    cut.write_text("\n".join([header, count, *rows, ""]))
    assert main(["info", str(files[0]), str(cut)]) == 2
    assert "has a periodic box, but" in capsys.readouterr().err
    assert main(["info", str(files[0])]) == 2
    assert "a prmtop and an inpcrd" in capsys.readouterr().err
    assert main(["info", str(shutil.copy(short, tmp_path / "no.prmtop")), str(files[1])]) == 2
    assert "no.prmtop" in capsys.readouterr().err


def test_a_system_alone_is_described_by_its_constraints(serialised, capsys):
    lines = said(capsys, serialised[0])
    assert "8 rigid bodies of 3 particles: 6 degrees of freedom" in lines
    assert "no positions were given" in lines
    assert "everything is supported" in said(capsys, *serialised)


def test_a_peptide_in_water_gets_its_bonded_forces_nested_and_its_periods_named():
    """The carbonyl bond of amber14 has 570 kcal/mol/Å²."""
    topology, system, positions = in_water("HBonds")[:3]
    lines = list(described(system, openmm.unit.Quantity(positions, openmm.unit.nanometer), topology))
    k, reduced = 2 * 570 * 418.4, 12.01 * 16.0 / (12.01 + 16.0)
    (periods,) = (line for line in lines if line.startswith("shortest periods"))
    assert f"{2000 * np.pi * np.sqrt(reduced / k):.3g} fs (bond of C 4, O 5)" in periods
    assert any("3 clusters of 4 particles (ACE, ALA, NME): 9 degrees of freedom" in line for line in lines)
    (energy,) = (line for line in lines if line.startswith("constant energy"))
    assert energy.endswith("rb.ExactRigidBodyIntegrator(4*femtoseconds)")


CONSTANT_TEMPERATURE = re.compile(
    r"rb.ExactRigidBodyLangevinIntegrator\(300\*kelvin, 5/picosecond, "
    r"(?:forceInterval=)?([0-9.]+)\*femtoseconds(?:, scheme=\"(\w+)\")?\)"
)


@pytest.mark.parametrize(
    ("constraints", "mass", "longest"),
    [("HBonds", None, 4.0), ("HBonds", 3.0, 8.0), ("AllBonds", 3.0, 8.0), ("None", None, 4.0), ("None", 3.0, 8.0)],
)
def test_the_intervals_at_constant_temperature_are_those_that_no_warning_follows(constraints, mass, longest):
    topology, system, positions = in_water(constraints)
    if mass is not None:
        rb.heavy_hydrogens(system, topology, mass)
    lines = list(described(system, openmm.unit.Quantity(positions, openmm.unit.nanometer), topology))
    found = [CONSTANT_TEMPERATURE.search(line) for line in lines if line.startswith("constant temperature")]
    calls = [(float(call[1]), call[2] or PROTEIN) for call in found if call]
    assert (PROTEIN_AND_WATER in dict(map(reversed, calls))) == (mass is not None)
    assert bool(calls) == (mass is not None or constraints == "None")
    for interval, scheme in calls:
        assert interval <= longest
        assert constraints == "None" or interval == longest
        integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, forceInterval=1e-3 * interval, scheme=scheme)
        _context = context_of(system, integrator, positions)
        integrator.setVelocitiesToTemperature(300.0, 1)
        integrator.step(1)  # a warning would be an error


@pytest.mark.parametrize(
    ("mass", "theirs", "hint"), [(None, 4, "--hydrogen-mass 3"), (3.0, 8, "with constraints=AllBonds")]
)
def test_openmm_at_the_same_cost_is_named_for_a_protein(mass, theirs, hint):
    """And for light hydrogens the masses that allow 8 fs."""
    topology, system, positions = in_water("HBonds")
    if mass is not None:
        rb.heavy_hydrogens(system, topology, mass)
    lines = "\n".join(described(system, openmm.unit.Quantity(positions, openmm.unit.nanometer), topology))
    assert f"openmm.LangevinMiddleIntegrator(300*kelvin, 5/picosecond, {theirs}*femtoseconds)" in lines
    assert hint in lines
    assert ("--hydrogen-mass" in lines) == (mass is None)
    assert "rb.ExactRigidBodyLangevinIntegrator(300*kelvin, 5/picosecond, 8*femtoseconds)" in lines


def test_calls_that_are_printed_stand_on_the_page_of_recommendations(droplet, capsys):
    lines = said(capsys, droplet, "--forcefield", "tip4pew.xml")
    for mass in (None, 3.0):
        topology, system, positions = in_water("HBonds")
        if mass is not None:
            rb.heavy_hydrogens(system, topology, mass)
        lines += "\n".join(described(system, openmm.unit.Quantity(positions, openmm.unit.nanometer), topology))
    page = re.sub(r"\s", "", (ROOT / "docs" / "which.md").read_text(encoding="utf-8"))
    calls = re.findall(r"(?:rb|openmm)\.(\w+Integrator)\((?:300\*kelvin, 5/picosecond, )?([^)]*)\)", lines)
    assert len(set(calls)) == 7
    for name, settings in calls:  # the page has whole calls, settings with a scheme, or OpenMM's integrators at a step
        whole, short = settings.replace(" ", ""), settings.replace("*femtoseconds", "fs")
        forms = f"{name}({whole})", f"{name}(300*kelvin,5/picosecond,{whole})", f"{name}({short})"
        assert any(form in page for form in (*forms, *([whole] if "scheme" in whole else []))), (name, settings)


def pairs_of(n, longer):
    system, x = openmm.System(), 0.3 * np.random.default_rng(1).random((n, 3))
    for _ in range(n):
        system.addParticle(12.0)
    for i, j in itertools.combinations(range(5), 2):
        system.addConstraint(i, j, np.linalg.norm(x[i] - x[j]) + (longer if i == 0 else 0.0))
    system.addConstraint(n - 2, n - 1, np.linalg.norm(x[n - 2] - x[n - 1]))
    return system, openmm.unit.Quantity(x, openmm.unit.nanometer)


def test_what_is_redundant_and_what_is_refused_is_said_in_a_sentence():
    lines = list(described(*pairs_of(6, 0.0)))
    assert "and 10 constraints; 1 more are redundant, such as that of particles 3, 4" in " ".join(lines)
    assert lines[-1] == "everything is supported"
    assert list(described(*pairs_of(6, 0.003)))[-1].startswith(
        "not supported: the constraint of 0.115306 nm between particles 3 and 4"
    )


def test_what_acts_between_steps_is_named():
    _, system, x = rb.rigid_water(8, nonbondedMethod=app.NoCutoff)
    number = system.addForce(openmm.AndersenThermostat(300.0, 1.0))
    assert "acting between steps: AndersenThermostat" in list(described(system, x))
    system.getForce(number).setDefaultCollisionFrequency(0.0)
    assert not any("acting between steps" in line for line in described(system, x))


@pytest.mark.parametrize("files", [["a.top"], ["a.gro", "b.pdb", "c.xml"], ["a.txt"]])
def test_files_that_say_nothing_together_are_refused(files, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in files:
        Path(file).touch()
    assert main(["info", *files]) == 2
    assert "pass one file (PDB" in capsys.readouterr().err


def test_heavy_hydrogens_have_longer_periods(droplet, serialised, capsys):
    """The moments of TIP3P, and a System that is given keeps its masses."""
    plain = [str(droplet), "--forcefield", "tip3p.xml"]
    moments = []
    for options in (plain, [*plain, "--hydrogen-mass", "3"]):
        assert main(["info", *options]) == 0
        line = next(line for line in capsys.readouterr().out.splitlines() if "moments" in line)
        moments.append([float(word) for word in line.split("moments ")[1].split()[:3]])
    assert (2.0 * np.array(moments[0]) < moments[1]).all()
    assert main(["info", *map(str, serialised), "--hydrogen-mass", "3"]) == 2
    assert "which already contains masses: omit --hydrogen-mass" in capsys.readouterr().err
