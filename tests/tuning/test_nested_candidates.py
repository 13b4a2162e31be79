"""Schemes with nested bonded forces among those that are tried."""

import math
from pathlib import Path

import pytest
from equilibrium import equilibrated
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.tuning.benchmark import VERLET

PEPTIDE = Path(__file__).parents[2] / "examples" / "data" / "alanine_dipeptide.pdb"


@pytest.fixture(scope="module")
def peptide():
    """System, with all forces in group 0, and State of alanine dipeptide in vacuum, with bonds to hydrogen held."""
    pdb = app.PDBFile(str(PEPTIDE))
    force_field = app.ForceField("amber14-all.xml")
    system = force_field.createSystem(pdb.topology, constraints=app.HBonds, removeCMMotion=False)
    return system, equilibrated(system, pdb.positions, picoseconds=1.0)


def tuned(system, state, **options):
    lines = []
    result = rb.tune(system, state, platform="Reference", duration=0.3, report=lines.append, **options)
    return result, lines


@pytest.fixture(scope="module")
def nested(peptide):
    return tuned(*peptide, schemes=["S2_2"], levels=6)


def test_nested_schemes_are_tried_where_bonded_forces_move_something(nested):
    result, lines = nested
    assert {p.method for p in result.points} == {"S2_2", "S2_2 nested", VERLET}
    assert any(line.startswith("S2_2 nested, ") for line in lines)
    assert "S2_2 nested" in str(result)


def test_exact_forces_have_no_floor(nested):
    """Of W4_4 alone, whose order is lost in clusters, the error would not fall as it should."""
    result, _ = nested
    assert result.floor is None


def test_nested_schemes_are_stable_with_longer_steps(nested):
    result, lines = nested
    longest = {name: result.largest_stable_step(name) for name in ("S2_2", "S2_2 nested")}
    assert longest["S2_2 nested"] > 1.3 * longest["S2_2"]
    unstable = [p for p in result.points if p.method == "S2_2" and math.isinf(p.error)]
    assert unstable
    assert any(line.startswith("S2_2, ") and line.endswith("unstable") for line in lines)


def test_nested_evaluations_have_their_price(nested):
    """The same forces per ps cost more, by what the inner evaluations take, and more so at longer steps."""
    result, _ = nested

    def seconds(p):
        return p.cost * p.step / result.methods[p.method].evaluations

    (plain,) = {round(seconds(p), 12) for p in result.curve("S2_2")}
    extra = {p.step: seconds(p) - plain for p in result.curve("S2_2 nested")}
    assert all(e > 0.0 for e in extra.values())
    assert extra[max(extra)] > extra[min(extra)]


def test_a_nested_choice_builds_a_nested_integrator(nested, peptide):
    result, _ = nested
    point = result.curve("S2_2 nested")[0]
    choice = result.best(point.error, "S2_2 nested")
    assert choice.step == pytest.approx(point.step, rel=1e-12)
    integrator = choice.integrator()
    assert integrator.getScheme().name == "S2_2"
    assert integrator.getMultipleTimeSteps().fast == "bonded"
