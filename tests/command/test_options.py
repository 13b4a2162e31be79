"""Every option that `exactrb run` passes on reaches the integrator."""

import argparse

import pytest

from openmm_exactrb.command import arguments, run, setup


def value_of(how):
    """Return a value of an option, as a user types it."""
    return str([*how["choices"]][-1]) if "choices" in how else "3"


@pytest.mark.parametrize("name", [name for name, _ in setup.OPTIONS])
def test_options_reach_the_integrator(name):
    how = dict(setup.OPTIONS)[name]
    flag = arguments.flag(name)

    def taken(*given):
        parser = argparse.ArgumentParser()
        run.add_options(parser)
        parsed = parser.parse_args(given)
        return setup.integrator_of(parsed, {"scheme": "S2_2"}, 0.004).getSettings()["arguments"]

    value = how.get("type", str)(value_of(how))
    assert taken(flag, value_of(how))[name] == value != taken()[name]
