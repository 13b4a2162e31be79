"""Barostats move whole bodies with the box, by every engine."""

import copy

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from both_engines import begun, maker
from peptides import in_box, violations
from places import CPU
from starts import context_of as reference_of
from starts import held, periodic_water, positions_of, simulation_of
from zoo import water


@pytest.fixture(scope="module")
def box():
    """A System of 27 molecules of water, and positions."""
    return water()


def started(box, force, place, scheme="W2_1", remover=False):
    """Return a Context with steps so short that nothing but the barostat moves molecules."""
    engine, platform = place
    system, force = copy.deepcopy(box[0]), copy.deepcopy(force)
    force.setRandomNumberSeed(1)
    system.addForce(force)
    if remover:
        system.addForce(openmm.CMMotionRemover(1))
    return begun(system, box[1], maker(scheme, 1e-6)(engine), platform=platform)


def lengths(context):
    x = held(context)[0].reshape(-1, 3, 3)
    return np.array([np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in ((0, 1), (0, 2), (1, 2))])


def centres(context):
    """Return the centres of the molecules in units of the sides of the box, and its volume."""
    sides = np.diagonal(context.getState().getPeriodicBoxVectors(asNumpy=True)._value)
    return held(context)[0].reshape(-1, 3, 3).mean(axis=1) / sides, sides.prod()


@pytest.mark.parametrize(
    "barostat",
    [
        openmm.MonteCarloBarostat(1.0, 300.0, 3),
        openmm.MonteCarloAnisotropicBarostat(openmm.Vec3(1, 1, 1), 300.0, True, True, True, 3),
        openmm.MonteCarloMembraneBarostat(1.0, 0.0, 300.0, 0, 0, 3),
        openmm.MonteCarloFlexibleBarostat(1.0, 300.0, 3),
    ],
    ids=lambda force: type(force).__name__,
)
def test_a_barostat_moves_whole_bodies_with_the_box(box, barostat, place):
    """Centres keep their places in units of the sides, as OpenMM scales."""
    context = started(box, barostat, place)
    before, (was, volume) = lengths(context), centres(context)
    context.getIntegrator().step(14)
    now, other = centres(context)
    assert abs(other / volume - 1.0) > 1e-6
    np.testing.assert_allclose((now - was + 0.5) % 1.0, 0.5, rtol=0.0, atol=1e-4)  # thermal motion
    np.testing.assert_allclose(lengths(context), before, rtol=0.0, atol=1e-12)


def test_after_a_checkpoint_a_barostat_moves_bodies_where_its_own_count_says(box, place):
    """OpenMM's barostats begin to count again in a new Context, while the motion is removed after each step."""
    barostat = openmm.MonteCarloBarostat(1.0, 300.0, 4)
    one, other = (started(box, barostat, place, remover=True) for _ in range(2))
    one.getIntegrator().step(10)
    other.loadCheckpoint(one.createCheckpoint())
    was, volume = centres(other)
    other.getIntegrator().step(14)
    now, after = centres(other)
    assert abs(after / volume - 1.0) > 1e-6
    np.testing.assert_allclose((now - was + 0.5) % 1.0, 0.5, rtol=0.0, atol=1e-4)  # thermal motion


def test_a_barostat_does_not_tear_bodies_named_by_hand():
    """It scales the places of OpenMM's molecules, which only bonds and constraints make."""
    topology, system, positions = periodic_water(125, nonbondedMethod=app.CutoffPeriodic)
    while system.getNumConstraints():
        system.removeConstraint(0)
    barostat = openmm.MonteCarloBarostat(1e3 * unit.bar, 300.0 * unit.kelvin, 1)
    barostat.setRandomNumberSeed(1)
    system.addForce(barostat)
    named = [[3 * k, 3 * k + 1, 3 * k + 2] for k in range(125)]

    def fresh():  # not minimised: nothing would hold the molecules together
        integrator = rb.ExactRigidBodyIntegrator(1e-7, bodies=named)
        return simulation_of(topology, system, integrator, positions, platform=CPU)

    barostat.setScaleMoleculesAsRigid(False)
    with pytest.raises(ValueError, match=r"MonteCarloBarostat .*AsRigid\(True\)"):
        fresh().step(1)
    barostat.setScaleMoleculesAsRigid(True)
    with pytest.raises(ValueError, match=r"tear apart body 0 .* by bonds"):
        fresh().step(1)
    bonds = openmm.HarmonicBondForce()
    for oxygen, *hydrogens in named:
        for hydrogen in hydrogens:
            bonds.addBond(oxygen, hydrogen, 0.1, 0.0)
    system.addForce(bonds)
    simulation = fresh()
    edge = simulation.context.getState().getPeriodicBoxVectors()[0][0]
    simulation.step(10)
    assert simulation.context.getState().getPeriodicBoxVectors()[0][0] != edge


def test_a_barostat_moves_a_peptide_as_a_whole():
    """In steps so short that nothing else moves."""
    _, system, x = in_box()
    held_to = reference_of(system, openmm.VerletIntegrator(0.001), x)
    held_to.applyConstraints(1e-9)
    force = openmm.MonteCarloBarostat(1.0, 300.0, 1)
    force.setRandomNumberSeed(1)
    system.addForce(force)
    integrator = rb.ExactRigidBodyIntegrator(1e-6, "W2_1", fast="bonded", engine="native")
    context = begun(system, positions_of(held_to), integrator, precision="double")
    integrator.step(1)

    def seen():
        state = context.getState(positions=True)
        peptide = state.getPositions(asNumpy=True)._value[:22]
        return (
            np.linalg.norm(peptide[:, None] - peptide, axis=-1),
            peptide.mean(axis=0),
            state.getPeriodicBoxVolume()._value,
        )

    before, centre, volume = seen()
    for _ in range(40):
        integrator.step(1)
        now, there, other = seen()
        if other != volume:
            break
    assert abs(other / volume - 1.0) > 1e-6
    side = (other / volume) ** (1.0 / 3.0)
    np.testing.assert_allclose(now, before, rtol=0.0, atol=1e-4)  # thermal motion
    np.testing.assert_allclose(there, side * centre, rtol=0.0, atol=1e-4)
    assert violations(system, *held(context))[0] < 1e-13
