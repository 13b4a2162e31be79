"""Schemes with a heat bath within them."""

import pytest

import openmm_exactrb as rb
from openmm_exactrb.schemes import WITH_BATH, scheme, scheme_for_bath, shadow, stability_limit


@pytest.mark.parametrize(("name", "momenta", "places"), [("BAOAB", 1 / 6, -1 / 12), ("BAOA", -1 / 12, -1 / 12)])
def test_the_shadow_of_a_word_with_a_bath_is_that_of_its_splitting(name, momenta, places):
    """Leapfrog: the momenta of whole steps look cold, those of half steps hot, and its places are too wide."""
    found = shadow(WITH_BATH[name], 0.01)
    assert [(part - 1.0) / 0.01**2 for part in found] == pytest.approx([momenta, places], abs=2e-5)


def test_w2_3m_has_canonical_momenta_up_to_fast_librations():
    """Half a percent up to 160/ps at 6 fs per force, and it passes half a period of an oscillator, at 166/ps."""
    scheme = WITH_BATH["W2_3m"]
    for frequency in (20.0, 50.0, 80.0, 110.0, 130.0, 145.0, 160.0):
        assert shadow(scheme, 0.018 * frequency).kinetic == pytest.approx(1.0, abs=0.005)
    assert stability_limit(scheme) == pytest.approx(4.807, abs=0.002)  # 267/ps
    assert shadow(WITH_BATH["BAOA"], 0.006 * 130.0).kinetic < 0.95


def test_names_are_looked_up_among_all_schemes_that_a_bath_can_be_joined_to():
    assert scheme_for_bath("W2_3m") is WITH_BATH["W2_3m"]
    assert scheme_for_bath("W2_3") is rb.SCHEMES["W2_3"]
    for typo in ("w2_3m", "W2_3M"):
        with pytest.raises(ValueError, match=f"unknown scheme '{typo}': W2_3m was meant perhaps"):
            scheme_for_bath(typo)


@pytest.mark.parametrize("name", WITH_BATH)
def test_without_a_bath_they_are_refused_by_name(name):
    with pytest.raises(ValueError, match=f"scheme {name} has a heat bath within it: ExactRigidBodyLangevinIntegrator"):
        scheme(name)
