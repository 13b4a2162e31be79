"""Windows of the hydration of methane: their energies, runs that continue, and the free energy that follows."""

import warnings
from functools import partial

import numpy as np
import openmm
import pytest

from benchmarks.common.markdown import with_error
from benchmarks.common.records import DOCS, RECORDS, read, write
from benchmarks.common.starts import R, context_of
from benchmarks.free_energies import hydration
from benchmarks.free_energies.hydration import KELVIN, KINDS, WINDOWS

OURS = KINDS["BAOA 8fs"]


@pytest.fixture(scope="module")
def start():
    """Return a State of methane in water near a minimum, in a box smaller than the first one."""
    _, system = hydration.methane_in_water()[0], hydration.system_of(KINDS["2fs"])
    context = context_of(system, openmm.VerletIntegrator(0.001), hydration.methane_in_water()[1])
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    return context.getState(positions=True, velocities=True)


def energy(system, start, **parameters):
    context = context_of(system, openmm.VerletIntegrator(0.001), start, "Reference")
    for name, value in parameters.items():
        context.setParameter(name, value)
    return context.getState(energy=True).getPotentialEnergy()._value


def test_without_fading_the_energy_is_that_of_methane_in_water(start):
    assert hydration.methane_in_water()[0].getNumAtoms() == 5 + 3 * 216
    plain, faded = (hydration.system_of(OURS, alchemical=one) for one in (False, True))
    # Long-range corrections count pairs of the solute with itself, or not.
    assert energy(faded, start) == pytest.approx(energy(plain, start), abs=0.05)


@pytest.mark.parametrize("k", [1, 4, 11])
def test_reduced_energies_are_those_of_windows(start, k):
    system = hydration.system_of(OURS)
    expected = (energy(system, start, **WINDOWS[k]) - energy(system, start, **WINDOWS[0])) / (R * KELVIN)
    reduced = hydration.Energies(OURS)(start)
    assert len(reduced) == 12
    assert reduced[k] - reduced[0] == pytest.approx(expected, abs=2e-3)
    assert abs(expected) > 0.03


def test_windows_are_made_in_turns_once_with_noise_of_their_own(start, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(hydration, "BURN", 0.016)
    monkeypatch.setattr(hydration, "SAMPLED", 0.016)
    monkeypatch.setattr(hydration, "start_of", lambda *_: start)
    record, kinds = hydration.record_of(tmp_path), ["2fs", "BAOA 8fs"]
    todo = partial(hydration.missing, record, kinds, [0], [0, 11])
    assert [*todo()] == [(0, 0, "2fs"), (0, 0, "BAOA 8fs"), (0, 11, "2fs"), (0, 11, "BAOA 8fs")]
    for seed, window, kind in [*todo()][:3]:
        record.add(hydration.made(tmp_path, kind, seed, window, 0.048))
    assert [*todo()] == [(0, 11, "BAOA 8fs")]
    rows = record.rows()
    assert [row["samples"] for row in rows.values()] == ["3", "3", "3"]
    assert [row["failures"] for row in rows.values()] == ["0", "0", "0"]
    assert rows["2fs", "0", "0"]["forces"] == "32"
    assert rows["BAOA 8fs", "0", "0"]["engine"] in ("native", "host")
    files = [np.load(hydration.file_of(tmp_path, "2fs", 0, window)) for window in (0, 11)]
    assert files[0]["reduced"].shape == (3, 12)
    assert np.abs(files[0]["reduced"] - files[1]["reduced"]).max() > 1e-6
    assert [*hydration.results(tmp_path)] == []  # of no kind all windows
    assert (
        len(
            {
                hydration.noise(*of)
                for of in ((k, s, w, a) for k in KINDS for s in (0, 1) for w in (0, 9) for a in (0, 4))
            }
        )
        == 32
    )


def test_failures_count_and_leave_no_samples(start, tmp_path, monkeypatch):
    """At a friction of zero and a step of 80 fs, water flies apart whatever the noise."""
    monkeypatch.setattr(hydration, "start_of", lambda *_: start)
    monkeypatch.setattr(hydration, "FRICTION", 0.0)
    monkeypatch.setitem(KINDS, "long", hydration.Kind("BAOA", 80.0, "all", "HBonds"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        row = hydration.made(tmp_path, "long", 0, 0, 0.4)
    assert (row["failures"], row["samples"]) == (hydration.ATTEMPTS, 0)
    hydration.record_of(tmp_path).add(row)
    monkeypatch.setattr(hydration, "WINDOWS", WINDOWS[:1])
    write(tmp_path / "record.csv", hydration.RESULTS, hydration.results(tmp_path))
    line = hydration.hydration(tmp_path / "record.csv").splitlines()[-1]
    assert line.startswith("| long | 1 | nan")
    assert f"| {hydration.ATTEMPTS} of {hydration.ATTEMPTS + 1} |" in line


@pytest.mark.filterwarnings("ignore:Unknown solver options")  # of pymbar
def test_mbar_finds_the_free_energy_of_oscillators():
    pytest.importorskip("pymbar", reason="pip install 'openmm-exactrb[validation]'")
    rng, stiffness = np.random.default_rng(1), np.linspace(1.0, 4.0, 5)
    samples = rng.standard_normal((5, 4000)) / np.sqrt(stiffness)[:, None]
    found = hydration.free_energy([0.5 * np.outer(x * x, stiffness) for x in samples])
    expected = -0.5 * np.log(4.0) * R * KELVIN / 4.184  # of the first state, less that of the last
    assert abs(found.value - expected) < 4.0 * found.error
    assert 0.001 < found.error < 0.02
    assert 0.1 < found.overlap < 0.5


def test_the_deciding_page_quotes_the_record():
    rows = {row["kind"]: row for row in read(RECORDS / "hydration.csv")}
    page = " ".join((DOCS / "which.md").read_text(encoding="utf-8").split())
    values = {kind: with_error(float(row["value"]), float(row["error"]), 2) for kind, row in rows.items()}
    assert f"from one seed, is {values['BAOA 8fs']} kcal/mol [at 8 fs]" in page
    assert f"and {values['2fs']} kcal/mol with `LangevinMiddleIntegrator` at 2 fs" in page
    share = float(rows["BAOA 8fs"]["forces"]) / float(rows["4fs"]["forces"])
    assert f"there are {share:.2f} times as many force evaluations as at 4 fs" in page
    started = {kind: 12 + int(row["failures"]) for kind, row in rows.items()}
    assert f"12 of {started['BAOA 8fs']} runs of 220 ps ended" in page
    assert f"`AllBonds` at 8 fs, 12 of {started['8fs AllBonds']} did" in page
