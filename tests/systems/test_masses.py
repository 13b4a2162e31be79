"""heavy_hydrogens: mass moves within molecules and nothing else changes."""

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
from peptides import in_water, peptide
from starts import context_of, masses_of


def masses(system):
    return masses_of(system)


def hydrogens(topology):
    return np.array([atom.element is app.element.hydrogen for atom in topology.atoms()])


def of_water(topology):
    return np.array([atom.residue.name == "HOH" for atom in topology.atoms()])


def by_molecule(topology, values):
    return [sum(values[atom.index] for atom in residue.atoms()) for residue in topology.residues()]


@pytest.mark.parametrize("water", [True, False])
def test_hydrogens_have_the_mass_and_molecules_keep_theirs(water):
    topology, system, _ = in_water()
    before, changed = masses(system), hydrogens(topology) & (water | ~of_water(topology))
    rb.heavy_hydrogens(system, topology, 3 * unit.dalton, water=water)
    assert (masses(system)[changed] == 3.0).all()
    same = hydrogens(topology) & ~changed
    assert (masses(system)[same] == before[same]).all()
    np.testing.assert_allclose(by_molecule(topology, masses(system)), by_molecule(topology, before), rtol=1e-14)


def test_it_does_to_a_solute_what_openmm_does():
    topology, plain, _ = peptide()
    _, theirs, _ = peptide(hydrogenMass=3 * unit.dalton)
    rb.heavy_hydrogens(plain, topology, 3.0)
    np.testing.assert_allclose(masses(plain), masses(theirs), rtol=1e-14)


def test_energies_forces_and_constraints_stay_and_the_mass_moves_back():
    topology, system, _ = peptide()
    before = openmm.XmlSerializer.serialize(system)
    rb.heavy_hydrogens(system, topology, 3.0)
    light = masses(openmm.XmlSerializer.deserialize(before))
    for i, mass in enumerate(light):
        system.setParticleMass(i, mass)
    assert openmm.XmlSerializer.serialize(system) == before  # the masses are all that was changed
    rb.heavy_hydrogens(system, topology, 3.0)
    rb.heavy_hydrogens(system, topology, 3.0)  # twice is once
    rb.heavy_hydrogens(system, topology, light[hydrogens(topology)][0])
    np.testing.assert_allclose(masses(system), light, rtol=1e-14)


def test_virtual_sites_of_water_stay_without_mass_and_the_body_turns_more_slowly():
    topology, system, positions = rb.rigid_water(1, model="tip4pew")
    moments = []
    for mass in (None, 3.0):
        if mass is not None:
            rb.heavy_hydrogens(system, topology, mass)
        context = context_of(system, rb.ExactRigidBodyIntegrator(0.001), positions)
        bodies, _ = context.getIntegrator().bodyState()
        moments.append(np.sort(bodies.principal_moments[:, 0]))
    assert masses(system)[3] == 0.0
    assert moments[1] / moments[0] == pytest.approx([2.30, 2.98, 2.70], abs=0.2)


def test_what_cannot_be_is_refused_and_changes_nothing():
    topology, system, _ = peptide()
    before = masses(system)
    with pytest.raises(ValueError, match=r"atom 0 \(CH3 of ACE 1\) would be left with 3.034 amu, less than the"):
        rb.heavy_hydrogens(system, topology, 4.0)
    bare = app.Topology()
    residue = bare.addResidue("ACE", bare.addChain())
    for atom in topology.atoms():
        bare.addAtom(atom.name, atom.element, residue)
    with pytest.raises(ValueError, match="has no bond in the Topology to a heavier atom"):
        rb.heavy_hydrogens(system, bare)
    frozen = openmm.XmlSerializer.clone(system)
    frozen.setParticleMass(0, 0.0)
    with pytest.raises(
        ValueError, match=r"has a mass, but the bonded atom 0 .* has none: set both masses to zero, or neither"
    ):
        rb.heavy_hydrogens(frozen, topology)
    for arguments, message in (
        (
            (system, rb.rigid_water(2)[0]),
            "and of particles in the System \\(22\\) differ: pass the Topology of this System",
        ),
        ((topology, system), "takes an openmm.System and its Topology"),
        ((system, topology, -1.0), "mass must be a positive number of amu"),
        ((system, topology, 3 * unit.nanometer), "mass must be"),
        ((system, topology, 3.0, 1), "water must be True or False"),
    ):
        with pytest.raises(ValueError, match=message):
            rb.heavy_hydrogens(*arguments)
    assert (masses(system) == before).all()


def test_a_context_that_is_reinitialized_has_the_new_masses():
    topology, system, positions = peptide()
    integrator = rb.ExactRigidBodyIntegrator(0.001)
    context = context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(300.0, 1)
    integrator.step(1)
    rb.heavy_hydrogens(system, topology, 3.0)
    context.reinitialize(preserveState=True)
    integrator.step(1)
    state = context.getState(velocities=True, energy=True)
    v = state.getVelocities(asNumpy=True)._value
    assert state.getKineticEnergy()._value == pytest.approx(0.5 * masses(system) @ (v * v).sum(axis=1), rel=1e-6)
    assert integrator.bodyState()[0].mass.sum() == pytest.approx(masses(system).sum(), rel=1e-12)


def test_deuterium_makes_water_too():
    topology, system = app.Topology(), openmm.System()
    residue = topology.addResidue("HOD", topology.addChain())
    oxygen, *others = (topology.addAtom(name, app.element.get_by_symbol(name), residue) for name in ("O", "H", "D"))
    for atom in others:
        topology.addBond(oxygen, atom)
    for mass in (15.999, 1.008, 2.014):
        system.addParticle(mass)
    rb.heavy_hydrogens(system, topology, 3.0, water=False)
    assert masses(system).tolist() == [15.999, 1.008, 2.014]
