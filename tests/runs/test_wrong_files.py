"""A file that is wrong is one line, and leaves nothing."""

import pytest
from processes import finish
from small_droplets import one_line


def refused(folder):
    status, errors = finish(folder / "errors", "water_box.py", "--pdb", folder / "box.pdb", "--out", folder / "out")
    assert status == 1
    return errors


ATOM = "HETATM    1  O   HOH A   1       0.000   0.000   0.000  1.00  0.00           O  "


@pytest.mark.parametrize("content", ["", "END", ATOM, ATOM[:24] + "\nEND\n", "\x88"])
def test_a_wrong_pdb_file_is_one_line_and_leaves_nothing(tmp_path, content):
    (tmp_path / "box.pdb").write_bytes(content.encode("latin1"))
    errors = refused(tmp_path)
    assert "box.pdb is no PDB file, or a truncated one: " in one_line(errors)
    assert not (tmp_path / "out").exists()


def test_a_pdb_file_without_all_atoms_is_one_line(tmp_path):
    (tmp_path / "box.pdb").write_text(
        f"CRYST1   20.000   20.000   20.000  90.00  90.00  90.00 P 1           1\n{ATOM}\nEND\n"
    )
    errors = refused(tmp_path)
    assert "HOH" in one_line(errors)
    assert not (tmp_path / "out").exists()
