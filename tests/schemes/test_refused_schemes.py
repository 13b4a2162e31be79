"""What schemes and sequences refuse."""

from functools import partial

import openmm_exactrb as rb
from openmm_exactrb.schemes import WITH_THERMOSTAT, Scheme, scheme, shadow, stability_limit, symmetric
from openmm_exactrb.steps.sequence import run, spelled
from openmm_exactrb.steps.substeps import DRIFT, HEAT_EXCHANGE, KICK, Kick, LastForcesKick, Substep
from refusals import assert_refused, for_each, refused

PAIRS = "scheme mine: .* pairs of a Substep and its fraction of the step, not"


class Silent(Substep):
    """A substep that does not say what it does."""


STORED = LastForcesKick((1.0,))
NO_PAIRS = ("A", 1.0), DRIFT, (DRIFT, 0.5, 0.5), (Kick, 1.0), (Silent, 1.0)


def mine(*rows, **options):
    return Scheme("mine", 2, rows, **options)


@refused(
    (
        lambda: symmetric("bad", order=4, stages=3, first="kick", a=(0.1, 0.2), b=(0.1,)),
        r"free coefficients .* must be 1 .*, not 2",
    ),
    (lambda: symmetric("bad", order=4, stages=3, first="kick", a=(float("nan"),), b=(0.1,)), "must be finite"),
    (lambda: mine(), "scheme mine: the sequence of a step must contain"),
    *for_each(lambda wrong: mine((DRIFT, 0.5), wrong, (DRIFT, 0.5)), PAIRS, NO_PAIRS),
    *for_each(lambda wrong: mine((DRIFT, 1.0), processor=(wrong,)), PAIRS, NO_PAIRS),
    (lambda: mine((DRIFT, 1.0), (STORED, 1.0)), "stored forces is for the output .* use output="),
    (lambda: mine((DRIFT, 1.0), processor=((STORED, 1.0),)), "stored forces is for the output .* use output="),
    *(
        (partial(scheme, name), f"did you mean '{meant}'")
        for name, meant in [
            ("v2", "V2"),
            ("W2-4", "W2_4"),
            ("SRKN46b", "SRKN4_6b"),
            ("W4", "W4_4"),
            ("srkn4", "SRKN4_6b"),
            ("W2", "W2_1"),
        ]
    ),
    (lambda: run(((KICK, 1.0),), {DRIFT: None}, None, 0.1), "Kick", KeyError),
    *(
        (partial(spelled, f"B {symbol} B"), f"the substep '{symbol}' is unknown")
        for symbol in ["C", "BAOAB", "a", "B-1", "B1.5", "B32"]
    ),
    (lambda: shadow(rb.SCHEMES["V2"], 2.1), r"V2 is not stable at a step of 2\.1/omega"),
    *for_each(
        partial(shadow, rb.SCHEMES["V2"]),
        "step must be a positive number, not",
        [0.0, -0.1, float("nan"), float("inf"), "0.1"],
    ),
    *for_each(
        lambda rows: stability_limit(mine(*rows)),
        "mine does not advance an oscillator by the step",
        [
            ((DRIFT, 1.0),),
            ((KICK, 1.0),),
            ((DRIFT, 1.0), (HEAT_EXCHANGE, 1.0)),
            ((DRIFT, 1.0), (KICK, -1.0)),
            ((DRIFT, 0.5), (KICK, 1.0)),
            ((DRIFT, 1.0), (KICK, 1e-9)),
            ((DRIFT, -1.0), (KICK, -1.0)),
        ],
    ),
    (
        lambda: stability_limit(mine((DRIFT, 1.0), (Silent(), 1.0), (KICK, 1.0))),
        r"Silent.* has no matrix for a harmonic oscillator",
    ),
    *((partial(scheme, name), f"{name} .*ExactRigidBodyLangevinIntegrator") for name in WITH_THERMOSTAT),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
