"""Sequences of steps with a thermostat."""

import math

import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import WITH_THERMOSTAT, thermostatted
from openmm_exactrb.steps.sequence import merged, palindromic
from openmm_exactrb.steps.substeps import HeatExchange, Substep
from openmm_exactrb.thermostats import HybridMonteCarlo
from openmm_exactrb.thermostats.hybrid import Metropolis

PLAIN = [scheme for scheme in rb.SCHEMES.values() if not scheme.processor]


@pytest.mark.parametrize("scheme", [*PLAIN, *WITH_THERMOSTAT.values()], ids=lambda scheme: scheme.name)
def test_steps_have_one_thermostat_of_the_whole_step_and_read_the_same_from_behind(scheme):
    """From heat exchange to heat exchange, wherever a step ends."""
    sequence = thermostatted.with_thermostat(scheme).sequence
    exchanges = [row for row in sequence if isinstance(row[0], HeatExchange)]
    assert math.fsum(part for _, part in exchanges) == 1.0
    assert [substep for substep, _ in exchanges] == [HeatExchange(k) for k in range(len(exchanges))]
    first = sequence.index(exchanges[0])
    between = sequence[first + 1 :] + sequence[:first]
    assert palindromic(merged(row for row in between if not isinstance(row[0], HeatExchange)))


@pytest.mark.parametrize("scheme", PLAIN, ids=lambda scheme: scheme.name)
@pytest.mark.parametrize("steps", [1, 3])
def test_a_proposal_of_some_steps_fills_the_same_time(scheme, steps):
    found = thermostatted.proposal(scheme, steps)
    for substep in {substep for substep, _ in scheme.sequence}:
        whole = math.fsum(part for other, part in scheme.sequence if other == substep)
        assert math.fsum(part for other, part in found.sequence if other == substep) == pytest.approx(whole, abs=1e-14)
    assert found.forces == steps * scheme.forces
    proposal = Substep()
    halves = (HeatExchange(0), 0.5), (proposal, 1.0), (HeatExchange(1), 0.5)
    assert thermostatted.with_proposals(found, proposal).sequence == halves


@pytest.mark.parametrize("steps", [1, 3])
def test_a_hybrid_step_decides_on_the_proposal_between_its_halves(steps):
    scheme = rb.SCHEMES["S2_2"]
    thermostat = HybridMonteCarlo(300.0, 1.0, stepsPerProposal=steps)
    proposal = thermostatted.proposal(scheme, steps)
    assert thermostat.splitting(scheme) == (proposal, steps)
    assert thermostat.steps(scheme).sequence[1] == (Metropolis(proposal, 300.0), 1.0)
