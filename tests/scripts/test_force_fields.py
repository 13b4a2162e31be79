"""Every force field of rigid water that OpenMM ships: one line of the script changes."""

import openmm
import pytest
from boxes import FEMTOSECONDS, coordinates, misfit, quietly, simulation_of, solvent, swing, water_system
from openmm import app

import openmm_exactrb as rb

# Of every number of sites and every kind of file; then those that have other numbers in them alone.
FIRST = ["tip3p", "opc3", "tip4pew", "opc", "tip5p", "charmm36/water", "charmm36/tip4p2005", "charmm36/tip5p"]
OTHERS = ["tip3pfb", "spce", "tip4pfb"]
OTHERS += [f"charmm36/{name}" for name in ("tip3p-pme-b", "tip3p-pme-f", "spce", "tip4pew", "tip5pew")]


@pytest.mark.parametrize("name", [*FIRST, *(pytest.param(name, marks=pytest.mark.validate) for name in OTHERS)])
def test_one_line_changes(name):
    modeller = app.Modeller(*solvent())
    modeller.addExtraParticles(app.ForceField(f"{name}.xml"))
    system = water_system(modeller.topology, f"{name}.xml")
    simulation = simulation_of(
        modeller.topology, system, modeller.positions, rb.ExactRigidBodyIntegrator(2 * FEMTOSECONDS)
    )
    start = coordinates(simulation)
    ours = quietly(swing, simulation)
    verlet = openmm.VerletIntegrator(2 * FEMTOSECONDS)
    verlet = simulation_of(modeller.topology, system, start, verlet, minimise=0)
    assert ours < 0.5 * swing(verlet)
    assert misfit(simulation) < 1e-6
