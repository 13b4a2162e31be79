"""OpenMM's formula and the compiled kernel are the same potential."""

import numpy as np
import pytest

import openmm_exactrb as rb
from force_laws import evaluated, positions_of
from soft_dipoles import FIELD, assert_same, fluid

OPEN = {}
PERIODIC = {"boundary": rb.ReactionField(), "density": 0.5}
KERNELS = ("openmm", "compiled")


@pytest.mark.parametrize(("n", "options"), [(1, OPEN), (2, OPEN), (32, OPEN), (27, OPEN), (27, PERIODIC), (27, FIELD)])
def test_both_kernels_agree(n, options):
    assert_same(*(evaluated(fluid(n, kernel=kernel, **options)[0]) for kernel in KERNELS))


def test_both_kernels_agree_for_a_body_of_its_own():
    own = {"inertia": (1.0, 1.5, 2.0), "dipole": (0.3, -0.8, 0.5), "mass": 3.0, "sigma": 0.9, "epsilon": 1.7}
    assert_same(*(evaluated(fluid(27, kernel=kernel, **own)[0]) for kernel in KERNELS))


@pytest.mark.parametrize("wca", [False, True])
@pytest.mark.parametrize("options", [OPEN, FIELD], ids=["open", "periodic"])
def test_both_kernels_agree_for_the_stockmayer_fluid(options, wca):
    own = options | {"attraction": 0.8, "wca": wca, "sigma": 1.2 if wca else 0.9, "epsilon": 1.7}
    assert_same(*(evaluated(fluid(27, kernel=kernel, **own)[0]) for kernel in KERNELS))


@pytest.mark.parametrize(("wca", "attraction"), [(False, 2.7), (True, 2.7), (False, 0.0), (True, 0.0), (True, -1.0)])
def test_both_kernels_follow_the_parameters_of_the_context(wca, attraction):
    results = []
    for kernel in KERNELS:
        context, _ = fluid(9, kernel=kernel, attraction=0.5, wca=wca)
        context.setParameter("soft_attraction", attraction)
        context.setParameter("soft_repulsion", 1.3)
        context.setParameter("dipole_coupling", 2.1)
        results.append(evaluated(context))
    assert_same(*results)


def test_both_kernels_agree_in_a_box_whose_edges_are_changed():
    results = []
    for kernel in KERNELS:
        context, _ = fluid(
            27, kernel=kernel, boundary=rb.ReactionField(cutoff=1.7, switch=1.0, dielectric=7.0), density=0.5
        )
        edges = np.array([3.6, 3.7, 3.9])
        context.setPeriodicBoxVectors(*np.diag(edges))
        if kernel == "openmm":
            for axis, edge in zip("xyz", edges, strict=True):
                context.setParameter(f"box_{axis}", edge)
        results.append(evaluated(context))
    assert_same(*results)


def test_the_trajectory_is_the_same_to_roundoff_growth():
    ends = []
    for kernel in KERNELS:
        context, integrator = fluid(27, kernel=kernel, trap=0.5)
        integrator.setVelocitiesToTemperature(12.0, 1)
        integrator.step(20)
        ends.append(positions_of(context))
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-11)
