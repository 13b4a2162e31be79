"""engine="auto" takes the kernels on Reference and CPU for what users simulate, and says so."""

import copy
from functools import cache, partial
from pathlib import Path

import numpy as np
import openmm
import pytest
from openmm import app

import openmm_exactrb as rb
import peptides
from products import spread_over
from small_molecules import MOLECULES, placed, system_of
from starts import context_of, positions_of
from zoo import every_kind

CPU = openmm.Platform.getPlatform("CPU")
VILLIN = Path(app.__file__).parent / "data" / "test.pdb"
NOTE = "kernels of the library perform the steps on the platform {}"
pytestmark = pytest.mark.library


# -- Systems: functions that return a System, positions, and arguments of the integrator -----------------------------


def water(*forces, model="tip3p"):
    _, system, positions = rb.rigid_water(64, model=model, nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=0.55)
    for force in forces:
        system.addForce(force())
    return system, positions, {}


@cache
def in_box():
    topology, system, positions = peptides.in_box()
    context = context_of(system, openmm.VerletIntegrator(0.001), positions, platform=CPU)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0, 100)
    return topology, system, positions_of(context)


def peptide(heavy=False):
    topology, system, positions = in_box()
    system = copy.deepcopy(system)
    if heavy:
        rb.heavy_hydrogens(system, topology)
    return system, positions, {}


@cache
def villin():
    """Return a protein in vacuum with constraints of all bonds, which are one cluster."""
    pdb = app.PDBFile(str(VILLIN))
    model = app.Modeller(pdb.topology, pdb.positions)
    model.delete([residue for residue in model.topology.residues() if len(list(residue.atoms())) < 4])
    system = peptides.FORCE_FIELD.createSystem(model.topology, constraints=app.AllBonds)
    context = context_of(system, openmm.VerletIntegrator(0.001), model.positions)
    context.applyConstraints(1e-9)
    return system, positions_of(context), {}


def named():
    system, positions, bodies = every_kind()
    return system, positions, {"bodies": bodies}


def linear():
    positions, edge = placed(MOLECULES["CO2"], 64)
    return system_of(MOLECULES["CO2"], 64, edge), positions, {}


def dipoles():
    _, system, positions = rb.dipole_fluid(64, density=0.4, boundary=rb.ReactionField(cutoff=1.5))
    return system, positions, {}


NVE = rb.ExactRigidBodyIntegrator
LANGEVIN = partial(rb.ExactRigidBodyLangevinIntegrator, 300.0, 5.0)
BAROSTAT = partial(openmm.MonteCarloBarostat, 1.0, 300.0, 2)
ROWS = {
    "water": (water, partial(NVE, 0.002)),
    "water, BAOA": (water, partial(LANGEVIN, 0.002)),
    "water, S6_10": (water, partial(NVE, forceInterval=0.0005, scheme="S6_10")),
    "water, Nosé-Hoover chains": (water, partial(rb.ExactRigidBodyNoseHooverIntegrator, 300.0, 20.0, 0.002)),
    "water, rescaling": (water, partial(rb.ExactRigidBodyRescalingIntegrator, 300.0, 0.5, 0.002)),
    "water, barostat": (partial(water, BAROSTAT), partial(LANGEVIN, 0.002)),
    "virtual sites": (partial(water, model="tip4pew"), partial(NVE, 0.002)),
    "peptide, W4_4": (peptide, partial(NVE, forceInterval=0.002, scheme="W4_4")),
    "peptide, 8 fs": (partial(peptide, True), partial(LANGEVIN, forceInterval=0.008, scheme="W2_3m")),
    "protein, AllBonds": (villin, partial(NVE, 0.002)),
    "named bodies": (named, partial(NVE, 0.001)),
    "linear molecules": (linear, partial(NVE, 0.002)),
    "dipoles": (dipoles, partial(NVE, 0.005, "W4_4")),
}


@spread_over({"row": ROWS, "platform": ["Reference", "CPU"]})
def test_auto_takes_the_kernels(row, platform):
    start, make = ROWS[row]
    system, positions, options = start()
    integrator = make(**options)
    context = context_of(system, integrator, positions, platform=openmm.Platform.getPlatform(platform))
    context.computeVirtualSites()
    integrator.setVelocitiesToTemperature(100.0, 1)
    before = positions_of(context)
    integrator.step(2)
    assert integrator.getEngine() == "native"
    assert integrator.engineNote().startswith(NOTE.format(platform) + "; a step is ")
    moved = np.linalg.norm(positions_of(context) - before, axis=1)
    assert np.median(moved) > 1e-5
    assert moved.max() < 0.2


def test_what_the_kernels_do_not_serve_is_refused_with_a_sentence():
    with pytest.raises(ValueError, match="the native engine supports only the exact rotor, not mclachlan_reich"):
        NVE(0.001, rotor="mclachlan_reich", engine="native")
    with pytest.raises(ValueError, match="the native engine does not support HybridMonteCarlo"):
        rb.ExactRigidBodyHybridIntegrator(300.0, 1.0, 0.001, engine="native")
