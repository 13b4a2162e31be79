"""Places of flexible molecules in which no step begins."""

import numpy as np
from test_hinges import folding

import openmm_exactrb as rb
from peptides import peptide
from refusals import assert_refused, refused
from starts import context_of, system_of


def one_step(system, x):
    integrator = rb.ExactRigidBodyIntegrator(0.0005)
    _context = context_of(system, integrator, x)
    integrator.step(1)


def far_from_the_constraints():
    _, system, x = peptide()
    x[3] += [0.0, 0.0, 5.0]
    one_step(system, x)


def rhombus_on_a_line():
    system = system_of(4 * [10.0], [(i, (i + 1) % 4, 0.1) for i in range(4)])
    one_step(system, np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.1, 0, 0]]))


def folded():
    _context, integrator = folding(0.0, 0.01)
    integrator.step(1)


@refused(
    (far_from_the_constraints, r"particles 0, 1, 2, 3 deviate from its shape"),
    (rhombus_on_a_line, "singular configuration"),
    (folded, "singular configuration, where the constraint between particles"),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
