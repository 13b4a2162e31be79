"""physical_validation, which knows nothing of integrators, finds the canonical distributions in water."""

import numpy as np
import pytest

from benchmarks.water import validation

pytestmark = pytest.mark.validate
pytest.importorskip("physical_validation", reason="pip install 'openmm-exactrb[validation]'")

SETTINGS = {"molecules": 64, "length": 100.0}
STATES = [(298.15, None), (313.15, None), (298.15, 1.0), (298.15, 800.0)]

CANONICAL = ["Langevin", "Rescaling", "NoseHoover", "Hybrid"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("validation")


def judged(name, states, folder, interval=0.002, **settings):
    points = [validation.Run(name, *state, interval, 1, **(SETTINGS | settings)) for state in states]
    return validation.verdicts({point: [validation.make(point, folder)] for point in points})


# With velocity rescaling too few volumes of such a run are independent for a ratio of distributions.
@pytest.mark.parametrize(("name", "states"), [(name, STATES[: 2 if name == "Rescaling" else 4]) for name in CANONICAL])
def test_kinetic_energies_parts_and_ensembles_are_canonical(name, states, folder):
    """With the hundred numbers here one above 3.5 errors is expected in twenty runs of all, and one p below 1e-3."""
    found = judged(name, states, folder)
    assert sum(verdict.test == "ensemble" for verdict in found) == len(states) // 2
    for verdict in found:
        if verdict.test.endswith(" p"):
            assert verdict.value > 1e-3, verdict
        else:
            assert verdict.value < 4.0, verdict


def test_another_temperature_than_the_thermostat_has_is_noticed(folder):
    point = validation.Run("Langevin", 298.15, None, 0.002, 1, **SETTINGS)
    file = validation.make(point, folder)
    found = validation.verdicts({point._replace(temperature=308.15): [file]})
    values = {verdict.test: verdict.value for verdict in found}
    assert values["kinetic energy, p"] < 1e-3
    assert values["temperature of the mean"] > 4.0


def test_the_fluctuation_of_the_energy_falls_with_the_square_of_the_step(folder):
    points = [
        validation.Run("NVE", 298.15, None, h, 1, molecules=64, length=10.0, sampled=0.02) for h in validation.STEPS
    ]
    (verdict,) = validation.verdicts({point: [validation.make(point, folder)] for point in points})
    assert np.isfinite(verdict.value)
    assert verdict.value < 0.25
