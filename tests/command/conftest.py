import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from starts import simulation_of


@pytest.fixture
def droplet(tmp_path):
    """Eight molecules of TIP3P in a PDB file."""
    topology, _, positions = rb.rigid_water(8)
    file = tmp_path / "droplet.pdb"
    with file.open("w") as out:
        app.PDBFile.writeFile(topology, positions, out)
    return file


@pytest.fixture
def serialised(tmp_path):
    """The same in motion, as the files of its System and State."""
    topology, system, positions = rb.rigid_water(8)
    simulation = simulation_of(topology, system, openmm.VerletIntegrator(0.001), positions)
    simulation.minimizeEnergy(maxIterations=50)
    simulation.context.setVelocitiesToTemperature(200 * unit.kelvin, 3)
    files = tmp_path / "system.xml", tmp_path / "state.xml"
    files[0].write_text(openmm.XmlSerializer.serialize(system))
    simulation.saveState(str(files[1]))
    return files
