"""The rows of a scheme, from which the program of the device is made."""

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.engines.custom_program.rows import REST, Table
from openmm_exactrb.schemes import WITH_THERMOSTAT, Scheme, spelled
from openmm_exactrb.substeps import DRIFT, HEAT_EXCHANGE, KICK, GradientKick

SCHEMES = {**rb.SCHEMES, **WITH_THERMOSTAT}


def carried_out(rows):
    """Return the parts of a step in the order in which the program carries rows out."""
    parts, displaced = [], 0.0
    for row in rows:
        steps = [(HEAT_EXCHANGE, row.before), (KICK, row.kick), (HEAT_EXCHANGE, row.after), (DRIFT, row.drift)]
        if displaced:  # the strength of a gradient over the square of the step, and so over that of its part
            steps[1] = (GradientKick(displaced / row.kick**2), row.kick)
        displaced = row.shift
        parts += [(substep, part) for substep, part in steps if part]
    return parts


@pytest.mark.parametrize("name", SCHEMES)
def test_rows_carry_out_the_sequence(name):
    scheme = SCHEMES[name]
    table = Table.of(scheme)
    sizes = (table.enter, table.step, 1, table.leave, bool(table.leave), table.output, bool(table.output))
    enter, step, rest, leave, last, _, end = np.split(np.array(table.rows, dtype=object), np.cumsum(sizes)[:-1])
    assert all(row == REST for row in (*rest, *last, *end))
    for rows, sequence in ((enter, scheme.processor), (step, scheme.sequence), (leave, scheme.postprocessor)):
        expected = [(substep, part) for substep, part in sequence if part]
        for (substep, part), (expected_substep, expected_part) in zip(carried_out(rows), expected, strict=True):
            if isinstance(substep, GradientKick):
                assert substep.strength == pytest.approx(expected_substep.strength, rel=1e-14)
            else:
                assert substep == expected_substep
            assert part == pytest.approx(expected_part, rel=1e-15)


@pytest.mark.parametrize("name", SCHEMES)
def test_three_tables_of_single_precision_are_the_numbers(name):
    table = Table.of(SCHEMES[name])
    columns = np.array(table.columns())
    assert (columns.astype(np.float32) == columns).all()
    drifts = columns.sum(axis=0).reshape(-1, len(table.rows))[table.column("drift")]
    np.testing.assert_array_equal(drifts, [row.drift for row in table.rows])
    assert table.longest_drift == max(map(abs, drifts))


def test_substeps_that_fit_into_no_row_are_refused():
    with pytest.raises(ValueError, match=r"does not support the substep Kick\(group=3\)"):
        Table.of(Scheme("own", 2, spelled("A B3 A")))
    with pytest.raises(ValueError, match=r"does not support the substep HeatExchange\(number=0\)"):
        Table.of(WITH_THERMOSTAT["BAOA"], thermostat=False)
