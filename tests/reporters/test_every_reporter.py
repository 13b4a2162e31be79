"""What every reporter of lines does: its columns are named, and a file that is continued is that of one run."""

import inspect

import pytest

import openmm_exactrb as rb
from openmm_exactrb import reporters
from starts import simulation_of

REPORTERS = [
    kind
    for _, kind in inspect.getmembers(reporters, inspect.isclass)
    if kind.__module__ == reporters.__name__ and not kind.__name__.startswith("_")
]
OWN = {rb.MomentReporter: {"charges": [0.8, -0.4, -0.4] * 3}}


def lines_of(kind, file, parts):
    """Return the lines of a reporter after runs of some steps, each with a new reporter that continues the file."""
    topology, system, positions = rb.rigid_water(3)
    simulation = simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.001), positions, kelvin=300.0)
    for k, n in enumerate(parts):
        reporter = kind(file, 2, **OWN.get(kind, {}), append=k > 0)
        simulation.reporters = [reporter]
        simulation.step(n)
        reporter.close()
    return file.read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("kind", REPORTERS, ids=lambda kind: kind.__name__)
def test_a_file_that_is_continued_is_that_of_one_run(kind, tmp_path):
    whole, parts = lines_of(kind, tmp_path / "a", (6,)), lines_of(kind, tmp_path / "b", (3, 3))
    assert whole == parts
    head, *body = whole
    assert [line.split(",")[0] for line in body] == ["2", "4", "6"]
    assert {line.count(",") for line in body} == {head.count(",")}
    assert len(set(body)) == 3
