"""Whole scripts from the files of other programs to a trajectory."""

import mdtraj
import numpy as np
import program_files
import pytest
from boxes import CUTOFF, FEMTOSECONDS, coordinates, misfit, quietly, simulation_of, smooth, solvent, swing
from openmm import app, unit

import openmm_exactrb as rb

SETTINGS = {
    "nonbondedMethod": app.PME,
    "nonbondedCutoff": CUTOFF,
    "ewaldErrorTolerance": 1e-4,
    "removeCMMotion": False,
}


def a_script_ends_well(topology, system, positions, folder):
    """Run as a script does, and look at what it leaves."""
    simulation = simulation_of(
        topology, smooth(system), positions, rb.ExactRigidBodyIntegrator(2 * FEMTOSECONDS, "SRKN4_6b")
    )
    simulation.reporters.append(app.DCDReporter(str(folder / "run.dcd"), 5, enforcePeriodicBox=False))
    simulation.reporters.append(
        app.StateDataReporter(str(folder / "log.csv"), 5, step=True, totalEnergy=True, temperature=True)
    )
    with (folder / "start.pdb").open("w") as file:
        app.PDBFile.writeFile(topology, positions, file)
    assert quietly(swing, simulation) < 1e-3
    simulation.reporters.clear()
    frames = mdtraj.load(str(folder / "run.dcd"), top=str(folder / "start.pdb"))
    np.testing.assert_allclose(frames.xyz[-1], coordinates(simulation), atol=1e-5)
    log = np.loadtxt(folder / "log.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(log[:, 0], [5, 10])
    assert misfit(simulation) < 1e-6
    masses = [simulation.system.getParticleMass(i)._value for i in range(simulation.system.getNumParticles())]
    freedom = 3 * np.count_nonzero(masses) - system.getNumConstraints()
    assert sum(simulation.integrator.degreesOfFreedom()) == freedom


@pytest.mark.parametrize(("kind", "suffix"), [(app.PDBFile, "pdb"), (app.PDBxFile, "cif")])
def test_pdb_and_pdbx(kind, suffix, tmp_path):
    file = tmp_path / f"box.{suffix}"
    with file.open("w") as out:
        kind.writeFile(*solvent(), out)
    read = kind(str(file))
    system = app.ForceField("amber14/tip3p.xml").createSystem(read.topology, **SETTINGS)
    a_script_ends_well(read.topology, system, read.positions, tmp_path)


def boxed():
    """Return positions of a box, and its side, in angstrom."""
    topology, positions = solvent()
    return np.array(positions.value_in_unit(unit.angstrom)), topology.getUnitCellDimensions()[0].value_in_unit(
        unit.angstrom
    )


def test_charmm(tmp_path):
    x, side = boxed()
    psf, crd, *parameters = map(str, program_files.charmm(tmp_path, x))
    psf, crd = app.CharmmPsfFile(psf), app.CharmmCrdFile(crd)
    psf.setBox(*[side * unit.angstrom] * 3)
    system = psf.createSystem(app.CharmmParameterSet(*parameters), **SETTINGS)
    a_script_ends_well(psf.topology, system, crd.positions, tmp_path)
