"""The compiled pair sum, whatever is around the dipoles: one suite for open boundaries, a reaction field and Ewald."""

import subprocess
import sys

import numpy as np
import pytest

import openmm_exactrb as rb
from force_laws import assert_gradient
from soft_dipoles import arrows, assert_same, summed, truncated

BOUNDARIES = {
    "open": lambda box: rb.Open(),
    "reaction field": truncated,
    "ewald": lambda box: rb.Ewald(tolerance=1e-4),
    "rough ewald": lambda box: rb.Ewald(tolerance=1e-2, dielectric=3.0),
    "mesh": lambda box: rb.Ewald(method="mesh", cutoff=1.5, tolerance=1e-3),
}


@pytest.fixture(params=list(BOUNDARIES))
def around(request):
    """Return a boundary and the edges of a box, for its shortest edge."""

    def settings(box):
        periodic = request.param != "open"
        return BOUNDARIES[request.param](box), (box, 1.1 * box, 1.3 * box) if periodic else None

    return settings


@pytest.mark.parametrize("attraction", [{}, {"soft_attraction": 3.0}], ids=["soft", "attractive"])
def test_forces_are_the_gradient_of_the_energy_whatever_the_tolerance(rng, around, attraction):
    x, box = arrows(27, rng)
    boundary, edges = around(box)
    _, forces = summed(x, boundary, edges, **attraction)
    assert_gradient(lambda y: summed(y, boundary, edges, **attraction)[0], x, forces, (0, 5, 26, 33, 53), 1e-7)


def test_total_force_is_zero_and_without_a_box_total_torque(rng, around):
    x, box = arrows(64, rng)
    boundary, edges = around(box)
    _, forces = summed(x, boundary, edges)
    assert np.abs(forces.sum(axis=0)).max() < 1e-14 * np.abs(forces).sum()
    if edges is None:
        assert np.abs(np.cross(x, forces).sum(axis=0)).max() < 1e-13 * np.abs(forces).sum()


def test_dipoles_may_change_places_and_images(rng, around):
    x, box = arrows(64, rng)
    boundary, edges = around(box)
    energy, forces = summed(x, boundary, edges)
    order = rng.permutation(64)
    y = x.reshape(64, 2, 3)[order]
    if edges is not None and boundary != BOUNDARIES["mesh"](box):  # whose points move with the mean of the places
        y = y + edges * rng.integers(-2, 3, (64, 1, 3))
    permuted = summed(y.reshape(-1, 3), boundary, edges)
    assert_same((energy, forces.reshape(64, 2, 3)[order].reshape(-1, 3)), permuted, 1e-12)


@pytest.mark.parametrize("n", [61, 500])
def test_any_number_of_threads_gives_the_same_bits(rng, around, n):
    x, box = arrows(n, rng)
    boundary, edges = around(box)
    energy, forces = summed(x, boundary, edges, threads=1)
    for threads in (None, 2, 3, 7):
        again = summed(x, boundary, edges, threads)
        assert again[0] == energy
        np.testing.assert_array_equal(again[1], forces)


def test_dipoles_in_one_place_and_positions_that_are_no_numbers_give_no_numbers(rng, around):
    x, box = arrows(27, rng)
    boundary, edges = around(box)
    for particle, place in ((2, x[0]), (4, [np.nan, 0.0, 0.0])):
        bad = x.copy()
        bad[particle] = place
        energy, forces = summed(bad, boundary, edges)
        assert not np.isfinite(energy)
        assert not np.isfinite(forces[particle]).all()


# A short kernel in a process of its own: what is compiled there, and when numba is imported.
SCRIPT = """
import sys
import openmm
from openmm_exactrb.openmm_access.parameters import masses
assert "numba" not in sys.modules, "imported too early"
system = openmm.System()
system.addParticle(18.0)
print(masses(system))
"""


def test_the_first_process_says_what_it_waits_for_and_the_second_does_not_compile(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def run():
        done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
        return done, {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb[ic]")}

    (first, kept), (second, still_kept) = run(), run()
    assert first.stderr.count("compiling kernels") == 1
    assert kept
    assert second.stderr == ""
    assert still_kept == kept
    assert first.stdout == second.stdout
