"""Custom bonds, angles and torsions in kernels have OpenMM's forces, with the present parameters of the Context."""

import numpy as np
import openmm
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from custom_forces import ENERGIES, KINDS, N, chain, force_of
from kicks import Kicks
from openmm_exactrb.engines.native.flexible import blocks
from openmm_exactrb.engines.native.flexible.blocks import Group
from openmm_exactrb.engines.native.flexible.expressions import Custom
from openmm_exactrb.engines.native.flexible.molecules import Molecules
from openmm_exactrb.library.library import library
from openmm_exactrb.multiple_time_steps.bonded import Bonded
from openmm_exactrb.multiple_time_steps.terms import NO_TERMS
from places import REFERENCE, device_platform
from starts import context_of

pytestmark = pytest.mark.library

RNG = np.random.default_rng(8)


def kicks_of(system, platform):
    """Return a function of positions, and of parameters, that returns the forces of a System's custom forces."""
    n, customs = system.getNumParticles(), tuple(Custom.of(Bonded.of(force)) for force in system.getForces())
    molecules = Molecules([Group(np.arange(n)[:, None])], np.ones(n), np.arange(n), NO_TERMS, customs)
    return Kicks(system, molecules, platform)


def of_openmm(system, x, **parameters):
    context = context_of(system, openmm.VerletIntegrator(0.001), x)
    for name, value in parameters.items():
        context.setParameter(name, value)
    return context.getState(forces=True).getForces(asNumpy=True)._value


def places(n=N):
    """Return positions of a chain without straight angles."""
    turns = np.radians(100.0) * np.arange(n)
    helix = np.stack([0.5 * np.cos(turns), 0.5 * np.sin(turns), 0.4 * np.arange(n)], axis=1)
    return helix + RNG.uniform(-0.1, 0.1, (n, 3))


def assert_as_openmm(ours, theirs):
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=2e-13 * max(1.0, np.abs(theirs).max()))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("energy", ENERGIES)
def test_every_function_is_openmms(kind, energy):
    system, x = chain(force_of(kind, energy)), places()
    kicks = kicks_of(system, REFERENCE)
    for parameters in ({}, {"p": 0.3}, {"p": 0.9, "q": 2.0}):
        assert_as_openmm(kicks(x, **parameters), of_openmm(system, x, **kicks.context.getParameters()))


@pytest.mark.opencl
@pytest.mark.parametrize("kind", KINDS)
def test_every_function_is_openmms_on_devices(kind, monkeypatch):
    """All at once, in chains of their own and in blocks that share terms."""
    monkeypatch.setattr(blocks, "COST_OF_BLOCK", 40)
    monkeypatch.setattr(blocks, "COST_OF_MOLECULE", 40)
    count = len(ENERGIES)
    system = chain(*(force_of(kind, energy, N * i) for i, energy in enumerate(ENERGIES)), n=N * count)
    x = np.concatenate([places() for _ in ENERGIES])
    kicks = kicks_of(system, device_platform())
    assert len(kicks.part.blocks) > count
    resolution = 8.0 * 2.0**-32  # of sums in fixed point, for a few terms on a particle
    for parameters in ({}, {"p": 0.3}, {"p": 0.9, "q": 2.0}):
        ours, theirs = kicks(x, **parameters), of_openmm(system, x, **kicks.context.getParameters())
        for i, energy in enumerate(ENERGIES):
            own = slice(N * i, N * (i + 1))
            tolerance = resolution + 1e-12 * np.abs(theirs[own]).max()
            assert np.abs(ours[own] - theirs[own]).max() < tolerance, energy


NUMBERS = st.sampled_from(["v", "k", "a", "p", "q", "2", "0.5", "3"])
EXPRESSIONS = st.recursive(
    NUMBERS,
    lambda some: st.one_of(
        st.builds("({}+{})".format, some, some),
        st.builds("({}-{})".format, some, some),
        st.builds("{}*{}".format, some, some),
        st.builds("{0}/(1+({1})^2)".format, some, some),
        st.builds("sin({})".format, some),
        st.builds("tanh({})".format, some),
        st.builds("sqrt(1+({})^2)".format, some),
        st.builds("exp(-({})^2)".format, some),
        st.builds("(1+abs({}))^{}".format, some, st.sampled_from(["0.5", "-1.5", "p", "3"])),
        st.builds("min({},{})".format, some, some),
        st.builds("select(step({}),{},{})".format, some, some, some),
    ),
    max_leaves=8,
)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=40, deadline=None)
@given(energy=EXPRESSIONS, p=st.floats(0.1, 2.0), q=st.floats(-2.0, 2.0))
def test_any_expression_is_openmms(kind, energy, p, q):
    energy = f"0*v + {energy}".replace("v", KINDS[kind][1])
    system, x = chain(force_of(kind, energy)), places()
    assert_as_openmm(kicks_of(system, REFERENCE)(x, p=p, q=q), of_openmm(system, x, p=p, q=q))


def test_particles_at_one_place_have_no_force():
    system, x = chain(force_of("Bond", ENERGIES[0])), places()
    x[1] = x[0]
    assert_as_openmm(kicks_of(system, REFERENCE)(x), of_openmm(system, x))


def test_positions_that_are_not_finite_have_such_forces():
    x = places()
    x[4] = np.nan
    for kind in KINDS:
        assert np.isnan(kicks_of(chain(force_of(kind, ENERGIES[0])), REFERENCE)(x)[4]).all()


def test_terms_without_numbers_or_parameters():
    force = openmm.CustomBondForce("100*(r-1)^2")
    force.addBond(0, 1)
    force.addBond(3, 1)
    system, x = chain(force), places()
    assert_as_openmm(kicks_of(system, REFERENCE)(x), of_openmm(system, x))


def test_an_expression_that_openmm_cannot_read_is_an_error():
    with pytest.raises(openmm.OpenMMException, match="unknown function: spline"):
        library().derivative("spline(r)", "r")
