"""Values that checks refuse."""

from openmm_exactrb.support import checks
from refusals import assert_refused, for_each, refused


@refused(
    *for_each(
        lambda given: checks.lists_of_indices(given, "bodies"),
        "bodies must be lists",
        [iter([0, 1]), iter([[0.5]]), iter([[0], 1]), [iter("ab")], iter([[True]])],
    ),
    *(
        (lambda check=check, digits=digits: check(10**digits, "steps"), r"steps must be .* 1\.8e\+308$")
        for check in (checks.number, checks.positive, checks.not_negative, checks.whole)
        for digits in (400, 5000)  # beyond all floats
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
