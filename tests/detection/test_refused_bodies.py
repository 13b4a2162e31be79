"""Systems, positions and bodies in which no rigid bodies or clusters are found."""

from functools import partial

import numpy as np
import openmm
from test_find import rings
from test_redundant_constraints import BENDING, MASSES, PAIRS, every_pair, moving, ring, system_of
from test_small_bodies import body
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


def another_shape():
    """The last of the five mirrored at three of them: nine distances are the same, the tenth is not."""
    integrator = rb.ExactRigidBodyIntegrator(0.002)
    context = moving(system_of(MASSES, BENDING, PAIRS), BENDING, integrator)
    integrator.step(1)
    x = BENDING.copy()
    normal = np.cross(x[1] - x[0], x[2] - x[0])
    x[4] -= 2.0 * normal * ((x[4] - x[0]) @ normal) / (normal @ normal)
    context.setPositions(x)
    integrator.step(1)


def flat_part():
    x = np.vstack([ring(0.14), [0.25, 0.1, 0.1]])
    integrator = rb.ExactRigidBodyIntegrator(0.002)
    _context = moving(system_of(7 * [12.0], x, [*every_pair(6), (0, 6)]), x, integrator)
    integrator.step(1)


def small_body(extent, named):
    _context, integrator = body(extent, named, 0.0 if extent < 1e-9 else 1.7)
    integrator.step(1)


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
    (another_shape, r"deviate from its shape by 0\.087 nm"),
    (flat_part, "always straight or flat, remove this constraint, or make the"),
    *(
        (
            partial(small_body, extent, named),
            r"particles 0, 1, 2 form a rigid body with an extent of only .*e-\d\d nm, ",
        )
        for extent in (5e-7, 1e-7, 2e-8, 3e-9, 1e-10, 1e-12)
        for named in (True, False)
    ),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
