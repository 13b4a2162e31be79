"""Moments from which no dielectric constant follows."""

import numpy as np
from openmm import unit

import openmm_exactrb as rb
from refusals import assert_refused, refused, with_options

E_NM = unit.elementary_charge * unit.nanometer


@refused(
    *with_options(
        rb.dielectric_constant,
        {"moments": np.ones((40, 3)), "volume": 1.0, "kT": 1.0},
        [
            ({"moments": np.zeros((40, 2))}, r"shape \(n, 3\), with one row for each of n frames, not"),
            ({"moments": np.full((40, 3), np.nan)}, "finite numbers below .* row 0 is .nan"),
            ({"volume": 0.0}, "volume must be a positive number of nm³"),
            ({"kT": -1.0}, "kT must be a positive number of kJ/mol"),
            ({"dielectric": 0.5}, "dielectric must be at least 1"),
            ({"blocks": 1}, "blocks must be between 2"),
            ({"blocks": 41}, "blocks must be between 2"),
            ({"blocks": 2.9}, "blocks must be a whole number"),
            ({"moments": np.ones((40, 3)) * E_NM}, "without a unit"),
            ({"moments": [row * E_NM for row in np.ones((40, 3))]}, "without a unit"),
            ({"moments": np.ones((40, 3)) * 1j}, "moments must be rows of three numbers"),
            ({"moments": [[1.0, 2.0, 3.0], [1.0, 2.0]]}, "moments must be rows of three numbers"),
            ({"moments": np.full((40, 3), 1e170)}, "finite numbers below .* row 0 is"),
        ],
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
