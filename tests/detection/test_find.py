"""Which particles of a System are a rigid body, and what cannot be one."""

import numpy as np
import pytest

import openmm_exactrb as rb
from openmm_exactrb.detection.find import find_bodies
from starts import apart, context_of, positions_of, system_of


def test_a_cluster_that_is_not_rigid_is_one_of_single_particles():
    system = system_of(4 * [1.0], [(i, i + 1, 0.1) for i in range(3)])
    bodies = find_bodies(system, np.random.default_rng(1).random((4, 3)))
    assert (len(bodies), bodies.n_turning, len(bodies.clusters)) == (4, 0, 1)
    assert bodies.translational_freedom == 12 - 3


def test_particles_alone_are_bodies_that_do_not_turn():
    bodies = find_bodies(system_of(3 * [2.0]), np.zeros((3, 3)))
    assert (len(bodies), bodies.n_turning) == (3, 0)


def test_bodies_of_the_dipole_fluid_are_one_kind():
    _, system, positions = rb.dipole_fluid(8)
    bodies = find_bodies(system, positions._value)
    assert len(bodies.kinds) == 1
    np.testing.assert_allclose(bodies.kinds[0].inertia[0], [1.0, 1.88, 2.88], rtol=1e-13)


def rings(n=4):
    """Return a System of rings of six particles without constraints, and positions."""
    particle = np.arange(6 * n)
    angle = np.pi / 3 * (particle % 6)
    x = np.column_stack([0.14 * np.cos(angle), 0.14 * np.sin(angle), 0.42 * (particle // 6)])
    return system_of(6 * n * [13.0]), x


OCTAHEDRON = 0.2 / np.sqrt(2.0) * np.concatenate([np.eye(3), -np.eye(3)])
EDGES = [(i, j) for i in range(6) for j in range(i) if i - j != 3]


def octahedron(scale, integrator):
    """Return a Context of six particles, whose twelve edges of 0.2 nm are constrained: rigid, but not all distances."""
    return context_of(system_of(6 * [10.0], [(*edge, 0.2) for edge in EDGES]), integrator, scale * OCTAHEDRON)


def edges(context):
    return apart(positions_of(context))[tuple(np.transpose(EDGES))]


def test_constraints_that_do_not_name_every_pair_give_the_shape():
    integrator = rb.ExactRigidBodyIntegrator(0.001, scheme="V2")
    context = octahedron(1.1, integrator)
    with pytest.warns(rb.ShapeWarning, match="were corrected"):
        integrator.step(2)
    np.testing.assert_allclose(edges(context), 0.2, rtol=0.0, atol=1e-14)
    context.setPositions(OCTAHEDRON)  # those of the constraints: nothing is warned of
    integrator.step(2)
    np.testing.assert_allclose(edges(context), 0.2, rtol=0.0, atol=1e-14)


def test_positions_far_from_constraints_that_do_not_name_every_pair_are_refused():
    integrator = rb.ExactRigidBodyIntegrator(0.001, scheme="V2")
    context = octahedron(1.5, integrator)
    with pytest.raises(
        ValueError,
        match=r"by .* nm, more than 0\.06 nm, because bonds are stretched or bent: call context",
    ):
        integrator.step(2)
    assert context.getStepCount() == 0


@pytest.mark.parametrize("digits", [7, 9, 17])
def test_redundant_constraints_may_be_rounded(digits):
    """A distorted cube held by 24 of its 28 distances, four of which follow from the others but for rounding."""
    x = 0.2 * np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)
    x += 0.01 * np.random.default_rng(3).normal(size=x.shape)
    held = [(i, j, round(float(apart(x)[i, j]), digits)) for i in range(8) for j in range(i) if i + j != 7]
    bodies = find_bodies(system_of(8 * [12.0], held), x)
    assert (len(bodies), bodies.n_turning) == (1, 1)
    np.testing.assert_allclose(apart(bodies.kinds[0].sites[0]), apart(x), rtol=0.0, atol=10.0**-digits + 1e-13)
