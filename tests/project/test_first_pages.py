"""The pictures of the first pages show what the records and the schemes have, and are drawn without an error."""

import first_pages
import pytest
from first_pages import DRAWN, LEAVES, PICTURES, kicks, on_a_gpu, on_a_processor

from benchmarks import tables
from benchmarks.common.markdown import rows
from openmm_exactrb.command.description import PROTEIN, PROTEIN_AND_WATER
from openmm_exactrb.rotors import ROTORS
from openmm_exactrb.schemes import CATALOGUE, splitting


def test_bars_are_those_of_the_records():
    theirs, all_bonds, ours = on_a_processor()
    assert (theirs.relative, ours.note) == (1.0, tables.figures()["protein_throughput"])
    assert all_bonds.relative == pytest.approx(ours.relative, rel=0.05)  # what the pages call as fast
    speeds = {row["integrator"]: row["ns/day"] for row in rows("device_costs") if row["system"].startswith("5dfr")}
    assert [bar.note for bar in on_a_gpu()] == [
        f"{float(speeds['LangevinMiddle']):.0f} ns/day",
        "not timed",
        f"{float(speeds[f'{PROTEIN_AND_WATER} native']):.0f} ns/day",
    ]


@pytest.mark.parametrize("name", [PROTEIN, PROTEIN_AND_WATER])
def test_a_step_has_the_force_evaluations_of_its_scheme(name):
    step, at = kicks(name)
    scheme = splitting(name)
    assert (step, len(at)) == (8.0 * scheme.forces, scheme.forces)
    assert all(0.0 <= time < step for time in at)


def test_leaves_are_sections_of_the_deciding_page():
    text = (first_pages.PICTURES.parent / "which.md").read_text(encoding="utf-8").lower()
    for title, _ in LEAVES:
        assert f"\n## {title.replace(', ', ' and ')}\n" in text
    assert f"{len(CATALOGUE)} schemes, {len(ROTORS)} rotors" in LEAVES[-1][1][0][0]


@pytest.mark.parametrize("name", DRAWN)
def test_pictures_are_drawn_and_stored(name, tmp_path):
    DRAWN[name]().savefig(tmp_path / f"{name}.png")
    assert (PICTURES / f"{name}.png").stat().st_size > 10_000
