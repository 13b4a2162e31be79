"""What the pages of the gallery say of long runs is what the records have."""

from pathlib import Path

import pytest

from benchmarks.common.markdown import rows
from benchmarks.dipoles.tables import stockmayer_constants

ROOT = Path(__file__).resolve().parents[2]


def text(name):
    return " ".join((ROOT / name).read_text(encoding="utf-8").split())


def test_dielectric_constants():
    table, example = stockmayer_constants(), text("examples/dielectric_constant.py")
    assert "| 125 | 2000 | 63.4 ± 2.3 |" in table
    assert "is 63.4 ± 2.3, compared with 64.6 ± 1.8 from LAMMPS. The mean of six longer runs is 66.4 ± 0.7" in example
    assert "| LAMMPS, Ewald sum | 125 |  | 64.6 ± 1.8 |" in table
    assert "| 6 × 4000 | 66.4 ± 0.7 |" in table
    assert "whose dielectric constant is 66.8 ± 5.9" in text("examples/stockmayer_fluid.py")
    assert "| 1000 | 200 | 66.8 ± 5.9 |" in table


def test_ellipsoids_are_nematic_at_the_end():
    S = [float(row["S"]) for row in rows("ellipsoids")]
    assert f"is {S[0]:.2f} at the first pressure and {S[-1]:.2f} at the last" in text("examples/ellipsoids.py")
    assert sorted(S) == S


def test_structure_of_the_stockmayer_fluid():
    found, page = rows("stockmayer_fluid"), text("examples/stockmayer_fluid.py")
    peak = max(found, key=lambda row: float(row["g"]))
    assert f"first peak of g(r) is at {float(peak['r']):.2f} sigma" in page
    assert f"height is {float(peak['g']):.2f}, and h110 there is {float(peak['h110']):.2f}" in page
    total, whole_box = float(found[-1]["sum_of_cosines"]), float(found[-1]["whole_box"])
    assert f"the sum of cosines is {total:.1f}; the moment of the whole box gives {whole_box:.1f}" in page


@pytest.mark.parametrize("name", ["dielectric_constant", "ellipsoids", "ferrofluid", "stockmayer_fluid"])
def test_pages_of_long_runs_show_a_stored_picture_and_its_command(name):
    example = (ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8")
    picture = example.partition(".. image:: /")[2].split()[0]
    assert f'# sphinx_gallery_thumbnail_path = "{picture}"' in example
    assert f"The picture is from ``python examples/{name}.py" in example
    assert f'"{name}"' in (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
