"""``exactrb tune`` gives the advice of `rb.tune` for files, and reports a mistake in one line."""

import pytest

from openmm_exactrb.command.main import main


def test_it_prints_and_draws(serialised, tmp_path, capfd):
    options = ["--schemes", "S2_2", "--platform", "Reference", "--duration", "0.2", "--target", "1e-2"]
    picture = tmp_path / "picture.png"
    assert main(["tune", *map(str, serialised), *options, "--output", str(picture)]) == 0
    out, errors = capfd.readouterr()
    assert "target 0.01: S2_2 with a step of " in out
    assert "S2_2, " in errors
    assert "Warning" not in errors
    assert picture.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["state.xml", "system.xml"], "holds a State, not a System"),
        (["system.xml", "nowhere.xml"], "nowhere.xml"),
        (["picture.png", "state.xml"], "was not written by openmm.XmlSerializer"),
        (["system.xml", "state.xml", "--target=-1"], "target must be a positive number"),
    ],
)
def test_a_mistake_is_one_line(serialised, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "picture.png").write_text("a picture")
    assert main(["tune", *arguments]) == 2
    out, errors = capsys.readouterr()
    assert errors.startswith("exactrb tune: ")
    assert message in errors
    assert errors.count("\n") == 1
    assert out == ""
