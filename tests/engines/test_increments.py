"""Increments of the state in single precision, as on a device: what they may err by, and what they may not accumulate.

A step changes a state by increments that err by roundings of float. Lengths of constraints, of angular momenta and of
quaternions are kept in double precision, and the energy walks without a direction.
"""

import numpy as np
import openmm
import pytest

from benchmarks.constraints.clusters import CLUSTERS
from both_engines import begun, maker
from starts import held
from zoo import every_kind

pytestmark = [pytest.mark.library, pytest.mark.opencl]
EPS = 2.0**-23  # of float
ROUNDOFF = 2.0**-52
COPIES = 256
PRECISIONS = pytest.mark.parametrize("precision", ["single", "mixed"])


def free(name):
    """Return a System of copies of a cluster, or of a rigid water, without forces, and positions."""
    masses, pairs, x = CLUSTERS[name]
    system, lengths = openmm.System(), [np.linalg.norm(x[i] - x[j]) for i, j in pairs]
    for copy in range(COPIES):
        for mass in masses:
            system.addParticle(mass)
        for (i, j), length in zip(pairs, lengths, strict=True):
            system.addConstraint(len(masses) * copy + int(i), len(masses) * copy + int(j), length)
    centres = 0.5 * np.argwhere(np.ones((8, 8, 4)))
    return system, (centres[:, None] + np.array(x)).reshape(-1, 3)


def in_motion(system, x, make, engine, precision="mixed", velocities=None):
    context = begun(system, x, make(engine), precision=precision, kelvin=None)
    if velocities is None:
        context.getIntegrator().setVelocitiesToTemperature(300.0, 1)
    else:
        context.setVelocities(velocities)
    return context


def motion(context):
    """Return the bodies and their state R, P, q, m in double precision."""
    bodies, state = context.getIntegrator().fullState()
    return bodies, *(a[0] for a in state[:4])


def energies(context, per):
    """Return the kinetic energies of groups of so many particles."""
    bodies, _, P, _, m = motion(context)
    of_bodies = 0.5 * (P * P).sum(axis=0) / bodies.mass
    of_bodies[: m.shape[1]] += 0.5 * (m * m / bodies.inertia.T).sum(axis=0)
    of_particles = np.zeros(len(bodies.owner))
    of_particles[bodies.first_particle] = of_bodies
    return of_particles.reshape(-1, per).sum(axis=1)


@pytest.fixture(scope="module", params=["water", "XH2", "XH3", "XH4"])
def drifted(request):
    """Return the name of a cluster, positions, and a Context after 200 drifts with the energies before them.

    Of 8 fs, in which hydrogens turn by up to half a radian, with the same masses in every step.
    """
    system, x = free(request.param)
    context = in_motion(system, x, maker("V2", 0.008), "native")
    start = energies(context, len(CLUSTERS[request.param][0]))
    context.getIntegrator().step(200)
    return request.param, x, context, start


def test_the_energy_walks_with_a_fraction_of_a_rounding_of_float(drifted):
    name, _, context, start = drifted
    fraction = 0.1 if name == "water" else 0.01
    change = energies(context, len(CLUSTERS[name][0])) / start - 1.0
    assert 0.0 < np.sqrt((change**2).mean()) < fraction * EPS * 200**0.5
    assert abs(change.mean()) < 4.0 * change.std() / COPIES**0.5


def test_bodies_of_every_kind_turn_as_on_the_host():
    """By a rounding of float, while the lengths of momenta and quaternions have roundings of double."""
    system, x, named = every_kind()
    while system.getNumForces():
        system.removeForce(0)
    make = maker("V2", 0.02, bodies=named)
    ours, theirs = (in_motion(system, x, make, engine) for engine in ("native", "host"))
    starts, ends = [], []
    for context in (ours, theirs):
        starts.append(motion(context)[1:])
        context.getIntegrator().step(1)
        ends.append(motion(context)[1:])
    (R, _, q, m), (R0, P0, q0, m0), (R1, P1, q1, m1) = starts[0], ends[1], ends[0]
    for one, other in zip(*starts, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)
    length = np.linalg.norm(m, axis=0)
    assert np.abs(q0 - q).max() > 0.05  # bodies have turned
    assert np.abs(R1 - R0).max() < EPS * np.abs(R0 - R).max()
    assert (np.abs(m1 - m0).max(axis=0) / length).max() < 8.0 * EPS
    assert np.abs(q1 - q0).max() < 8.0 * EPS
    np.testing.assert_allclose(P1, P0, rtol=0.0, atol=1e-12)
    assert np.abs(np.linalg.norm(m1, axis=0) / length - 1.0).max() < 8.0 * ROUNDOFF
    assert np.abs(np.linalg.norm(q1, axis=0) - 1.0).max() < 4.0 * ROUNDOFF


def test_shapes_are_exact(drifted):
    """To the roundoff of coordinates, also after many steps, and velocities do not stretch constraints."""
    name, x, context, _ = drifted
    _, pairs, _ = CLUSTERS[name]
    per = len(CLUSTERS[name][0])
    places, velocities = (a.reshape(COPIES, per, 3) for a in held(context))
    i, j = np.array(pairs).T
    r, v = places[:, i] - places[:, j], velocities[:, i] - velocities[:, j]
    start = x.reshape(COPIES, per, 3)
    lengths = np.linalg.norm(start[:, i] - start[:, j], axis=2)
    assert np.abs(np.linalg.norm(r, axis=2) - lengths).max() < 1e-13
    assert np.abs((r * v).sum(axis=2) / lengths).max() < 1e-8
    assert np.abs(places - start).max() > 0.1


@PRECISIONS
def test_noise_is_that_of_the_host_to_a_rounding(precision):
    system, x = free("water")
    make = maker("BAOA", 0.002, friction=20.0)
    ours, theirs = (in_motion(system, x, make, engine, p) for engine, p in (("native", precision), ("host", "double")))
    for context in (ours, theirs):
        context.setVelocities(np.zeros_like(x))
        context.getIntegrator().step(1)
    (_, _, P1, _, m1), (_, _, P0, _, m0) = motion(ours), motion(theirs)
    for one, other in ((P1, P0), (m1, m0)):
        scale = np.sqrt((other**2).mean())
        assert scale > 0.0
        assert np.abs(one - other).max() < 1e-5 * scale
        assert np.sqrt(((one - other) ** 2).mean()) < 4.0 * EPS * scale


def test_steps_with_reversed_velocities_return_within_roundings():
    system, x, named = every_kind()
    context = in_motion(system, x, maker("S2_2", 0.002, bodies=named), "native")
    before = held(context)[0]
    context.getIntegrator().step(10)
    there, velocities = held(context)
    assert np.abs(there - before).max() > 1e-3
    context.setVelocities(-velocities)
    context.getIntegrator().step(10)
    assert np.abs(held(context)[0] - before).max() < 1e-4 * np.abs(there - before).max()
