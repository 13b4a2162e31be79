"""Schemes with a thermostat within them."""

import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import WITH_THERMOSTAT, scheme, scheme_for_thermostat, shadow, stability_limit


@pytest.mark.parametrize(("name", "momenta", "places"), [("BAOAB", 1 / 6, -1 / 12), ("BAOA", -1 / 12, -1 / 12)])
def test_the_shadow_of_a_scheme_with_a_thermostat_is_that_of_its_splitting(name, momenta, places):
    """Leapfrog: the momenta of whole steps look cold, those of half steps hot, and its places are too wide."""
    found = shadow(WITH_THERMOSTAT[name], 0.01)
    assert [(part - 1.0) / 0.01**2 for part in found] == pytest.approx([momenta, places], abs=2e-5)


def test_w2_3m_has_canonical_momenta_up_to_fast_librations():
    """Half a percent up to 160/ps at 6 fs per force, and it passes half a period of an oscillator, at 166/ps."""
    scheme = WITH_THERMOSTAT["W2_3m"]
    for frequency in (20.0, 50.0, 80.0, 110.0, 130.0, 145.0, 160.0):
        assert shadow(scheme, 0.018 * frequency).kinetic == pytest.approx(1.0, abs=0.005)
    assert stability_limit(scheme) == pytest.approx(4.807, abs=0.002)  # 267/ps
    assert shadow(WITH_THERMOSTAT["BAOA"], 0.006 * 130.0).kinetic < 0.95


def test_names_are_looked_up_among_all_schemes_that_a_thermostat_can_be_joined_to():
    assert scheme_for_thermostat("W2_3m") is WITH_THERMOSTAT["W2_3m"]
    assert scheme_for_thermostat("W2_3") is rb.SCHEMES["W2_3"]
    for typo in ("w2_3m", "W2_3M"):
        with pytest.raises(ValueError, match=f"'{typo}'.* did you mean 'W2_3m'"):
            scheme_for_thermostat(typo)


@pytest.mark.parametrize("name", WITH_THERMOSTAT)
def test_without_a_thermostat_they_are_refused_by_name(name):
    with pytest.raises(ValueError, match=f"{name} .*ExactRigidBodyLangevinIntegrator"):
        scheme(name)
