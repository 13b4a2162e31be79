"""What the pages say about speed on a GPU is in the record."""

import pytest

from benchmarks.common.records import DOCS, RECORDS, ROOT, read
from benchmarks.device.tables import shares_of_operations

PAGES = {
    "README": ROOT / "README.md",
    "index": DOCS / "index.md",
    "which": DOCS / "which.md",
    "gpu": DOCS / "how-to/gpu.md",
    "faq": DOCS / "faq.md",
    "native": DOCS / "explanation/native.md",
    "joss": DOCS / "appendix/joss.md",
    "changes": ROOT / "CHANGELOG.md",
}
ROWS = {(row["system"], row["molecules"], row["integrator"]): row for row in read(RECORDS / "device_costs.csv")}


def text(page):
    return " ".join(PAGES[page].read_text(encoding="utf-8").split())


def throughput(system):
    """Return the simulated time per day with W2_3m at 8 fs, over that with LangevinMiddleIntegrator at 4 fs."""
    ours, theirs = (ROWS[system, "", name]["ns/day"] for name in ("W2_3m native", "LangevinMiddle"))
    return float(ours) / float(theirs)


@pytest.mark.parametrize("page", ["which", "gpu"])
def test_a_force_evaluation_of_water_takes_as_long_as_with_verlet(page):
    waters = [key[1] for key in ROWS if key[0] == "water" and key[2] == "Verlet"]
    assert waters == ["512", "4096", "32768"]
    ratios = [float(ROWS["water", n, f"{scheme} native"]["ratio"]) for n in waters for scheme in ("S2_2", "W2_1")]
    assert f"{min(ratios):.2f} to {max(ratios):.2f}" in text(page)


def test_the_throughput_of_proteins_is_that_of_the_record():
    villin, dhfr, membrane = map(throughput, ("villin", "5dfr_solv-cube_equil", "membrane"))
    for name in ("README", "index"):
        assert f"and {dhfr:.1f} times on an NVIDIA H200" in text(name)
    assert f"{dhfr:.2f} (DHFR), {villin:.2f} (villin) and {membrane:.2f} (128 POPC) times" in text("gpu")
    assert f"villin at 8 fs has {villin:.1f} times the throughput" in text("joss")
    assert f"DHFR at 8 fs reaches {dhfr:.1f} times the throughput" in text("changes")


def test_the_throughput_of_dhfr_is_in_nanoseconds_per_day():
    ours, theirs = (
        float(ROWS["5dfr_solv-cube_equil", "", name]["ns/day"]) for name in ("W2_3m native", "LangevinMiddle")
    )
    ours_and_theirs = (
        f"{ours:.0f} ns per day with `W2_3m` at 8 fs and heavy hydrogens, and {theirs:.0f} ns per day with"
        " `LangevinMiddleIntegrator` at 4 fs"
    )
    assert ours_and_theirs in text("which")


def test_a_force_evaluation_of_a_protein_or_membrane_takes_longer_than_with_openmm():
    systems = "peptide", "villin", "5dfr_solv-cube_equil", "membrane"
    ratios = {
        name: [float(ROWS[system, "", f"{name} native"]["ratio"]) for system in systems] for name in ("BAOA", "W2_3m")
    }
    both = [*ratios["BAOA"], *ratios["W2_3m"]]
    assert f"[{min(both):.1f} to {max(both):.1f} times as long]" in text("faq")
    assert f"These evaluations take {min(ratios['W2_3m']):.1f} to {max(ratios['W2_3m']):.1f} times as long" in text(
        "gpu"
    )


def test_the_share_of_double_precision_on_a_card_for_consumers_is_that_of_the_record():
    shares = shares_of_operations()
    assert f"take an estimated {shares['water']:.1f} % of the time" in text("native")
    assert f"and {shares['dhfr']:.1f} % for DHFR in water" in text("native")


def test_the_energy_of_s2_2_does_not_drift_in_a_box_and_that_of_verlet_does():
    found = read(RECORDS / "device_drift.csv")
    errors = {
        (row["integrator"], row["engine"], row["precision"]): abs(float(row["drift_kJ_per_mol_ns_molecule"]))
        / float(row["drift_error"])
        for row in found
    }
    ours = {key: error for key, error in errors.items() if key[0] == "S2_2"}
    assert {key[1:] for key in ours} == {("host", "single"), *(("native", p) for p in ("single", "mixed", "double"))}
    assert max(ours.values()) < 2.0
    assert round(errors["Verlet", "openmm", "single"]) == 7
    assert round(errors["LangevinMiddle", "openmm", "single"]) == 1
    assert {(row["molecules"], row["ps"]) for row in found} == {("512", "100.0")}


def test_all_was_measured_on_the_card_that_the_pages_name():
    assert {row["device"] for row in ROWS.values()} == {"NVIDIA H200"}
    assert all("NVIDIA H200" in text(page) for page in PAGES)
