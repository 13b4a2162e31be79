"""The search for splittings: its droplets are OpenMM's, its oscillators are those of the steps."""

import numpy as np
import pytest

import openmm_exactrb as rb
from benchmarks.common import droplets
from benchmarks.schemes import search
from sequences import advanced
from starts import context_of


@pytest.mark.validate  # it compiles the droplets, which takes as long as all other tests of the searches
@pytest.mark.parametrize("model", search.MODELS)
def test_a_droplet_moves_as_it_does_in_openmm(model):
    kind, system, _, lattice = droplets.prepared(4, model)
    start = droplets.start(4, model, 1, picoseconds=2)
    scheme, h, n = rb.SCHEMES["W2_5"], 0.01, 10
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme)
    _context = context_of(system, integrator, lattice.getState(positions=True).getPositions())
    integrator.setBodyState(start)
    before = integrator.totalEnergy()._value
    integrator.step(n)
    energies, end = droplets.run(kind, start, scheme, h, n * h, n * h)
    theirs = integrator.bodyState()[1]
    for ours, wanted in zip(end, theirs, strict=True):
        np.testing.assert_allclose(ours, wanted, rtol=0.0, atol=1e-5 * np.abs(wanted).max())
    assert np.abs(end.R - start.R).max() > 1e-3
    assert 4.0 * energies[0] == pytest.approx(before, rel=1e-5)


@pytest.mark.parametrize("family", search.FAMILIES)
def test_coefficients_make_a_member_of_a_family(family):
    free = np.random.default_rng(1).uniform(0.02, 0.1, search.dimension(family)).tolist()
    scheme = search.member(family, free)
    symbols = "".join(substep.symbol for substep, _ in scheme.sequence)
    assert symbols.replace("BC", "C") == family  # a magnified kick is two substeps


@pytest.mark.parametrize("name", ["V2", "W2_4", "Chin4A", "W2_5", "SRKN4_6b"])
def test_a_step_keeps_the_hamiltonian_of_its_oscillator(name):
    scheme, x = rb.SCHEMES[name], 0.7
    alpha, beta = (float(c[0]) for c in search.oscillator(scheme, np.array([x])))
    q, p = advanced(
        scheme,
        lambda s, tau: (s[0] + tau * s[1], s[1]),
        lambda s, tau: (s[0], s[1] - tau * s[0]),
        (0.3, 1.1),
        x,
        n=5,
        gradient_kick=lambda c: lambda s, tau: (s[0], s[1] - tau * (1.0 - c * tau * tau) * s[0]),
    )
    assert alpha * p**2 + beta * q**2 == pytest.approx(alpha * 1.1**2 + beta * 0.3**2, rel=1e-12)
    # As fast as the flow of this Hamiltonian turns: five steps of the angle sqrt(alpha beta) x.
    angle, ratio = 5.0 * np.sqrt(alpha * beta) * x, np.sqrt(alpha / beta)
    assert q == pytest.approx(0.3 * np.cos(angle) + 1.1 * ratio * np.sin(angle), abs=1e-12)


@pytest.mark.validate
def test_a_run_that_blows_up_has_an_infinite_error():
    assert search.error(rb.SCHEMES["V2"], 60.0, 4, "tip3p", 1, 1.0, 1.0) == np.inf
