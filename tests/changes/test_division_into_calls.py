"""How steps are divided into calls changes no bit of what the Context shows, on processors."""

from itertools import accumulate

import numpy as np

import openmm_exactrb as rb
from peptides import in_water, peptide
from places import CPU
from products import in_pairs
from starts import context_of, held

# With several threads, forces differ from run to run.
THREADS = {"Threads": "1"}
DIVISIONS = (1,) * 8, (2, 3, 0, 3), (8,)


def shown_after(calls, start, platform, make):
    """Return what a Context shows after each number of steps at which one of these calls ends."""
    _, system, x = start
    integrator = make()
    context = context_of(system, integrator, x, platform=platform, properties=THREADS if platform is CPU else None)
    integrator.setVelocitiesToTemperature(300.0, 1)
    shown = {}
    for end, n in zip(accumulate(calls), calls, strict=True):
        integrator.step(n)
        shown[end] = held(context)
    return shown


@in_pairs(
    {
        "scheme": ["S2_2", "W2_1", "W4_4", "SRKN4_6b", "BAOA", "W2_3m"],
        "fast": [None, "bonded"],
        "start": [peptide, in_water],
        "platform": ["Reference", "CPU"],
        "engine": ["host", "native"],
    },
    indirect=["platform"],
)
def test_it_changes_no_bit(scheme, fast, start, platform, engine):
    def make():
        thermostat = rb.thermostats.Langevin(300.0, 5.0) if scheme in ("BAOA", "W2_3m") else None
        integrator = rb.ExactRigidBodyIntegrator(
            forceInterval=0.001, scheme=scheme, fast=fast, engine=engine, thermostat=thermostat
        )
        integrator.setRandomNumberSeed(1)
        return integrator

    one_by_one, *others = (shown_after(calls, start(), platform, make) for calls in DIVISIONS)
    for shown in others:
        for end, bits in shown.items():
            np.testing.assert_array_equal(bits, one_by_one[end])
