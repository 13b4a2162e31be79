"""Kernels in numpy and compiled: the same functions with the same results."""

import numpy as np
import pytest

from openmm_exactrb import kernels
from openmm_exactrb.kernels.plain import bodies, exact, random
from openmm_exactrb.kernels.records import Particles
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.rotors.exact import constants

N = 130


def columns(rng, *shape):
    return rng.standard_normal(shape)


def sums_of(rng, k, n):
    """Return random sums (2, k, n), with something in their low parts."""
    high = columns(rng, k, n)
    return np.array([high, np.spacing(high) * rng.uniform(-0.4, 0.4, high.shape)])


def of_bodies(rng):
    sums = [(sums_of(rng, k, n), columns(rng, k, n), 0.3, np.zeros((2, k, n))) for k, n in ((3, N), (4, 0))]
    cases = {"place": [], "move": [], "collect": [], "advance": sums}
    for turning, sizes in ((N, N * [3]), (40, [*range(1, 41), *90 * [1], 3, 2]), (0, [1, 1]), (2, [5, 5])):
        starts, n, bodies = np.cumsum([0, *sizes]), sum(sizes), len(sizes)
        particles = Particles(starts, rng.permutation(n + 4)[:n], columns(rng, n, 3))
        R, q = columns(rng, 3, bodies), np.ascontiguousarray(quaternions.random(rng, turning).T)
        cases["place"].append((R, q, particles, np.zeros((n + 4, 3))))
        cases["move"].append((R, columns(rng, 3, turning), q, particles, np.zeros((n + 4, 3))))
        cases["collect"].append((q, particles, columns(rng, n + 4, 3), np.ones((3, bodies)), np.ones((3, turning))))
    return cases


def of_exact(rng):
    m, q = columns(rng, 3, N), np.ascontiguousarray(quaternions.random(rng, N).T)
    cases = []
    for inertia in (np.sort(rng.uniform(0.5, 2.0, (3, N)), axis=0), np.array([[0.5], [0.8], [1.0]])):
        for t in (np.array([0.05]), np.array([-8.0]), rng.uniform(-30.0, 30.0, N)):
            for q0, m0 in ((exactly(q), exactly(m)), (q[None], m[None])):
                cases.append((constants(inertia), q0, m0, t, np.empty_like(q0), np.empty_like(m0)))
    return {"advance": cases}


def of_random(rng):
    instants = [(*rng.integers(-(2**63), 2**63, 2), int(rng.integers(2**40)), block) for block in (0, 1, 7)]
    return {"uniforms": [(*map(int, instant), np.empty((4, n))) for instant in instants for n in (0, 1, N)]}


INPUTS = {"bodies": of_bodies, "exact": of_exact, "random": of_random}
IN_NUMPY = {"bodies": bodies, "exact": exact, "random": random}
#: Differences of the results allowed, relative to their size; what is not named agrees to the bit.
TOLERANCES = {"bodies.place": 2e-15, "bodies.move": 2e-15, "bodies.collect": 2e-15, "exact.advance": 3e-14}


@pytest.mark.parametrize("name", INPUTS)
def test_numpy_and_compiled_kernels_write_the_same_results(name, rng):
    compiled = kernels.load(name)
    for function, cases in INPUTS[name](rng).items():
        tolerance = TOLERANCES.get(f"{name}.{function}", 0.0)
        for case in cases:
            one, other = (written(getattr(module, function), case) for module in (IN_NUMPY[name], compiled))
            for a, b in zip(one, other, strict=True):
                np.testing.assert_allclose(b, a, rtol=0.0, atol=tolerance * np.abs(a).max(initial=0.0))


def written(function, arguments):
    """Return the arrays among the arguments after a call, which writes its results into the last ones."""
    own = [a.copy() if isinstance(a, np.ndarray) else a for a in arguments]
    function(*own)
    return [a for a in own if isinstance(a, np.ndarray)]
