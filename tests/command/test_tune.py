"""``exactrb tune`` gives the advice of `rb.tune` for files, and reports a mistake in one line."""

import pytest

from openmm_exactrb.command.main import main

SHORT = ["--schemes", "S2_2", "--platform", "Reference", "--duration", "0.1", "--horizon", "300fs"]


def test_it_prints(serialised, capfd):
    assert main(["tune", *map(str, serialised), *SHORT, "--target", "1e-2"]) == 0
    out, errors = capfd.readouterr()
    assert "target 0.01: S2_2 with a step of " in out
    assert "S2_2, " in errors
    assert "errors hold for 0.3 ps (budget: 120 s of processor time)" in errors
    assert "Warning" not in errors


def test_it_reads_what_a_run_reads(droplet, capsys):
    files = [str(droplet), "--forcefield", "tip4pew.xml"]
    assert main(["tune", *files, *SHORT, "--target", "0.05", "--temperature", "250", "--budget", "10", "--quiet"]) == 0
    out, errors = capsys.readouterr()
    assert "8 bodies on Reference" in out
    assert "brought to 250 K" in " ".join(out.split())
    assert errors == ""
    assert main(["tune", *files, "--cutoff", "0.5"]) == 2
    assert "--cutoff has no effect without a periodic box: omit --cutoff" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["state.xml", "system.xml"], "contains an object of type State, not System"),
        (["system.xml", "nowhere.xml"], "the file nowhere.xml does not exist"),
        (["picture.xml", "state.xml"], "is not a valid file of openmm.XmlSerializer"),
        ([], "exactrb tune: molecules are missing: pass one file"),
        (["system.xml", "state.xml", "--schemes", "W4"], "did you mean 'W4_4'?"),
    ],
)
def test_a_mistake_is_one_line(serialised, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "picture.xml").write_text("a picture")
    assert main(["tune", *arguments]) == 2
    out, errors = capsys.readouterr()
    assert errors.startswith("exactrb tune: ")
    assert message in errors
    assert errors.count("\n") == 1
    assert out == ""


def test_a_budget_that_allows_no_measurement_is_one_line(serialised, capsys):
    assert main(["tune", *map(str, serialised), "--budget", "1e-6", "--quiet"]) == 2
    out, errors = capsys.readouterr()
    assert out == ""
    spent = "the budget of 1e-06 s of processor time was spent before the first result: use a larger budget"
    assert errors == f"exactrb tune: {spent}\n"
