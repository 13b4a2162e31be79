"""Profiles of metadynamics: their bins, their comparison, and a short run."""

import numpy as np
import pytest

from benchmarks.common.markdown import distinct
from benchmarks.common.records import DOCS, RECORDS, read, write
from benchmarks.common.starts import R
from benchmarks.free_energies import metadynamics, tables


def test_profiles_are_those_of_a_known_energy():
    """The energy of an angle that does not depend on the other one is its profile."""
    angle = np.linspace(-np.pi, np.pi, 96, endpoint=False)
    psi, phi = 4.0 * np.cos(angle)[:, None], 10.0 * np.cos(2.0 * angle)[None]
    for axis, expected in enumerate((phi, psi)):
        weights = np.exp(-expected / (R * metadynamics.KELVIN)).reshape(metadynamics.BINS, -1).mean(axis=1)
        found = metadynamics.profile(phi + psi, axis)
        assert np.ptp(found + R * metadynamics.KELVIN * np.log(weights)) < 1e-12


def test_the_table_compares_means_in_basins_and_shows_the_scatter(tmp_path):
    bins = np.arange(metadynamics.BINS)
    energies = {"reference": ([0.0, 0.0], 40.0), "ours": ([0.5, 1.5], 90.0)}  # of bin 0 in two runs, and of the last
    rows = [
        {
            "kind": kind,
            "seed": f"{seed}",
            "angle": angle,
            "energy": f"{first if k == 0 else last if k == bins[-1] else 0}",
        }
        for kind, (some, last) in energies.items()
        for seed, first in enumerate(some)
        for angle in tables.ANGLES
        for k in bins
    ]
    write(tmp_path / "record.csv", [*rows[0]], rows)
    low = len(bins) - 1  # the last one is above 15 kJ/mol
    apart, scatter = 1.0 * (1.0 - 1.0 / low), np.sqrt(0.5) * (1.0 - 1.0 / low)
    line = tables.metadynamics(tmp_path / "record.csv").splitlines()[-1]
    assert line == f"| ours | 2 | {apart:.2f} | {scatter:.2f} | {apart:.2f} | {scatter:.2f} |"


@pytest.mark.parametrize("name", ["LangevinMiddle 2 fs", "BAOA 8 fs"])
def test_runs_have_equal_numbers_of_forces_once(tmp_path, name, monkeypatch, capsys):
    monkeypatch.setattr(metadynamics, "ESTIMATES", 2)
    metadynamics.made(tmp_path, [1], [name], 1200)
    rows = metadynamics.rows_of(tmp_path)
    assert len(rows) == 2 * metadynamics.BINS
    assert {row["forces"] for row in rows} == {"1200"}
    assert np.ptp([float(row["energy"]) for row in rows]) > 0.1
    capsys.readouterr()
    metadynamics.made(tmp_path, [1], [name], 1200)
    assert capsys.readouterr().out == ""


def test_the_page_says_what_the_record_shows():
    """Means of three runs, in the basins of the reference."""
    rows = read(RECORDS / "metadynamics.csv")
    apart = {}
    for (kind,) in distinct(rows, "kind"):
        for angle in tables.ANGLES:
            expected, low = tables.profiles(rows, metadynamics.REFERENCE, angle)
            energies, _ = tables.profiles(rows, kind, angle, low)
            assert len(energies) == 3
            apart[kind, angle] = np.abs(energies.mean(axis=0) - expected.mean(axis=0))[low].max()
    ours, others = ([apart[kind, angle] for angle in tables.ANGLES] for kind in ("BAOA 8 fs", "LangevinMiddle 2 fs"))
    page = " ".join((DOCS / "how-to" / "replica-exchange.md").read_text(encoding="utf-8").split())
    assert f"differ from the reference by at most {max(ours):.2f} kJ/mol" in page
    assert max(ours) < min(others)
