"""What shadow energies predict for slow translation and fast rotation: benchmarks/water/shadow.py."""

import numpy as np
import pytest

from benchmarks.water.shadow import TEMPERATURE, Anharmonicity, at_thermostat, predicted
from openmm_exactrb.schemes import WITH_THERMOSTAT, splitting
from openmm_exactrb.schemes import shadow as kept
from openmm_exactrb.schemes.thermostatted import with_thermostat
from openmm_exactrb.steps.substeps import DRIFT, KICK

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


def quartic(scheme, h, friction=0.2, walkers=40_000, steps=300):
    """Return the mean of x⁴/4 at the ends of steps of particles of unit mass with kT = 1, and its error."""
    rng = np.random.default_rng(1)
    x, p = rng.normal(scale=0.5, size=walkers), rng.normal(size=walkers)
    means = []
    for step in range(steps):
        for substep, part in scheme.sequence:
            if substep == DRIFT:
                x += part * h * p
            elif substep == KICK:
                p -= part * h * (x * x * x)  # a power takes ten times as long
            else:
                fade = np.exp(-friction * part * h)
                p = fade * p + np.sqrt(1.0 - fade**2) * rng.normal(size=walkers)
        if step >= steps // 4:
            means.append(((x * x) ** 2).mean() / 4.0)
    blocks = np.array([block.mean() for block in np.array_split(means, 10)])
    return blocks.mean(), blocks.std(ddof=1) / np.sqrt(len(blocks))


# <f²> = <x⁶> = 3 <x²>; U is kT/4 and V'' goes as the root of the temperature.
QUARTIC = Anharmonicity(3.0 * 0.675978, 0.5, 0.5, 0.0)


@pytest.mark.parametrize(
    ("name", "h", "of_oscillators"),
    [("W2_3m", 0.8, 0.0), pytest.param("BAOA", 0.3, 0.0, marks=pytest.mark.validate), ("V2", 0.3, 0.125)],
)
def test_the_energy_of_anharmonic_motion(name, h, of_oscillators):
    """V2 has its thermostat at both ends of a step, where places of oscillators are too wide by (w h)²/4."""
    scheme = splitting(name)
    excess = QUARTIC.energy(scheme, h / scheme.forces)[0] + of_oscillators * h**2 * QUARTIC.squares
    found, error = quartic(with_thermostat(scheme), h)
    assert found - 0.25 == pytest.approx(excess, abs=4.0 * error + 0.15 * abs(excess))
    assert error < 5e-4
