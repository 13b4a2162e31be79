"""Reporters of moments and of canonical momenta."""

import numpy as np
import pytest
from openmm import unit

import openmm_exactrb as rb
from canonical_dipoles import moments_in, simulation_of
from force_laws import positions_of
from openmm_exactrb import vectors


def test_the_moment_is_the_sum_of_the_dipoles():
    simulation, text = simulation_of(8, 0.1, 1.0, 2.0, step=0.01)
    simulation.step(30)
    x = positions_of(simulation.context).reshape(8, -1, 3)
    total = 2.0 * 2.0**0.5 * (x[:, -1] - x[:, -2]).sum(axis=0)
    np.testing.assert_allclose(moments_in(text)[-1], total, rtol=0.0, atol=1e-13)
    assert len(moments_in(text)) == 3


def test_momenta_are_canonical_and_depend_on_seed_and_step_only():
    simulation, _ = simulation_of(64, 0.1, 1.5, 1.0, step=0.01, draw=0.1)
    simulation.step(10)
    first = vectors.velocities(simulation.context.getState(velocities=True))
    for energy in simulation.integrator.kineticEnergies():
        assert energy.value_in_unit(unit.kilojoule_per_mole) == pytest.approx(
            1.5 * 64 * 1.5, rel=4.0 * (2.0 / 192) ** 0.5
        )
    simulation.step(10)
    assert np.abs(vectors.velocities(simulation.context.getState(velocities=True)) - first).max() > 0.1
    simulation.currentStep = 10
    simulation.reporters[1].report(simulation, None)
    # The attitudes have changed, and with them the velocities of the sites; those of the centres have not.
    again = vectors.velocities(simulation.context.getState(velocities=True))
    np.testing.assert_allclose(
        again.reshape(64, -1, 3)[:, :4].mean(axis=1), first.reshape(64, -1, 3)[:, :4].mean(axis=1), atol=1e-12
    )


@pytest.mark.parametrize("reporter", [lambda n: rb.CanonicalMomenta(1.0, n), lambda n: rb.MomentReporter("x", n, [])])
def test_intervals_are_at_least_one_step(reporter):
    with pytest.raises(ValueError, match="at least one step"):
        reporter(0)


def test_a_new_file_gets_the_names_of_its_columns_also_when_appended_to(tmp_path):
    rb.MomentReporter(tmp_path / "moments.csv", 1, np.zeros(2), append=True).close()
    rb.MomentReporter(tmp_path / "moments.csv", 1, np.zeros(2), append=True).close()
    assert (tmp_path / "moments.csv").read_text() == "step,time (ps),Mx,My,Mz\n"
