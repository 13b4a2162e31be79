"""Systems, positions and bodies in which no rigid bodies or clusters are found."""

from functools import partial

import numpy as np
import openmm
from test_find import rings
from test_redundant_constraints import BENDING, MASSES, PAIRS, system_of
from test_whole import CUBE, rings_of_six, wrapped
from test_whole import system_of as in_box

import openmm_exactrb as rb
import starts
from openmm_exactrb.detection.find import find_bodies
from refusals import assert_refused, refused

SPLIT = wrapped(rings_of_six([[3.0, 1.0, 1.0]]), CUBE)


def joined_rings():
    system, x = rings()
    system.addConstraint(5, 6, 0.5)
    return system, x


def with_drude_particles():
    _, system, positions = rb.rigid_water(2)
    drude = openmm.DrudeForce()
    drude.addParticle(4, 3, -1, -1, -1, -1.0, 0.001, 1.0, 1.0)
    system.addForce(drude)
    return system, positions._value


@refused(
    (
        lambda: find_bodies(starts.system_of(3 * [1.0], [(0, 1, 0.1), (1, 2, 0.1), (0, 2, 0.3)]), np.zeros((3, 3))),
        "cannot be satisfied in three dimensions",
    ),
    *(
        (partial(find_bodies, *rings(), bodies), sentence)
        for bodies, sentence in [
            ([[0, 1, 99]], "the particles of body 0 must be numbers from 0 to 23, not 99"),
            ([[0, 1, 2], [2, 3]], "particle 2 is named twice, in bodies 0 and 1"),
            ([[]], "no particle with mass"),
        ]
    ),
    (
        lambda: find_bodies(*joined_rings(), [range(6)]),
        "constraint between particles 5 and 6 joins a body given in bodies= to",
    ),
    (lambda: find_bodies(*with_drude_particles()), r"Drude particles \(4"),
    (
        lambda: find_bodies(system_of(MASSES, BENDING, PAIRS, longer={(0, 1): 1e-3}), BENDING),
        r"constraint of 0\.115306 nm between particles 3 and 4 contradicts the other constraints of .* by",
    ),
    (
        lambda: find_bodies(
            in_box(8, CUBE, [(6, 7, 0.1)]),
            np.concatenate([SPLIT, [[0.05, 2.0, 2.0], [2.95, 2.0, 2.0]]]),
            [range(6)],
            CUBE,
        ),
        r"body 0 is ambiguous, because the gap of 2\.72 nm between its particles may be 0\.14 nm across",
    ),
    (
        lambda: find_bodies(
            in_box(6, CUBE, bonds=[(0, 1, 0.14), (1, 2, 0.14), (3, 4, 0.14), (4, 5, 0.14)]), SPLIT, [range(6)], CUBE
        ),
        "split body 0, and neither bonds nor constraints join its particles 0 and 3",
    ),
    (
        lambda: find_bodies(
            in_box(2, CUBE, bonds=[(0, 1, 0.1)]), np.array([[0.2, 0.0, 0.0], [1.8, 0.0, 0.0]]), [range(2)], CUBE
        ),
        r"0 and 1 of body 0 are 1\.6 nm apart as given, or 1\.4 nm across",
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
