"""The paper's figures are drawn, and its claims are put beside numbers, by one command.

The fast tests judge the page and the data of the last `make paper` and compute one script, small; with `--validate` all
scripts compute small versions.
"""

import json
import re
import shutil
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mpmath as mp
import numpy as np
import openmm
import pytest

import oracle
from benchmarks.paper import claims, common, compiled, figure01, figure16, reference, report, satellite
from openmm_exactrb import rotors

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "benchmarks" / "paper" / "report.py"
PAGES = ROOT / "docs" / "paper"
DATA = PAGES / "data"


# -- what `make paper` left -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def overview():
    """Return the page with all verdicts."""
    return PAGES.with_suffix(".md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pages():
    """Return the page of each script, by its name."""
    return {script.NAME: (PAGES / f"{script.NAME}.md").read_text(encoding="utf-8") for script in report.SCRIPTS}


@pytest.mark.skipif(not DATA.exists(), reason="a source distribution has no data")
def test_the_pages_are_what_the_stored_data_say(overview, pages):
    results = [(s, json.loads((DATA / f"{s.NAME}.json").read_text(encoding="utf-8"))) for s in report.SCRIPTS]
    assert report.overview(results) == overview
    assert {script.NAME: report.page(script, data) for script, data in results} == pages
    assert {file.stem for file in PAGES.glob("*.md")} == pages.keys()


def test_every_figure_is_shown_with_words_for_those_who_cannot_see_it(pages):
    shown = dict(
        found[::-1] for page in pages.values() for found in re.findall(r"!\[(.*?)\]\((figure\d\d)\.png\)", page)
    )
    assert sorted(shown) == [f"figure{k:02d}" for k in range(1, 19)]
    assert min(len(words.split()) for words in shown.values()) > 8
    assert len(set(shown.values())) == 18


def test_every_verdict_links_to_its_page(overview, pages):
    linked = re.findall(r"^\| \[.*?\]\(paper/(\w+)\.md\) \| (\d+) \| (\d+) \| (.*) \|$", overview, re.MULTILINE)
    assert {name for name, *_ in linked} == pages.keys()
    for name, number, agree, others in linked:
        papers = pages[name].partition("## Beyond the paper")[0]
        found = re.findall(r"^- \*(.*?)\* \*\*(.*?)\.\*\*$", papers, re.MULTILINE)
        other = [(sentence.rstrip("."), verdict.lower()) for sentence, verdict in found if verdict != "Agrees"]
        assert (len(found), len(found) - len(other)) == (int(number), int(agree))
        assert others == "; ".join(f"{sentence}: **{verdict}**" for sentence, verdict in other)


def written(page):
    """Return the claims of a page: what stands from one to the next or to the end of the list."""
    return re.findall(r"^- \*.*\*\*\n(?:  - .*\n)+", page, re.MULTILINE)


def verdict_of(entry):
    """Read a claim: its verdict, and what its printed criteria amount to."""
    outcome = r"  - {}: .*\((?:met in (\d+) of (\d+) draws|(met)|(not met)|(cannot be decided))\)\.$"
    found = [m for line in entry.splitlines() if (m := re.match(outcome.format("Criterion"), line))]
    better = re.search(outcome.format("Exceeded"), entry, flags=re.M)
    always = [m[3] is not None or (m[1] is not None and m[1] == m[2]) for m in found]
    sometimes = [m[3] is not None or (m[1] is not None and int(m[1]) > 0) for m in found]
    kind = 3 if all(m[5] for m in found) else 0 if all(always) else 1 if any(sometimes) else 4 if better else 2
    return re.search(r"\*\*(.+)\.\*\*$", entry.splitlines()[0])[1].lower(), kind


def test_every_verdict_follows_from_the_criteria_beside_it(pages):
    text = "\n".join(pages.values())
    assert len(written(text)) == text.count("  - Measured: ") > 30
    for entry in written(text):
        verdict, kind = verdict_of(entry)
        assert verdict in (claims.VERDICTS[kind].removeprefix("is "), claims.OURS[kind]), entry


def test_the_papers_claims_and_ours_are_counted_apart(overview, pages):
    entries = len(written("\n".join(pages.values())))
    beyond = sum(len(written(page.partition("## Beyond the paper\n")[2])) for page in pages.values())
    assert beyond > 3
    assert int(re.search(r"Of (\d+) sentences of our own", overview)[1]) == beyond
    assert int(re.search(r"Of (\d+) claims of the paper", overview)[1]) == entries - beyond


# -- claims and criteria --------------------------------------------------------------------------------------------


def test_stricter_criteria_of_our_own_and_open_ones_do_not_make_a_claim_fail():
    met, unmet = claims.Criterion.of("one", True), claims.Criterion.of("two", False)
    stricter, open_one = claims.Criterion.of("three", False, ours=True), claims.Criterion.undecided("four")
    judged = {
        (met, stricter): "agrees",
        (unmet, stricter): "does not agree",
        (met, open_one): "agrees in part",
        (unmet, open_one): "does not agree",
        (open_one, stricter): "cannot be decided",
    }
    assert {criteria: claims.Claim("It is so.", "", criteria).verdict for criteria in judged} == judged
    assert claims.Claim("It is so.", "", (unmet,), exceeded=met).verdict == "is exceeded"
    assert claims.Claim("It is so.", "", (unmet,), exceeded=unmet).verdict == "does not agree"


@pytest.mark.parametrize(("low", "high", "met"), [(75, 75, True), (76, 80, True), (77, 80, False), (60, 72, False)])
def test_a_mean_is_judged_within_two_standard_errors(low, high, met):
    criterion = claims.Criterion.mean("75", [73.0, 75.0, 77.0, 73.0, 77.0, 74.0], low, high)  # 74.8 ± 0.7
    assert criterion.met is met


# -- scripts ------------------------------------------------------------------------------------------------------


def test_the_satellite_is_the_papers_and_what_is_computed_is_kept(tmp_path, monkeypatch):
    """The two lines of figures 14 and 15, within this process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENMM_CPU_THREADS", "1")
    monkeypatch.setattr(common, "ProcessPoolExecutor", ThreadPoolExecutor)
    monkeypatch.setattr(satellite, "LINES", tuple(satellite.DRAWN.values()))
    data = satellite.compute(True)
    assert abs(data["SRKN6_14a exact 0.1"]["H0"] - 1.21595664e7) < 1.0
    assert data["SRKN6_14a exact 0.1"]["largest"] < 2e-7
    for name, figure in satellite.draw(data):
        common.save(figure, f"{name}.png")
        assert Path(f"{name}.png").read_bytes().startswith(b"\x89PNG")
    pieces = {file: file.stat().st_mtime_ns for file in common.PIECES.rglob("*.json")}
    assert len(pieces) == 4
    again = satellite.compute(True)
    assert {key: entry["largest"] for key, entry in again.items()} == {
        key: entry["largest"] for key, entry in data.items()
    }
    assert pieces == {file: file.stat().st_mtime_ns for file in pieces}


def test_the_energies_by_which_starts_are_chosen_are_openmms():
    system, sites = figure16.spheres()
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    for seed in (327, 1554):  # two with a close pair
        context.setPositions((figure16.centres(seed)[:, None] + sites).reshape(-1, 3))
        expected = context.getState(energy=True).getPotentialEnergy()._value
        assert figure16.potential(seed) == pytest.approx(expected, rel=1e-12)


@pytest.mark.validate
def test_compiled_methods_are_the_packages():
    """Those of figure 1 whose costs are compared, for momenta of all signs."""
    inertia, m = common.random_bodies(np.random.default_rng(7), 300)
    m *= np.random.default_rng(8).choice([-1.0, 1.0], m.shape) * 1.7
    q, _ = np.linalg.qr(np.random.default_rng(9).standard_normal((4, 4)))
    q = np.resize(q, (300, 4)).T.copy()
    for name in figure01.PAPER:
        for h in (0.02, 0.4):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", rotors.NotConvergedWarning)
                expected = rotors.rotor(name, inertia.T)(q, m, h)
            fine = np.isfinite(expected[0][0])  # the package also reports what turned too far
            assert fine.all() or (name.startswith("dmv") and fine.mean() > 0.5)
            found = compiled.flow(name, inertia)(q, m, h)
            for ours, theirs in zip(found, expected, strict=True):
                # Near the separatrix roundoff is amplified.
                np.testing.assert_allclose(ours[:, fine], theirs[:, fine], rtol=0.0, atol=1e-12)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """Return the quick report, which takes all cores for a minute."""
    folder = tmp_path_factory.mktemp("paper")
    subprocess.run([sys.executable, str(REPORT), "--quick"], cwd=folder, check=True, capture_output=True)
    return folder / "out" / "paper" / "quick" / "paper"


@pytest.mark.validate
@pytest.mark.xdist_group("paper")
def test_every_figure_is_drawn(quick):
    for number in range(1, 19):
        assert (quick / f"figure{number:02d}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.validate
@pytest.mark.xdist_group("paper")
def test_the_pages_are_rewritten_from_what_is_stored(quick, tmp_path):
    def written_by(folder):
        files = [folder.with_suffix(".md"), *sorted(folder.glob("*.md"))]
        return {file.name: file.read_text(encoding="utf-8") for file in files}

    copy = tmp_path / "out" / "paper" / "quick" / "paper"
    shutil.copytree(quick.parent, copy.parent)
    for file in copy.parent.rglob("*.md"):
        file.unlink()
    data = {file: file.stat().st_mtime_ns for file in (copy / "data").iterdir()}
    subprocess.run([sys.executable, str(REPORT), "--quick", "--stored"], cwd=tmp_path, check=True)
    assert written_by(copy) == written_by(quick)
    assert data == {file: file.stat().st_mtime_ns for file in data}


@pytest.mark.validate
def test_the_reference_has_thirty_digits():
    inertia, m = oracle.random_bodies("generic", 2, seed=2)
    q, m1 = reference.taylor(inertia.T, m.T, 3.0)
    for body in range(2):
        rotation, momentum = oracle.free_rotor(inertia[body], [1, 0, 0, 0], m[body], 3.0)
        expected = np.array([np.longdouble(mp.nstr(x, 25)) for x in momentum])
        np.testing.assert_allclose((m1[:, body] - expected).astype(float), 0.0, atol=1e-18)
        w, x, y, z = q[:, body]
        entry = np.longdouble(mp.nstr(rotation[0, 1], 25))
        assert abs(float(2 * (x * y - w * z) - entry)) < 1e-18
