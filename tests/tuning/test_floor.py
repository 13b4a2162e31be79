"""What puts a floor under the energy error is named with its remedy."""

import pytest
from openmm import app

import openmm_exactrb as rb
from openmm_exactrb.command.description import described
from openmm_exactrb.tuning.floor import causes

SWITCH = "NonbondedForce has a cutoff without a switch: set switchDistance"
TOLERANCE = "NonbondedForce has an ewaldErrorTolerance of 0.0005: use 1e-05"


def water(n=27, **options):
    _, system, positions = rb.rigid_water(n, nonbondedMethod=app.PME, nonbondedCutoff=0.45, **options)
    return system, positions


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, [SWITCH, TOLERANCE]),
        ({"switchDistance": 0.35}, [TOLERANCE]),
        ({"ewaldErrorTolerance": 1e-5}, [SWITCH]),
        ({"switchDistance": 0.35, "ewaldErrorTolerance": 1e-5}, []),
    ],
)
def test_rough_forces_are_named_with_the_remedy(options, expected):
    system, _ = water(**options)
    assert list(causes(system)) == expected
    said = " ".join(described(system))
    assert ("exactrb tune measures this limit" in said) == bool(expected)
    assert all(cause in said for cause in expected)
    assert list(causes(rb.rigid_water(2)[1])) == []
