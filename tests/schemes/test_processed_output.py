"""Outputs of processed schemes: a cheap way back from inner coordinates, for what is looked at while a run goes on."""

from dataclasses import replace

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.steps.substeps import DRIFT, LastForcesKick
from starts import droplet_of

WITH_OUTPUT = [name for name, scheme in rb.SCHEMES.items() if scheme.output]


def looked_at(scheme, h=0.02, looks=60):
    """Return total energies of a droplet at each step behind the tenth, the inner state, and the evaluations a step."""
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, engine="host")
    _simulation = droplet_of(integrator)
    integrator.step(10)
    integrator.timings.reset()
    energies = []
    for _ in range(looks):
        integrator.step(1)
        energies.append(integrator.totalEnergy()._value)
    inner = integrator._propagator.sync.inner  # noqa: SLF001
    return np.array(energies), inner and inner.state, integrator.timings.evaluations / looks


@pytest.mark.parametrize("name", WITH_OUTPUT)
def test_an_output_is_cheaper_than_the_inverse_and_leaves_the_run_as_it_is(name):
    scheme = rb.SCHEMES[name]
    assert scheme.output_forces < replace(scheme, output=()).output_forces == scheme.processing / 2
    _, inner, evaluations = looked_at(scheme)
    _, same, more = looked_at(replace(scheme, output=()))
    for ours, theirs in zip(inner, same, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert evaluations < more


@pytest.mark.parametrize("name", WITH_OUTPUT)
def test_the_energy_that_an_output_shows_has_the_accuracy_of_the_scheme(name):
    """As steady as through the exact inverse, and the same but for a small part of what a processor takes away."""
    scheme = rb.SCHEMES[name]
    shown, exact, kernel = (
        looked_at(each)[0] for each in (scheme, replace(scheme, output=()), replace(scheme, output=(), processor=()))
    )
    assert shown.std() < 1.5 * exact.std()
    assert np.abs(shown - exact).max() < 0.1 * abs(kernel.mean() - exact.mean())


@pytest.mark.parametrize("name", WITH_OUTPUT)
def test_an_output_ends_where_the_step_does(name):
    """Its times are those of the processor's inverse: drifts add up to nothing, and kicks too."""
    scheme = rb.SCHEMES[name]
    kicks = 0.0
    for substep, part in scheme.output:
        if isinstance(substep, LastForcesKick):
            kicks += part * sum(substep.weights)
        elif substep != DRIFT:
            kicks += part
    assert sum(part for substep, part in scheme.output if substep == DRIFT) == pytest.approx(0.0, abs=1e-15)
    assert kicks == pytest.approx(0.0, abs=1e-15)
