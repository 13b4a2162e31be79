"""The paper's figures are drawn, and its claims are put beside numbers, by one command."""

import importlib
import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import mpmath as mp
import numpy as np
import openmm
import pytest

import oracle
from openmm_exactrb.files import written_whole

REPORT = Path(__file__).parent.parent / "benchmarks" / "paper" / "report.py"
sys.path.append(str(REPORT.parent))
claims = importlib.import_module("claims")


@pytest.fixture(scope="module")
def quick(tmp_path_factory, worker_id):
    """Return a copy of the quick report, which takes all cores: the first of several workers has it written."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "paper"
    said = folder / "said"
    try:
        folder.mkdir()
    except FileExistsError:
        wait_for(said)
    else:
        done = subprocess.run([sys.executable, str(REPORT), "--quick"], cwd=folder, capture_output=True, text=True)
        with written_whole(said) as out:
            out.write(done.stderr if done.returncode else "")
    assert said.read_text(encoding="utf-8") == ""
    out = shutil.copytree(folder / "out", tmp_path_factory.mktemp("copy") / "out")
    return out / "paper" / "quick"


def wait_for(file, seconds=600.0):
    end = time.monotonic() + seconds
    while not file.exists():
        assert time.monotonic() < end, f"another worker has not written {file}"
        time.sleep(0.2)


def test_every_figure_is_drawn_and_shown(quick):
    page = (quick / "paper.md").read_text(encoding="utf-8")
    shown = re.findall(r"\(paper/(figure\d\d)\.png\)", page)
    assert sorted(shown) == [f"figure{k:02d}" for k in range(1, 19)]
    for name in shown:
        assert (quick / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def written(page):
    """Return the claims of a page: what stands from one to the next or to the end of the list."""
    return re.findall(r"^- \*.*\*\*\n(?:  - .*\n)+", page, re.MULTILINE)


def verdict_of(entry):
    """Read a claim: its verdict, and what its printed criteria amount to."""
    criteria = [line for line in entry.splitlines() if line.startswith("  - Criterion: ")]
    found = [re.search(r"\((?:met in (\d+) of (\d+) draws|(met)|(not met))\)\.$", line) for line in criteria]
    always = [m[3] is not None or (m[1] is not None and m[1] == m[2]) for m in found]
    sometimes = [m[3] is not None or (m[1] is not None and int(m[1]) > 0) for m in found]
    kind = 3 if not criteria else 0 if all(always) else 1 if any(sometimes) else 2
    return re.search(r"\*\*(.+)\.\*\*$", entry.splitlines()[0])[1].lower(), kind


def test_every_verdict_follows_from_the_criteria_beside_it(quick):
    page = (quick / "paper.md").read_text(encoding="utf-8")
    assert len(written(page)) == page.count("  - Measured: ") > 30
    for entry in written(page):
        verdict, kind = verdict_of(entry)
        assert verdict in (claims.VERDICTS[kind], claims.OURS[kind]), entry


def test_the_papers_claims_and_ours_are_counted_apart(quick):
    page = (quick / "paper.md").read_text(encoding="utf-8")
    beyond = sum(len(written(part.split("\n## ")[0])) for part in page.split("Beyond the paper:\n")[1:])
    assert beyond > 3
    assert int(re.search(r"Of (\d+) sentences of our own", page)[1]) == beyond
    assert int(re.search(r"Of (\d+) claims of the paper", page)[1]) == len(written(page)) - beyond


def test_no_verdict_compares_compiled_code_with_numpy(quick):
    page = (quick / "paper.md").read_text(encoding="utf-8")
    compiled = [line for line in page.splitlines() if "exact_compiled" in line]
    assert compiled
    assert all("| compiled |" in line for line in compiled)  # rows of tables, where it is marked


@pytest.mark.parametrize(
    ("outcomes", "verdict"),
    [
        ([[True, True], True], "agrees"),
        ([[True, False], True], "agrees in part"),
        ([[False, False], True], "agrees in part"),
        ([[True, False]], "agrees in part"),
        ([[False, False], False], "does not agree"),
        ([], "cannot be decided"),
    ],
)
def test_a_verdict_is_what_the_criteria_say(outcomes, verdict):
    criteria = tuple(claims.Criterion.of("it is so", outcome) for outcome in outcomes)
    claim = claims.Claim("A sentence.", "numbers.", criteria)
    assert claim.verdict == verdict
    own = claims.Claim("A sentence.", "numbers.", criteria, ours=True)
    assert claims.OURS.index(own.verdict) == claims.VERDICTS.index(verdict)


def test_a_criterion_without_an_outcome_is_refused():
    with pytest.raises(ValueError, match="needs an outcome"):
        claims.Criterion.of("nothing was measured", [])


def test_the_summary_counts_and_names_what_does_not_agree():
    met, unmet = claims.Criterion.of("one", True), claims.Criterion.of("two", False)
    judged = [
        ("Figure 1", claims.Claim("First.", "", (met,))),
        ("Figure 1", claims.Claim("Second.", "", (met, unmet))),
        ("Figure 2", claims.Claim("Third.", "", (unmet,))),
        ("Figure 2", claims.Claim("Ours.", "", (met,), ours=True)),
    ]
    text = claims.summary(judged)
    assert "Of 3 claims of the paper, 1 agrees, 1 agrees in part and 1 does not agree." in text
    assert "Of 1 sentences of our own, which go beyond the paper, 1 holds." in text
    assert [name in text for name in ("- First.", "- Second. (Figure 1)", "- Third. (Figure 2)")] == [False, True, True]


def test_the_energies_by_which_starts_are_chosen_are_openmms(quick):
    figure16 = importlib.import_module("figure16")
    system, sites = figure16.spheres()
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    for seed in (327, 1554):  # two with a close pair
        context.setPositions((figure16.centres(seed)[:, None] + sites).reshape(-1, 3))
        expected = context.getState(energy=True).getPotentialEnergy()._value
        assert figure16.potential(seed) == pytest.approx(expected, rel=1e-12)


def test_the_satellite_is_the_papers(quick):
    data = json.loads((quick / "data" / "satellite.json").read_text(encoding="utf-8"))
    assert abs(data["SRKN6_14a exact 0.1"]["H0"] - 1.21595664e7) < 1.0
    assert data["SRKN6_14a exact 0.1"]["largest"] < 2e-7


def test_what_is_computed_is_kept(quick):
    pieces = {file: file.stat().st_mtime_ns for file in (quick.parent / "pieces").rglob("*.json")}
    assert pieces
    subprocess.run([sys.executable, str(REPORT.parent / "satellite.py"), "--quick"], cwd=quick.parents[2], check=True)
    assert pieces == {file: file.stat().st_mtime_ns for file in pieces}


def test_the_page_is_written_anew_from_what_is_stored(quick):
    page = (quick / "paper.md").read_text(encoding="utf-8")
    (quick / "paper.md").unlink()
    data = {file: file.stat().st_mtime_ns for file in (quick / "data").iterdir()}
    subprocess.run([sys.executable, str(REPORT), "--quick", "--stored"], cwd=quick.parents[2], check=True)
    assert (quick / "paper.md").read_text(encoding="utf-8") == page
    assert data == {file: file.stat().st_mtime_ns for file in data}


def test_the_reference_has_thirty_digits():
    reference = pytest.importorskip("reference")
    inertia, m = oracle.random_bodies("generic", 6, seed=2)
    q, m1 = reference.taylor(inertia.T, m.T, 3.0)
    for body in range(6):
        rotation, momentum = oracle.free_rotor(inertia[body], [1, 0, 0, 0], m[body], 3.0)
        expected = np.array([np.longdouble(mp.nstr(x, 25)) for x in momentum])
        np.testing.assert_allclose((m1[:, body] - expected).astype(float), 0.0, atol=1e-18)
        w, x, y, z = q[:, body]
        entry = np.longdouble(mp.nstr(rotation[0, 1], 25))
        assert abs(float(2 * (x * y - w * z) - entry)) < 1e-18
