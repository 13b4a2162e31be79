"""Clusters that cannot be held, and places that are not those of a body or a cluster."""

from functools import partial

import numpy as np
import openmm
from test_bodies import CHIRAL, add_rigid
from test_cluster_kinds import kind

from openmm_exactrb.constraints.clusters import LARGEST
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.mechanics.fit import fit
from refusals import assert_refused, refused

CHAIN = [(k, k + 1) for k in range(LARGEST + 1)]
EVERY = [(i, j) for i in range(5) for j in range(i)]
TORN = CHIRAL + np.array([0.0, 3.0, 0.0]) * (np.arange(4) == 2)[:, None]


def fitted(x):
    system = openmm.System()
    add_rigid(system, CHIRAL, [1.0, 2.0, 3.0, 4.0])
    fit(find_bodies(system, CHIRAL), x, np.zeros((4, 3)))


def triangle_on_a_line():
    triangle = kind([12.0, 16.0, 16.0], [(0, 1), (0, 2), (1, 2)], [0.12, 0.12, 0.24])
    x = np.array([[0.0, 0.0, 0.0], [0.12, 0.0, 0.0], [-0.12, 0.0, 0.0]])
    triangle.check_singular(x[None], np.array([False]))
    triangle.check_singular(x[None], np.array([True]))


@refused(
    *(
        (partial(kind, *arguments), sentence)
        for arguments, sentence in [
            # Methane with its bonds and its H-H distances: ten constraints for nine internal coordinates.
            (([12.0, *4 * [1.0]], EVERY, len(EVERY) * [0.15]), r"follows from the others .* 0, 1, 2, 3, 4: remove"),
            (([12.0, 1.0], [(0, 1), (1, 0)], [0.1, 0.1]), "constraint between particles 0 and 1 follows"),
            (([12.0, 0.0], [(0, 1)], [0.1]), "particle 1 .* has the mass 0"),
            (([12.0, 1.0], [(0, 1)], [0.0]), "constraint of 0 nm between particles 0 and 1"),
            (([12.0, 1.0], [(0, 1)], [np.nan]), "constraint of nan nm between particles 0 and 1 is invalid"),
            (([12.0, 1.0], [(1, 1)], [0.1]), "needs two different particles"),
            (((LARGEST + 2) * [1.0], CHAIN, len(CHAIN) * [0.1]), "constraints=HBonds"),
        ]
    ),
    (triangle_on_a_line, "particles 0, 1, 2 is in a singular configuration"),
    (
        lambda: fitted(CHIRAL * [1.0, 1.0, -1.0]),
        r"body 0 \(particles 0, 1, 2, 3\) deviate .* form its mirror image: set .*",
    ),
    (lambda: fitted(TORN), r"particles 0, 1, 2, 3\) .* because of particle 2 alone, 3 nm from its place"),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
