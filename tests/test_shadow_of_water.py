"""What shadow energies predict for slow translation and fast rotation: benchmarks/shadow.py."""

import numpy as np
import pytest

from openmm_exactrb.schemes import WITH_THERMOSTAT, splitting
from openmm_exactrb.schemes import shadow as kept
from shadow import TEMPERATURE, at_thermostat, predicted

SLOW, FAST = 40.0, 120.0  # 1/ps
SPECTRUM = np.array([SLOW, FAST]), np.array([1.0, 0.0]), np.array([0.0, 1.0])
H = 0.006


def test_baoab_and_baoa_go_through_the_same_places():
    """They are one algorithm, half a kick apart: one potential energy, the exact one, and other momenta."""
    of_baoab, of_baoa = (predicted(WITH_THERMOSTAT[name], H, *SPECTRUM) for name in ("BAOAB", "BAOA"))
    assert of_baoab[1] == pytest.approx(of_baoa[1], abs=1e-9)
    assert of_baoa[1] == pytest.approx(0.0, abs=1e-9)
    # Leapfrog: <p²> of whole steps is 1 - (w h)²/4 of that of half steps, where the thermostat is.
    angles = H * np.array([SLOW, FAST])
    hot = np.array([1.0 / kept(WITH_THERMOSTAT["BAOA"], angle).kinetic for angle in angles])
    hot *= TEMPERATURE / hot.mean()
    assert of_baoa[0] == pytest.approx(hot[1] - hot[0])
    cold = hot * (1.0 - angles**2 / 4.0)
    assert of_baoab[0] == pytest.approx(cold[1] - cold[0])


@pytest.mark.parametrize("name", ["V2", "W2_3"])
def test_half_a_thermostat_at_either_end_acts_at_the_end_of_a_step(name):
    assert at_thermostat(splitting(name)) == splitting(name)


def test_what_is_beyond_stability_is_reported():
    assert predicted(splitting("V2"), H, *SPECTRUM)[2] == 0.0
    assert predicted(splitting("V2"), 0.018, *SPECTRUM)[2] == 1.0
