"""A Topology made from a System: its elements, its box, and what ``exactrb info`` says about the box."""

import itertools

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.command.main import main
from openmm_exactrb.command.topology import elements_of, topology_of
from peptides import in_water
from starts import context_of, simulation_of, system_of


@pytest.mark.parametrize("mass", [None, 1.5, 3.0])
@pytest.mark.parametrize("constraints", ["None", "HBonds", "AllBonds"])
def test_elements_are_those_of_the_atoms_also_with_heavy_hydrogens(constraints, mass):
    topology, system, _ = in_water(constraints)
    if mass is not None:
        rb.heavy_hydrogens(system, topology, mass)
    assert elements_of(system) == [atom.element for atom in topology.atoms()]


@pytest.mark.parametrize("model", ["spce", "tip4pew", "tip5p"])
def test_water_with_heavy_hydrogens_is_water(model):
    own, system, positions = rb.rigid_water(8, model=model)
    rb.heavy_hydrogens(system, own, 3.0)
    state = context_of(system, openmm.VerletIntegrator(0.001), positions).getState(positions=True)
    residues = [*topology_of(system, state).residues()]
    assert [residue.name for residue in residues] == ["HOH"] * 8
    expected = [atom.element for atom in next(own.residues()).atoms()]
    assert [atom.element for atom in residues[3].atoms()] == expected


@pytest.mark.parametrize("light", [1.008, 1.5, 2.0, 2.014, 3.0, 4.0])
@pytest.mark.parametrize(("heavy", "number"), [("C", 1), ("C", 2), ("C", 3), ("C", 4), ("N", 2), ("N", 4), ("O", 2)])
@pytest.mark.parametrize("joined", [False, True], ids=["bonds", "all distances"])
def test_groups_of_hydrogens_or_deuterium_beside_a_carbon(heavy, number, light, joined):
    """With 4 amu, the carbon of a methyl group is lighter than its hydrogens."""
    deuterated = light == 2.014
    own = app.Element.getBySymbol(heavy).mass._value - (0.0 if deuterated else number * (light - 1.008))
    if own <= 0.0:
        pytest.skip("no mass is left")
    system = system_of([12.011, own, *[light] * number])
    pairs = [(0, 1), *((1, 2 + i) for i in range(number))]
    if joined:
        pairs += itertools.combinations(range(2, 2 + number), 2)
    for pair in pairs:
        system.addConstraint(*pair, 0.1)
    expected = ["C", heavy, *["D" if deuterated else "H"] * number]
    assert [element.symbol for element in elements_of(system)] == expected


def test_united_atoms_and_beads_have_no_element():
    assert elements_of(system_of([0.01, 0.3, 1.0, 13.019, 14.027, 15.035, 16.043, 36.0, 54.0, 72.0])) == [
        None,
        None,
        app.element.hydrogen,
        *[None] * 7,
    ]


def test_masses_of_no_element_and_of_deuterium_stay_as_they_are():
    system = system_of([72.0, 15.999, 2.014, 2.014, 22.99, 0.0])
    for hydrogen in (2, 3):
        system.addConstraint(1, hydrogen, 0.1)
    symbols = [element and element.symbol for element in elements_of(system)]
    assert symbols == [None, "O", "D", "D", "Na", None]


def test_the_box_is_that_of_the_state(tmp_path, capsys):
    """After a run at constant pressure, the box of a State differs from that of its System."""
    topology, system, positions = rb.rigid_water(27, nonbondedMethod=app.PME, nonbondedCutoff=0.4)
    simulation = simulation_of(topology, system, openmm.VerletIntegrator(0.001), positions)
    width = 1.2 * system.getDefaultPeriodicBoxVectors()[0][0]._value
    simulation.context.setPeriodicBoxVectors(*np.diag([width] * 3))
    split = np.arange(81) % 3 == 1
    simulation.context.setPositions(positions._value + np.outer(split, [width, 0.0, 0.0]))  # wrapped atom by atom
    (tmp_path / "system.xml").write_text(openmm.XmlSerializer.serialize(system))
    simulation.saveState(str(tmp_path / "state.xml"))
    assert main(["info", str(tmp_path / "system.xml"), str(tmp_path / "state.xml")]) == 0
    said = capsys.readouterr().out
    assert f"periodic box, {width:.4g} x {width:.4g} x {width:.4g} nm\n" in said
    assert "everything is supported" in said


def test_the_angles_of_a_triclinic_box_are_said(tmp_path, capsys):
    topology, _, positions = rb.rigid_water(27)
    vectors = np.array([[1.2, 0.0, 0.0], [0.3, 1.1, 0.0], [-0.2, 0.4, 1.3]])
    topology.setPeriodicBoxVectors(vectors * unit.nanometer)
    with (tmp_path / "box.pdb").open("w") as file:
        app.PDBFile.writeFile(topology, positions, file)
    assert main(["info", str(tmp_path / "box.pdb"), "--forcefield", "tip3p.xml", "--cutoff", "0.4"]) == 0
    lengths = np.linalg.norm(vectors, axis=1)
    cosines = [vectors[i] @ vectors[j] / (lengths[i] * lengths[j]) for i, j in ((1, 2), (0, 2), (0, 1))]
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("periodic box"))
    numbers = np.array(line.replace("x", " ").replace(",", " ").split())[[2, 3, 4, 7, 8, 9]].astype(float)
    np.testing.assert_allclose(numbers[:3], lengths, atol=2e-3)
    np.testing.assert_allclose(numbers[3:], np.degrees(np.arccos(cosines)), atol=0.05)
