"""How files of molecules end, and the boxes in them: what is read, and which sentence follows if it is not."""

import io
import re
import warnings

import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.command.main import main

FIELD = "--forcefield", "tip3p.xml"


def lines_of(writer, *arguments):
    topology, _, positions = rb.rigid_water(8, *arguments)
    text = io.StringIO()
    writer(topology, positions, text)
    return text.getvalue().splitlines()


PDB = lines_of(app.PDBFile.writeFile)
ATOMS = [line for line in PDB if line.startswith("HETATM")]
CELL = "CRYST1{:9.3f}{:9.3f}{:9.3f}  90.00  90.00  90.00 P 1           1"


def info(capsys, tmp_path, lines, name="some.pdb", end="\n"):
    """Return the status of `exactrb info` for a file with these lines, its output and what it prints on stderr."""
    file = tmp_path / name
    file.write_text("\n".join(lines) + end, encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("always")  # which the command prints
        status = main(["info", str(file), *FIELD])
    return status, *capsys.readouterr()


@pytest.mark.parametrize("before", [[], ["REMARK"], [CELL.format(25.0, 25.0, 25.0)], ["HEADER", "", "MODEL        1"]])
@pytest.mark.parametrize(
    "end", ["END", "END   ", "ENDMDL", "TER", "MASTER        0    0", "CONECT    1    2", "TER\n\n"]
)
def test_a_file_that_ends_behind_its_atoms_is_complete(capsys, tmp_path, before, end):
    status, out, errors = info(capsys, tmp_path, [*before, *ATOMS, end])
    assert (status, errors) == (0, "")
    assert "8 rigid bodies of 3 particles" in out
    assert out.endswith("everything is supported\n")


@pytest.mark.parametrize("left_out", [0, 3, 9, 21])
@pytest.mark.parametrize("end", ["", "\n", "\n\n"])
def test_a_file_that_ends_with_an_atom_is_read_and_may_be_truncated(capsys, tmp_path, left_out, end):
    atoms = ATOMS[: len(ATOMS) - left_out]
    status, out, errors = info(capsys, tmp_path, atoms, end=end)
    assert status == 0
    assert f"{len(atoms)} particles" in out
    assert re.search(rf"warning: .* no END line, so it may be truncated: .* is H2 +HOH A +{len(atoms) // 3}\n$", errors)


@pytest.mark.parametrize("column", [6, 20, 30, 38, 46, 50, 53])
def test_a_file_that_ends_within_the_coordinates_of_an_atom_is_refused(capsys, tmp_path, column):
    status, out, errors = info(capsys, tmp_path, [*ATOMS[:8], ATOMS[8][:column]], end="")
    assert (status, out) == (2, "")
    assert "some.pdb is truncated, because its last line is incomplete: pass a complete PDB file\n" in errors


@pytest.mark.parametrize("lines", [[], ["END"], ["REMARK", "END"], ["hello"], [CELL.format(9, 9, 9)]])
def test_a_file_without_atoms_is_told_so(capsys, tmp_path, lines):
    status, out, errors = info(capsys, tmp_path, lines)
    assert (status, out) == (2, "")
    assert "some.pdb contains no atoms: pass a PDB file" in errors


@pytest.mark.parametrize("lines", [[], ["data_x"], ["data_x", "loop_"], ["hello"]])
def test_a_pdbx_file_without_atoms_is_incomplete(capsys, tmp_path, lines):
    status, _, errors = info(capsys, tmp_path, lines, "some.cif")
    assert status == 2
    assert "some.cif is incomplete, or has another format" in errors


def placeholder(edge):
    return "CRYST1" + 3 * edge.format(1.0) + "  90.00  90.00  90.00 P 1           1"


@pytest.mark.filterwarnings("ignore:the cell of 1")
@pytest.mark.parametrize("edge", ["{:9.3f}", "{:9.2f}", "{:9.0f}"])
def test_a_placeholder_is_no_box(capsys, tmp_path, edge):
    """Files of molecules that are not in a crystal have a cell of 1 Å."""
    status, out, errors = info(capsys, tmp_path, [placeholder(edge), *ATOMS, "END"])
    assert status == 0
    assert "periodic box" not in out
    assert errors.count("\n") == 1
    assert "the cell of 1 Å in" in errors


@pytest.mark.filterwarnings("ignore:the cell of 1")
def test_water_is_put_around_molecules_with_a_placeholder(capsys, tmp_path):
    info(capsys, tmp_path, [placeholder("{:9.3f}"), *ATOMS, "END"])
    solvated = [str(tmp_path / "some.pdb"), *FIELD, "--solvate", "600", "--water", "tip3p"]
    assert main(["info", *solvated]) == 0
    assert "608 rigid bodies" in capsys.readouterr().out


def test_a_placeholder_in_a_pdbx_file_is_no_box(capsys, tmp_path):
    lines = lines_of(app.PDBxFile.writeFile)
    cell = [f"_cell.{name} {value}" for name in ("length_a", "length_b", "length_c") for value in ["1"]]
    cell += [f"_cell.angle_{name} 90" for name in ("alpha", "beta", "gamma")]
    place = next(number for number, line in enumerate(lines) if line.startswith("loop_"))
    status, out, errors = info(capsys, tmp_path, [*lines[:place], *cell, "#", *lines[place:]], "some.cif")
    assert status == 0
    assert "periodic box" not in out
    assert "the cell of 1 Å in" in errors


@pytest.mark.parametrize(
    "edges", [(5.0, 5.0, 5.0), (30.0, 30.0, 1.0), (1.0, 1.0, 30.0), (2.0, 8.0, 8.0), (4.9, 5.1, 5.2)]
)
def test_a_box_that_cannot_hold_the_atoms_is_named(capsys, tmp_path, edges):
    """Whatever the cutoff."""
    status, _, errors = info(capsys, tmp_path, [CELL.format(*edges), *ATOMS, "END"])
    assert status == 2
    shown = " x ".join(f"{edge / 10:.4g}" for edge in edges)
    assert f"the periodic box of {shown} nm is too small for 24 atoms: correct the box in the file" in errors


@pytest.mark.parametrize("model", ["tip3p", "tip5p", "tip4pew"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_rounding_of_a_pdb_file_is_no_remark(capsys, tmp_path, model, seed):
    topology, _, positions = rb.rigid_water(125, seed, model=model)
    with (tmp_path / "water.pdb").open("w") as out:
        app.PDBFile.writeFile(topology, positions, out)
    assert main(["info", str(tmp_path / "water.pdb"), "--forcefield", f"{model}.xml"]) == 0
    out, errors = capsys.readouterr()
    assert "deviated" not in out + errors


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("HarmonicBondForce", "TorchForce"), "'TorchForce'): install the OpenMM plugin that defines this type"),
        (("HarmonicBondForce", "PlumedForce"), "'PlumedForce'): install the OpenMM plugin"),
        (('version="1"', 'version="77"'), "Unsupported version number): use the version of OpenMM that wrote the file"),
        (("<Particles>", "<Atoms>"), "pass a complete file that openmm.XmlSerializer wrote"),
        (("<System", "<Sys"), "pass a complete file that openmm.XmlSerializer wrote"),
    ],
)
def test_a_system_that_openmm_cannot_read_has_the_cause(capsys, tmp_path, change, sentence):
    system = openmm.System()
    system.addParticle(1.0)
    system.addForce(openmm.HarmonicBondForce())
    file = tmp_path / "system.xml"
    file.write_text(openmm.XmlSerializer.serialize(system).replace(*change))
    assert main(["info", str(file)]) == 2
    assert sentence in capsys.readouterr().err


def test_a_system_without_mass_needs_no_positions(capsys, tmp_path):
    file = tmp_path / "system.xml"
    file.write_text(openmm.XmlSerializer.serialize(openmm.System()))
    assert main(["info", str(file)]) == 0
    assert capsys.readouterr().out.endswith("set masses with setParticleMass\n")
