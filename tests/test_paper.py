"""The paper's figures are drawn, and its claims are put beside numbers, by one command."""

import json
import re
import subprocess
import sys
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

import oracle

REPORT = Path(__file__).parent.parent / "benchmarks" / "paper" / "report.py"
sys.path.append(str(REPORT.parent))


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    done = subprocess.run([sys.executable, str(REPORT), "--quick"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "out" / "paper" / "quick"


def test_every_figure_is_drawn_and_shown(quick):
    page = (quick / "paper.md").read_text()
    shown = re.findall(r"\(paper/(figure\d\d)\.png\)", page)
    assert sorted(shown) == [f"figure{k:02d}" for k in range(1, 19) if k != 3]  # figure 3 is a sketch of a triangle
    for name in shown:
        assert (quick / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_every_claim_gets_a_verdict(quick):
    page = (quick / "paper.md").read_text()
    claims = [line for line in page.splitlines() if line.startswith("- *")]
    assert len(claims) > 20
    assert all(line.endswith(("**Agrees.**", "**Does not agree.**", "**Not decided.**")) for line in claims)
    assert int(re.search(r"Of (\d+) claims", page)[1]) == len(claims)


def test_the_satellite_is_the_papers(quick):
    data = json.loads((quick / "data" / "satellite.json").read_text())
    assert abs(data["SRKN6_14a exact 0.1"]["H0"] - 1.21595664e7) < 1.0
    assert data["SRKN6_14a exact 0.1"]["largest"] < 2e-7


def test_what_is_computed_is_kept(quick):
    pieces = {file: file.stat().st_mtime_ns for file in (quick.parent / "pieces").rglob("*.json")}
    assert pieces
    subprocess.run([sys.executable, str(REPORT.parent / "satellite.py"), "--quick"], cwd=quick.parents[2], check=True)
    assert pieces == {file: file.stat().st_mtime_ns for file in pieces}


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
