"""The reporter of moments."""

import functools
import io

import numpy as np
import openmm
import pytest
from openmm import app, unit

import openmm_exactrb as rb
import starts
import three_masses
from canonical_dipoles import moments_in, simulation_of
from starts import positions_of


def test_the_moment_is_the_sum_of_the_dipoles():
    simulation, text = simulation_of(8, 0.1, 1.0, 2.0, step=0.01)
    simulation.step(30)
    x = positions_of(simulation.context).reshape(8, -1, 3)
    total = 2.0 * 2.0**0.5 * (x[:, -1] - x[:, -2]).sum(axis=0)
    np.testing.assert_allclose(moments_in(text)[-1], total, rtol=0.0, atol=1e-13)
    assert len(moments_in(text)) == 3


def test_a_new_file_gets_the_names_of_its_columns_also_when_appended_to(tmp_path):
    rb.MomentReporter(tmp_path / "moments.csv", 1, np.zeros(2), append=True).close()
    rb.MomentReporter(tmp_path / "moments.csv", 1, np.zeros(2), append=True).close()
    assert (tmp_path / "moments.csv").read_text(encoding="utf-8") == "step,time (ps),Mx,My,Mz\n"


water = functools.cache(rb.rigid_water)


def molecules_of_water(charges, model="spce"):
    """Return a Simulation of two molecules, and the text that moments of the charges go to."""
    topology, system, positions = water(2, model=model, nonbondedMethod=app.NoCutoff)
    simulation = starts.simulation_of(topology, system, rb.ExactRigidBodyIntegrator(0.001), positions)
    text = io.StringIO()
    simulation.reporters.append(rb.MomentReporter(text, 1, charges))
    return simulation, text


OF_WATER = np.tile([-0.8476, 0.4238, 0.4238], 2)
E = unit.elementary_charge


@pytest.mark.parametrize(
    "charges",
    [
        OF_WATER * E,
        [q * E for q in OF_WATER],
        OF_WATER * E.conversion_factor_to(unit.coulomb) * unit.coulomb,
        [q if q < 0.0 else q * E for q in OF_WATER],
    ],
)
def test_charges_may_have_a_unit(charges):
    simulation, text = molecules_of_water(charges)
    simulation.step(2)
    x = positions_of(simulation.context).reshape(-1, 3)
    np.testing.assert_allclose(moments_in(text)[-1], OF_WATER @ x, rtol=1e-12, atol=1e-14)


def test_charges_are_those_that_were_handed_over():
    charges = OF_WATER.copy()
    simulation, text = molecules_of_water(charges)
    charges[:] = 0.0
    simulation.step(1)
    x = positions_of(simulation.context).reshape(-1, 3)
    np.testing.assert_allclose(moments_in(text)[-1], OF_WATER @ x, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("charges", "message"),
    [
        ([0.0, np.nan, np.inf], "finite numbers.* particle 1 is nan"),
        (3.0, "charges must be a list .* not 3"),
        ([[1.0, -1.0]], "charges must be a list of numbers"),
        ([1.0, 1.0j], "charges must be a list of numbers"),
        (["1", "-1"], "charges must be a list of numbers"),
        ([1.0, -1.0] * unit.nanometer, "charges must be a list of numbers"),
        ([1.0 * E, -1.0 * unit.nanometer], "charges must be a list of numbers"),
    ],
)
def test_what_is_no_charges(tmp_path, charges, message):
    with pytest.raises(ValueError, match=message):
        rb.MomentReporter(tmp_path / "moments.csv", 1, charges)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("charges", "message"),
    [
        (OF_WATER[:3], "the length must be 6, not 3: use 0"),
        (np.tile(OF_WATER, 2), "the length must be 6, not 12"),
        (
            np.concatenate([OF_WATER[:3] + 0.1, OF_WATER[3:] - 0.1]),  # neutral as a whole, and an ion beside another
            "molecule with particle 0 add up to 0.3",
        ),
        (OF_WATER + 0.01 * np.eye(6)[4], "molecule with particle 3 add up to 0.01"),
    ],
)
def test_charges_that_do_not_fit_the_molecules_are_refused_before_a_line(charges, message):
    simulation, text = molecules_of_water(charges)
    with pytest.raises(ValueError, match=message):
        simulation.step(1)
    assert text.getvalue() == "step,time (ps),Mx,My,Mz\n"


def test_sites_without_mass_belong_to_their_molecule():
    simulation, text = molecules_of_water(np.tile([0.0, 0.52422, 0.52422, -1.04844], 2), model="tip4pew")
    simulation.step(1)
    assert len(moments_in(text)) == 1


@pytest.mark.parametrize("bodies", [[[0, 1, 2]], None])
def test_bodies_that_are_named_are_molecules(bodies):
    """Three masses without a bond are three ions, or one body."""
    system = three_masses.system()
    while system.getNumConstraints():
        system.removeConstraint(0)
    integrator = rb.ExactRigidBodyIntegrator(0.001, bodies=bodies)
    simulation = starts.simulation_of(starts.topology_of(system), system, integrator, three_masses.POSITIONS)
    text = io.StringIO()
    simulation.reporters.append(rb.MomentReporter(text, 1, [1.0, 1.0, -2.0]))
    if bodies is None:
        with pytest.raises(ValueError, match=r"add up to -2: .* of an ion"):
            simulation.step(1)
    else:
        simulation.step(1)
        assert len(moments_in(text)) == 1


@pytest.mark.parametrize("length", [0.1, 1.3])
def test_a_molecule_that_a_box_has_split_is_whole(length):
    """A chain of bonds; one that is longer than half the box is followed from atom to atom."""
    system, bonds, steps = openmm.System(), openmm.HarmonicBondForce(), 4
    x = np.zeros((steps + 1, 3))
    x[:, 0] = 1.5 + np.linspace(0.0, length, steps + 1)
    for _ in x:
        system.addParticle(12.0)
    for i in range(steps):
        bonds.addBond(i, i + 1, length / steps, 1000.0)
    bonds.setUsesPeriodicBoundaryConditions(True)
    system.addForce(bonds)
    system.setDefaultPeriodicBoxVectors(*np.diag([2.0] * 3))
    charges, found = [1.0, 0.0, 0.0, 0.0, -1.0], []
    for places in (x, x % 2.0):
        integrator = rb.ExactRigidBodyIntegrator(1e-6)
        simulation = starts.simulation_of(starts.topology_of(system), system, integrator, places)
        text = io.StringIO()
        simulation.reporters.append(rb.MomentReporter(text, 1, charges))
        simulation.step(1)
        found.append(moments_in(text)[-1])
    np.testing.assert_allclose(found, [[-length, 0.0, 0.0]] * 2, rtol=0.0, atol=1e-6)
