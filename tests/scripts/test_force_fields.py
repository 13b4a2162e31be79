"""Every force field of rigid water that OpenMM ships: one line of the script changes."""

import openmm
import pytest
from boxes import FEMTOSECONDS, coordinates, misfit, quietly, simulation_of, solvent, swing, water_system
from openmm import app

import openmm_exactrb as rb

AMBER = ["tip3p", "tip3pfb", "spce", "tip4pew", "tip4pfb", "tip5p", "opc", "opc3"]
CHARMM = ["water", "tip3p-pme-b", "tip3p-pme-f", "spce", "tip4pew", "tip4p2005", "tip5p", "tip5pew"]


@pytest.mark.parametrize("name", [*(f"{n}.xml" for n in AMBER), *(f"charmm36/{n}.xml" for n in CHARMM)])
def test_one_line_changes(name):
    modeller = app.Modeller(*solvent())
    modeller.addExtraParticles(app.ForceField(name))
    system = water_system(modeller.topology, name)
    simulation = simulation_of(
        modeller.topology, system, modeller.positions, rb.ExactRigidBodyIntegrator(2 * FEMTOSECONDS)
    )
    start = coordinates(simulation)
    ours = quietly(swing, simulation)
    verlet = openmm.VerletIntegrator(2 * FEMTOSECONDS)
    verlet = simulation_of(modeller.topology, system, start, verlet, minimise=0)
    assert ours < 0.5 * swing(verlet)
    assert misfit(simulation) < 1e-6
