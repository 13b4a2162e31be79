"""What rotors refuse."""

from functools import partial

import numpy as np
import pytest
from openmm import unit

import openmm_exactrb as rb
from refusals import assert_refused, for_each, refused, with_options

TOP = {"inertia": [1.0, 2.0, 3.0], "q0": [1.0, 0, 0, 0], "m0": [1.0, 0, 0], "t": 0.1}
REAL = "real numbers in rows of equal length"
AGREE = r"do not agree on the number N of bodies: use the shapes \(4, N\) for q, \(3, N\) for m"
NO_NUMBERS = [
    ("inertia", [1.0, 2.0 + 1.0j, 3.0]),
    ("q0", "attitude"),
    ("m0", np.array([1.0 + 1.0j, 0.0, 0.0])),
    ("m0", [[1.0, 0.0, 0.0], [1.0]]),
    ("m0", ["1", "0", "0"]),
    ("m0", [None, 1.0, 0.0]),
    ("t", 1.0j),
    ("t", 1.0 * unit.picosecond),
    ("inertia", np.ones(3) * unit.dalton * unit.angstrom**2),
]


def flow_of(inertia, q, m, t, method="exact", refused_before=0):
    """Apply the flow of a rotor to arrays of these shapes: a compiled one would read and write past their ends."""
    flow = rb.rotors.rotor(method, np.ones(inertia) * [1.0, 2.0, 2.5])
    for _ in range(refused_before):
        with pytest.raises(ValueError, match=AGREE):
            flow(np.full(q, 0.5), np.ones(m), np.full(t, 0.1))
    flow(np.full(q, 0.5), np.ones(m), np.full(t, 0.1))


@refused(
    *with_options(
        rb.free_rotor,
        TOP,
        [
            ({"method": "jacobi"}, "choose one of exact"),
            ({"inertia": [1.0, 2.0]}, r"shape \(3,\) or \(N, 3\)"),
            ({"inertia": [1.0, 0.0, 2.0]}, "positive and finite"),
            ({"inertia": [1.0, np.nan, 2.0]}, "positive and finite"),
            ({"q0": [1.0, 0.0, 0.0]}, "must have the shape"),
            ({"q0": [0.0, 0.0, 0.0, 0.0]}, "is zero"),
            ({"m0": np.ones((2, 3)), "t": np.ones(3)}, "do not agree on the number N of bodies"),
            ({"m0": np.ones((2, 2, 3))}, "one axis of bodies, not 2"),
        ],
    ),
    *with_options(
        rb.free_rotor,
        TOP,
        [({name: value}, f"^{name} must be {REAL}, without a unit, not ") for name, value in NO_NUMBERS],
    ),
    *for_each(
        partial(rb.rotors.rotor, "exact"),
        f"^inertia must be {REAL}",
        [value for name, value in NO_NUMBERS if name == "inertia"],
    ),
    *for_each(
        lambda shapes: flow_of(*shapes),
        AGREE,
        [
            ((3,), (4, 5), (3, 6), ()),
            ((3,), (4, 6), (3, 5), ()),
            ((3,), (4, 5), (3, 5), (4,)),
            ((3,), (4, 5), (3, 5), (6,)),
            ((3,), (4, 5), (3, 5), (1, 5)),
            ((5, 3), (4, 6), (3, 6), ()),
            ((6, 3), (4, 5), (3, 5), ()),
            ((6, 3), (4, 1), (3, 1), ()),
            ((3,), (5, 4), (5, 3), ()),
            ((3,), (4,), (3,), ()),
            ((3,), (2, 4, 5), (1, 3, 5), ()),
            ((3,), (3, 4, 5), (3, 3, 5), ()),
        ],
    ),
    (partial(flow_of, (3,), (4, 5), (3, 6), (), refused_before=1), AGREE),
    *for_each(partial(flow_of, (3,), (4, 6), (3, 5), ()), AGREE, rb.ROTORS),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
