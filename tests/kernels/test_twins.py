"""Twins, in numpy and compiled: the same functions with the same arguments and the same results."""

import inspect
from pathlib import Path

import numpy as np
import pytest
from numba import types

from openmm_exactrb import kernels, quaternions
from openmm_exactrb.compensated import exactly
from openmm_exactrb.rotors.exact import constants

N = 130


def plain_kernels(module):
    """Return the public functions of a module in numpy that only write results."""
    own = {name: f for name, f in vars(module).items() if inspect.isfunction(f) and f.__module__ == module.__name__}
    return {
        name: function
        for name, function in own.items()
        if not name.startswith("_") and inspect.signature(function).return_annotation == "None"
    }


def compiled_kernels(module):
    """Return the same of a compiled module, as they were written: parts that are inlined have no signature."""
    own = {name: f for name, f in vars(module).items() if getattr(f, "nopython_signatures", None)}
    return {
        name: function.py_func
        for name, function in own.items()
        if not name.startswith("_")
        and function.py_func.__module__ == module.__name__
        and {signature.return_type for signature in function.nopython_signatures} == {types.none}
    }


def columns(rng, *shape):
    return rng.standard_normal(shape)


def sums_of(rng, k, n):
    """Return random sums (2, k, n), with something in their low parts."""
    high = columns(rng, k, n)
    return np.array([high, np.spacing(high) * rng.uniform(-0.4, 0.4, high.shape)])


def of_bath(rng):
    widths = rng.uniform(0.5, 2.0, (3, N))
    results = np.zeros((2, 3, N))
    return {"relax": [(sums_of(rng, 3, N), widths, -0.3, 0.7, 11, 5, 2, 10, 97, results)]}


def of_bodies(rng):
    cases = {"place": [], "collect": []}
    R, q = columns(rng, 3, N), np.ascontiguousarray(quaternions.random(rng, N).T)
    for first, n, k, own in ((0, N, 3, False), (7, 40, 5, True), (N - 1, 1, 2, False), (3, 0, 3, True)):
        particles = rng.permutation(n * k + 4)[: n * k].reshape(n, k).astype(np.int64)
        sites, forces = columns(rng, n if own and n else 1, k, 3), columns(rng, n * k + 4, 3)
        cases["place"].append((R, q, particles, sites, first, np.zeros((n * k + 4, 3))))
        cases["collect"].append((q, particles, sites, first, forces, np.zeros((3, N)), np.zeros((3, N))))
    return cases


def of_exact(rng):
    m, q = columns(rng, 3, N), np.ascontiguousarray(quaternions.random(rng, N).T)
    cases = []
    for inertia in (np.sort(rng.uniform(0.5, 2.0, (3, N)), axis=0), np.array([[0.5], [0.8], [1.0]])):
        for t in (np.array([0.05]), np.array([-8.0]), rng.uniform(-30.0, 30.0, N)):
            for q0, m0 in ((exactly(q), exactly(m)), (q[None], m[None])):
                cases.append((constants(inertia), q0, m0, t, np.empty_like(q0), np.empty_like(m0)))
    return {"advance": cases}


def of_noise(rng):
    columns_of_three = (7, 9, 1, 20, 100, np.zeros((3, N)))
    return {name: [columns_of_three] for name in ("uniforms", "normals")}


def of_sums(rng):
    return {
        "advance": [(sums_of(rng, k, n), columns(rng, k, n), 0.3, np.zeros((2, k, n))) for k, n in ((3, N), (4, 0))]
    }


INPUTS = {"bath": of_bath, "bodies": of_bodies, "exact": of_exact, "noise": of_noise, "sums": of_sums}
#: What results may differ by, beside their size; what is not named agrees to the bit.
TOLERANCES = {"bodies.place": 2e-15, "bodies.collect": 2e-15, "exact.advance": 3e-14}
TWINS = [kernels.twins(which) for which in ("numpy", "numba")]


#: Every module in numpy has a twin.
NAMES = sorted(file.stem for file in Path(kernels.__file__).parent.glob("plain/[!_]*.py"))


def test_clusters_have_the_same_arguments():
    """Their suite, tests/motion/test_clusters.py, runs over both twins."""
    plain, compiled = (twins.clusters for twins in TWINS)
    names = [list(inspect.signature(getattr(f, "py_func", f)).parameters) for f in (plain.advance, compiled.advance)]
    assert names[0] == names[1]


@pytest.mark.parametrize("name", [name for name in NAMES if name != "clusters"])
def test_twins_have_the_same_functions_with_the_same_arguments_and_results(name, rng):
    plain, compiled = (getattr(twins, name) for twins in TWINS)
    written, built, inputs = plain_kernels(plain), compiled_kernels(compiled), INPUTS[name](rng)
    assert set(written) == set(built) == set(inputs)
    for function, cases in inputs.items():
        names = [list(inspect.signature(f[function]).parameters) for f in (written, built)]
        assert names[0] == names[1]
        for case in cases:
            assert_same_results(plain, compiled, function, case, TOLERANCES.get(f"{name}.{function}", 0.0))


def assert_same_results(plain, compiled, function, arguments, tolerance):
    results = []
    for module in (plain, compiled):
        own = [a.copy() if isinstance(a, np.ndarray) else a for a in arguments]
        getattr(module, function)(*own)
        changed = [not np.array_equal(a, b) for a, b in zip(own, arguments, strict=True)]
        results.append((own, changed))
    (a, changed), (b, also) = results
    assert changed == also
    assert any(changed) or not all(np.size(a) for a in arguments)
    for one, other in zip(a, b, strict=True):
        size = np.abs(one).max(initial=0.0) if np.ndim(one) else 0.0
        np.testing.assert_allclose(other, one, rtol=0.0, atol=tolerance * size)
