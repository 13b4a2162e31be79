"""The test systems of openmmtools keep their energy at least as well as with OpenMM's VerletIntegrator."""

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb

pytestmark = pytest.mark.validate
testsystems = pytest.importorskip("openmmtools.testsystems", reason="pip install 'openmm-exactrb[validation]'")

NAMES = [
    *("AlanineDipeptideExplicit", "AlanineDipeptideImplicit", "AlanineDipeptideVacuum", "AlchemicalAlanineDipeptide"),
    *("ConstrainedDiatomicFluid", "ConstrainedDipolarFluid", "ConstraintCoupledHarmonicOscillator", "Diatom"),
    *("DiatomicFluid", "DipolarFluid", "CustomGBForceSystem", "CustomLennardJonesFluidMixture", "DNADodecamerExplicit"),
    *(
        "DoubleWellDimer_WCAFluid",
        "FourSiteWaterBox",
        "HarmonicOscillatorArray",
        "HostGuestImplicit",
        "HostGuestVacuum",
    ),
    *("LennardJonesFluid", "MethanolBox", "MolecularIdealGas", "TolueneImplicit", "TolueneVacuum", "WaterCluster"),
]


def context_of(system, integrator, start=None):
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"), {"Threads": "1"})
    if start is not None:
        context.setPeriodicBoxVectors(*start.getPeriodicBoxVectors())
        context.setPositions(start.getPositions())
        context.applyConstraints(1e-8)
        context.setVelocities(start.getVelocities())
        context.applyVelocityConstraints(1e-8)
    return context


def start_of(test):
    integrator = openmm.LangevinMiddleIntegrator(300.0, 5.0, 0.001)
    integrator.setRandomNumberSeed(1)
    context = context_of(test.system, integrator)
    context.setPositions(test.positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0, 100)
    context.setVelocitiesToTemperature(300.0, 1)
    integrator.step(100)
    return context.getState(positions=True, velocities=True)


def energies(system, integrator, start):
    context = context_of(system, integrator, start)
    found = []
    for _ in range(31):
        integrator.step(5)
        state = context.getState(energy=True)
        found.append((state.getPotentialEnergy() + state.getKineticEnergy())._value)
    return found[1:]


@pytest.mark.filterwarnings("ignore:Non-optimal GB parameters")  # of OpenMM, about the files of openmmtools
@pytest.mark.parametrize("name", NAMES)
def test_energy_is_conserved_as_with_verlet(name):
    test = getattr(testsystems, name)()
    start = start_of(test)
    theirs = energies(test.system, openmm.VerletIntegrator(0.001), start)
    ours = energies(test.system, rb.ExactRigidBodyIntegrator(0.001), start)
    resolution = 2e-7 * np.abs(theirs).max()  # of the single precision in which the CPU platform sums
    assert np.std(ours) < 1.1 * np.std(theirs) + resolution
