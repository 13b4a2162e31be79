"""A lipid and a protein of OpenMM's CHARMM force field in kernels: all of its bonded forces have kernels."""

import io
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
from both_engines import apart, nested, pair
from openmm_exactrb.detection.find import find_bodies
from openmm_exactrb.multiple_time_steps.excerpt import bonded_excerpt
from openmm_exactrb.multiple_time_steps.excerpt_forces import by_library, terms_of
from starts import context_of, positions_of

pytestmark = [pytest.mark.library, pytest.mark.opencl]
DATA = Path(app.__file__).parent / "data"


def lipid():
    """Return the first POPC of the patch of Modeller.addMembrane."""
    lines = (DATA / "POPC.pdb").read_text(encoding="utf-8").splitlines(keepends=True)
    atoms = [line for line in lines if line.startswith("HETATM")][:134]
    serials = {line[6:11] for line in atoms}
    return atoms + [line for line in lines if line.startswith("CONECT") and line[6:11] in serials]


def villin():
    """Return a protein, which has maps of two torsions."""
    lines = (DATA / "test.pdb").read_text(encoding="utf-8").splitlines(keepends=True)
    return [line for line in lines if line.startswith("ATOM") and line[17:20].strip() not in {"HOH", "Cl"}]


@pytest.fixture(scope="module")
def field():
    return app.ForceField("charmm36.xml")


@pytest.fixture(scope="module", params=[lipid, pytest.param(villin, marks=pytest.mark.validate)])
def molecule(request, field):
    """Return a System with bonded forces in group 1, and positions."""
    pdb = app.PDBFile(io.StringIO("".join(request.param())))
    system = field.createSystem(pdb.topology, constraints=app.HBonds, removeCMMotion=False)
    assert rb.separate_bonded(system) == 1
    context = context_of(system, openmm.VerletIntegrator(0.001), pdb.positions)
    context.applyConstraints(1e-13)  # what is left would be in the velocities of one of the engines
    return system, positions_of(context), context.getState(forces=True, groups={1}).getForces(asNumpy=True)._value


def test_bonded_forces_are_openmms(molecule):
    system, x, theirs = molecule
    excerpt = bonded_excerpt(system, find_bodies(system, x), {1})
    terms, ours = terms_of(excerpt.forces, -1), np.zeros_like(x)
    assert len(terms.impropers)
    by_library(terms)(x, ours)
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-11 * np.abs(theirs).max())


def test_steps_are_those_of_the_host(molecule):
    system, x, _ = molecule
    make = nested("S2_2", 0.002)
    contexts = pair(system, x, make)
    for context in contexts:
        context.getIntegrator().step(3)
    assert contexts[1].getIntegrator().getEngine() == "native"
    assert apart(*contexts) < 1e-12
