"""The reporter of moments."""

import numpy as np

import openmm_exactrb as rb
from canonical_dipoles import moments_in, simulation_of
from force_laws import positions_of


def test_the_moment_is_the_sum_of_the_dipoles():
    simulation, text = simulation_of(8, 0.1, 1.0, 2.0, step=0.01)
    simulation.step(30)
    x = positions_of(simulation.context).reshape(8, -1, 3)
    total = 2.0 * 2.0**0.5 * (x[:, -1] - x[:, -2]).sum(axis=0)
    np.testing.assert_allclose(moments_in(text)[-1], total, rtol=0.0, atol=1e-13)
    assert len(moments_in(text)) == 3


def test_a_new_file_gets_the_names_of_its_columns_also_when_appended_to(tmp_path):
    rb.MomentReporter(tmp_path / "moments.csv", 1, np.zeros(2), append=True).close()
    rb.MomentReporter(tmp_path / "moments.csv", 1, np.zeros(2), append=True).close()
    assert (tmp_path / "moments.csv").read_text() == "step,time (ps),Mx,My,Mz\n"
