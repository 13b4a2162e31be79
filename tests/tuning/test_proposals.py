"""Settings of hybrid Monte Carlo: what a proposal is worth, and what is measured of it."""

from dataclasses import replace

import numpy as np
import openmm
import pytest
from openmm import unit

import openmm_exactrb as rb
from openmm_exactrb import tuning


@pytest.mark.parametrize(("acceptance", "friction"), [(1.0, 5.0), (0.9, 5.0), (0.6, 40.0), (0.3, 1.0)])
def test_a_proposal_is_worth_what_a_free_body_diffuses(acceptance, friction):
    """Walks with the rule itself: <x²> = 2 (v²/friction) n progress, after many proposals."""
    rng, step, n, walkers = np.random.default_rng(3), 0.01, 2000, 8000
    fade = np.exp(-friction * step)
    v, x = rng.standard_normal(walkers), np.zeros(walkers)
    for _ in range(n):
        taken = rng.random(walkers) < acceptance
        x += np.where(taken, step * v, 0.0)
        v = np.where(taken, v, -v)
        v = fade * v + np.sqrt(1.0 - fade**2) * rng.standard_normal(walkers)
    found = (x**2).mean() * friction / (2.0 * n)
    # The walk forgets within 1/friction, at the latest, of its 20 ps.
    assert found == pytest.approx(tuning.progress(step, acceptance, friction), rel=0.07)


def test_what_is_always_taken_is_worth_its_time_and_what_is_never_taken_nothing():
    assert tuning.progress(1e-4, 1.0, 1.0) == pytest.approx(1e-4, rel=1e-8)
    assert tuning.progress(0.01, 0.0, 1.0) == 0.0


@pytest.fixture(scope="module")
def found(droplet):
    options = {"temperature": 300.0 * unit.kelvin, "friction": 5.0 / unit.picosecond, "platform": "Reference"}
    return rb.tune_proposals(*droplet, schemes=["S2_2", "V2"], proposals=150, **options)


def test_the_cheapest_is_the_first_and_lies_between_refusals_and_small_steps(found):
    costs = [proposal.cost for proposal in found]
    assert costs == sorted(costs)
    for name in ("S2_2", "V2"):
        tried = sorted((p for p in found if p.method == name), key=lambda p: p.step)
        assert len(tried) >= 3
        assert tried[0].acceptance > 0.9
        assert tried[0].acceptance >= tried[-1].acceptance
        best = min(tried, key=lambda p: p.cost)
        assert best.step > tried[0].step
    assert "ns per day" in str(found[0])


def test_the_advice_makes_an_integrator_of_its_setting(found, droplet):
    best = found[0]
    integrator = best.integrator()
    assert integrator.getStepSize()._value == best.step
    assert integrator.getTemperature()._value == 300.0
    assert integrator.getFriction()._value == 5.0
    assert integrator.getScheme().name == best.method
    system, state = droplet
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setState(state)
    integrator.setRandomNumberSeed(7)
    integrator.step(600)
    assert abs(integrator.acceptanceRate() - best.acceptance) < 0.12


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"temperature": 0.0}, "temperature must be a positive number of K"),
        ({"friction": 0.0}, "friction must be a positive number of /ps"),
        ({"proposals": 0}, "proposals must be a whole number"),
        ({"schemes": ["leapfrog"]}, "unknown scheme 'leapfrog'"),
        ({"schemes": "leapfrog"}, "unknown scheme 'leapfrog'"),
        ({"schemes": []}, "schemes is empty: name some of"),
        ({"schemes": ["V2_C17"]}, "V2_C17 prepares the state before a run"),
    ],
)
def test_bad_settings_get_a_sentence(droplet, options, match):
    with pytest.raises(ValueError, match=match):
        rb.tune_proposals(*droplet, **({"temperature": 300.0, "friction": 5.0} | options))


def test_a_scheme_of_ones_own_is_proposed_with(droplet):
    own = replace(rb.SCHEMES["S2_2"], name="own")
    found = rb.tune_proposals(*droplet, temperature=300.0, friction=5.0, schemes=own, proposals=2, platform="Reference")
    assert {p.method for p in found} == {"own"}
    assert found[0].integrator().getScheme() == own
