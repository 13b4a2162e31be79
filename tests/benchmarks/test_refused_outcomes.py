"""Problems that are not integrated, and claims that nothing is put beside."""

from functools import partial

import openmm_exactrb as rb
from benchmarks.paper import claims
from benchmarks.paper.problems import Satellite, integrate
from refusals import assert_refused, refused


@refused(
    (partial(claims.Criterion.of, "nothing was measured", []), "needs an outcome"),
    *(
        (
            partial(integrate, *Satellite.paper(), 0.1, n, rb.SCHEMES[name]),
            "n must be a whole number of at least 0",
        )
        for n in (-1, 2.5, float("nan"), "3")
        for name in ("V2", "V2_C17")
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
