"""Molecules with frozen particles in the pressure."""

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from averages.test_virial import EDGE, KT, gas, pressure_of
from openmm_exactrb.averages.frames import BAR
from openmm_exactrb.averages.record import read
from places import REFERENCE
from starts import topology_of


@pytest.mark.parametrize("frozen", [(3,), (0, 5, 7), tuple(range(6)), tuple(range(11))])
def test_frozen_atoms_have_no_kinetic_pressure(frozen, tmp_path):
    free, held = (pressure_of(gas(frozen=kept), tmp_path / f"{len(kept)}.csv") for kept in ((), frozen))
    assert held - free == pytest.approx(-len(frozen) * KT * BAR / EDGE**3, rel=1e-6, abs=1e-6)


def test_a_molecule_with_a_frozen_atom_goes_where_that_atom_does(tmp_path):
    """The average over its other atom, by quadrature, is the derivative of the free energy by the volume.

    The box takes the frozen atoms along. The molecule has no kinetic pressure, since it cannot leave its frozen atom.
    """
    stiff, height, width = 40.0 * KT, 30.0 * KT, 0.4
    bond = openmm.HarmonicBondForce()
    bond.addBond(0, 1, 0.0, stiff)
    hill = openmm.CustomNonbondedForce(f"{height!r}*exp(-r^2/{2.0 * width**2!r})")
    hill.setNonbondedMethod(hill.CutoffPeriodic)
    hill.setCutoffDistance(1.5)
    hill.addExclusion(0, 1)
    hill.addExclusion(0, 2)
    system = openmm.System()
    for mass in (0.0, 20.0, 0.0):
        system.addParticle(mass)
        hill.addParticle([])
    system.addForce(bond)
    system.addForce(hill)
    system.setDefaultPeriodicBoxVectors(*(EDGE * np.eye(3)))
    x = np.array([[1.5, 1.5, 1.5], [0.0, 0.0, 0.0], [1.9, 1.5, 1.5]])
    nodes, weights = np.polynomial.hermite.hermgauss(9)
    off = np.stack(np.meshgrid(nodes, nodes, nodes), axis=-1).reshape(-1, 3) * np.sqrt(2.0 * KT / stiff)
    weights = np.einsum("i,j,k->ijk", weights, weights, weights).ravel()

    def boltzmann(scale):
        distance = np.linalg.norm(off + scale * (x[0] - x[2]), axis=1)
        return weights * np.exp(-height / KT * np.exp(-(distance**2) / (2.0 * width**2)))

    s = 1e-3
    exact = KT * np.log(boltzmann(1.0 + s).sum() / boltzmann(1.0 - s).sum()) / (2.0 * s) / (3.0 * EDGE**3)
    integrator = rb.ExactRigidBodyLangevinIntegrator(300.0, 5.0, 0.002)
    simulation = app.Simulation(topology_of(system), system, integrator, REFERENCE)
    simulation.context.setPositions(x)
    reporter = rb.AverageReporter(tmp_path / "averages.csv", 1, pressure=True)
    for place in off:
        x[1] = x[0] + place
        simulation.context.setPositions(x)
        reporter.report(simulation, simulation.context.getState(positions=True, energy=True, forces=True))
    reporter.close()
    pressure = read(tmp_path / "averages.csv")[1]["pressure"]
    mean = boltzmann(1.0) @ pressure / boltzmann(1.0).sum()
    assert mean == pytest.approx(BAR * exact, rel=1e-4)
    assert abs(mean) > 0.5


@pytest.mark.parametrize(("frequency", "frozen", "told"), [(25, (0, 5, 7), True), (25, (), False), (0, (3,), False)])
def test_a_line_says_that_a_barostat_counts_frozen_atoms(frequency, frozen, told, tmp_path, caplog):
    simulation = gas(openmm.MonteCarloBarostat(1.0, 300.0, frequency), frozen=frozen)
    pressure_of(simulation, tmp_path / "averages.csv")
    line = "MonteCarloBarostat also counts the molecules with frozen particles (number: 3), so its pressure is too high"
    assert (line in caplog.text) is told
