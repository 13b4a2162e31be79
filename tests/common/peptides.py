"""Alanine dipeptide in vacuum, as our integrators move it."""

from functools import cache
from pathlib import Path

import numpy as np
import openmm
from openmm import app, unit

import openmm_exactrb as rb
from openmm_exactrb.multiple_time_steps.bonded import interacting_exceptions
from places import platform_for
from starts import context_of, positions_of

PEPTIDE = Path(__file__).parents[2] / "examples" / "data" / "alanine_dipeptide.pdb"
FORCE_FIELD = app.ForceField("amber14-all.xml", "amber14/tip3p.xml")
CONSTRAINTS = {"HBonds": app.HBonds, "AllBonds": app.AllBonds, "HAngles": app.HAngles, "None": None}
R = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)


def peptide(constraints="HBonds", **options):
    """Return topology, System and positions (nm), on the constraints, of alanine dipeptide in vacuum."""
    pdb = app.PDBFile(str(PEPTIDE))
    system = FORCE_FIELD.createSystem(
        pdb.topology, constraints=CONSTRAINTS[constraints], removeCMMotion=False, **options
    )
    context = context_of(system, openmm.VerletIntegrator(0.001), pdb.positions)
    context.applyConstraints(1e-9)
    return pdb.topology, system, positions_of(context)


def bonded_apart(system):
    """Give bonded forces, and exceptions of NonbondedForces as pairs by a formula, a force group; return it."""
    for force in [force for force in system.getForces() if isinstance(force, openmm.NonbondedForce)]:
        pairs = interacting_exceptions(force)[0].made()
        if pairs.getNumBonds():
            for number in range(force.getNumExceptions()):
                i, j, _, sigma, _ = force.getExceptionParameters(number)
                force.setExceptionParameters(number, i, j, 0.0, sigma, 0.0)
            system.addForce(pairs)
    return rb.separate_bonded(system)


@cache
def _solvated(edge):
    """Return topology and positions of the peptide in a box of water, and the number of its atoms."""
    pdb = app.PDBFile(str(PEPTIDE))
    modeller = app.Modeller(pdb.topology, pdb.positions)
    modeller.addSolvent(FORCE_FIELD, boxSize=openmm.Vec3(edge, edge, edge) * unit.nanometer)
    return modeller.topology, modeller.positions, pdb.topology.getNumAtoms()


@cache
def _in_water(constraints, waters):
    topology, positions, peptide = _solvated(2.2)
    modeller = app.Modeller(topology, positions)
    x = np.array(positions.value_in_unit(unit.nanometer))
    water = [residue for residue in modeller.topology.residues() if residue.name == "HOH"]
    water.sort(key=lambda residue: np.linalg.norm(x[next(residue.atoms()).index] - x[:peptide], axis=1).min())
    modeller.delete(water[waters:])
    modeller.topology.setPeriodicBoxVectors(None)
    system = FORCE_FIELD.createSystem(modeller.topology, constraints=CONSTRAINTS[constraints], removeCMMotion=False)
    context = context_of(system, openmm.VerletIntegrator(0.001), modeller.positions)
    context.applyConstraints(1e-9)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0, 200)
    return modeller.topology, system, positions_of(context)


def in_box(edge=2.1, cutoff=0.85):
    """Return topology, System and positions (nm) of alanine dipeptide in a periodic box of rigid TIP3P."""
    topology, positions, _ = _solvated(edge)
    options = {"nonbondedMethod": app.CutoffPeriodic, "nonbondedCutoff": cutoff, "removeCMMotion": False}
    system = FORCE_FIELD.createSystem(topology, constraints=app.HBonds, **options)
    return topology, system, np.array(positions.value_in_unit(unit.nanometer))


def in_water(constraints="HBonds", waters=6):
    """Return topology, System and positions (nm) of alanine dipeptide with its nearest molecules of rigid TIP3P."""
    topology, system, x = _in_water(constraints, waters)
    return topology, openmm.XmlSerializer.clone(system), x.copy()


def moving(system, x, h=0.0005, scheme="S2_2", temperature=300.0, beside=None, **options):
    """Return our integrator and its Context where its engine runs, or another engine, with momenta of a temperature."""
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, **options)
    platform, properties = platform_for(beside or options.get("engine"))
    context = context_of(system, integrator, x, platform=platform, properties=properties)
    integrator.setVelocitiesToTemperature(temperature, 3)
    return integrator, context


def violations(system, x, v):
    """Return by how much (nm) lengths are missed, and the velocities along constraints times their lengths."""
    constraints = [system.getConstraintParameters(i) for i in range(system.getNumConstraints())]
    lengths = [abs(np.linalg.norm(x[i] - x[j]) - d._value) for i, j, d in constraints]
    slips = [abs((x[i] - x[j]) @ (v[i] - v[j])) for i, j, _ in constraints]
    return max(lengths), max(slips)


def end_of(system, x, scheme, time, **options):
    """Return end(n), the positions (3, 22) after n steps over a time from the same state."""
    start, _context = moving(system, x)
    start.step(20)
    _, state = start.fullState()

    def end(n):
        integrator, context = moving(system, x, time / n, scheme, **options)
        integrator.setBodyState(state)
        integrator.step(n)
        return positions_of(context).T

    return end
