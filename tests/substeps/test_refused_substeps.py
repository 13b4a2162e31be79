"""Substeps of one's own that are refused."""

from functools import partial

import openmm_exactrb as rb
from openmm_exactrb.schemes import Scheme
from openmm_exactrb.schemes.stability import oscillated
from openmm_exactrb.steps.moves import Move, Op
from openmm_exactrb.steps.substeps import DRIFT, Substep
from overriding import SUBSTEPS, Halved, MixedIn, NoKick, scheme_of
from refusals import assert_refused, refused


class Nameless(Substep):
    """A substep whose kernel text does not define what is called."""

    def bind(self, environment):
        return lambda state, tau: state

    def kernel_moves(self, part):
        return (Move(Op.OWN, part, text="DEVICE inline void fade(Body* body) {}"),)


@refused(
    *(
        (
            lambda substep=substep: oscillated(scheme_of(substep).sequence, 0.1),
            r"overrides bind\(\) but inherits oscillator\(\)",
        )
        for substep in (NoKick(), MixedIn(), Halved(), SUBSTEPS["instance"])
    ),
    (
        partial(
            rb.ExactRigidBodyIntegrator,
            0.001,
            Scheme("wrong", 1, ((Nameless(), 1.0), (DRIFT, 1.0))),
            engine="native",
        ),
        r"must define `DEVICE inline void NAME\(Body\* body, double tau\)`",
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
