"""What moves: read from files, or made."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app, unit

from openmm_exactrb.states import loadState, read_xml
from openmm_exactrb.systems import rigid_water

#: Water models of `openmm.app.Modeller.addSolvent` and `openmm_exactrb.rigid_water`.
WATERS = ("tip3p", "spce", "tip4pew", "tip5p")
#: What ForceField.createSystem constrains beside rigid water.
CONSTRAINTS = {"none": None, "HBonds": app.HBonds, "AllBonds": app.AllBonds, "HAngles": app.HAngles}

_READERS = {".pdb": app.PDBFile, ".ent": app.PDBFile, ".cif": app.PDBxFile, ".pdbx": app.PDBxFile}
_READERS[".mmcif"] = app.PDBxFile
_SWITCH = 0.1 * unit.nanometer  # the width in which forces go to zero: a jump at the cutoff heats


@dataclass(frozen=True)
class Box:
    """What moves.

    Attributes
    ----------
    topology : openmm.app.Topology
    system : openmm.System
    positions : Quantity
        (n, 3) in nm.
    state : openmm.State, optional
        Where a run begins, if that was in a file.
    """

    topology: app.Topology
    system: openmm.System
    positions: unit.Quantity
    state: openmm.State | None = None

    @property
    def moves(self) -> bool:
        """Whether it has velocities."""
        if self.state is None or not self.state.getDataTypes() & openmm.State.Velocities:
            return False
        return bool(np.any(self.state.getVelocities(asNumpy=True)._value))


def load(args: argparse.Namespace) -> Box:
    """Return what the options of ``exactrb run`` describe.

    Raises
    ------
    ValueError
        If files and options do not belong together, or cannot be read.
    OSError
        If there is no such file.
    """
    kinds = [file.suffix.lower() for file in args.files]
    if kinds == [".xml", ".xml"]:
        return _serialised(args)
    if len(kinds) > 1 or not all(kind in _READERS for kind in kinds):
        raise ValueError(
            "give one file, of PDB (.pdb) or PDBx (.cif), or two, system.xml and state.xml, or none with --solvate, "
            f"not {' '.join(map(str, args.files))}"
        )
    if not args.forcefield:
        raise ValueError("name the force field, such as --forcefield tip4pew.xml")
    force_field = _understood("the force field", app.ForceField, *args.forcefield)
    modeller = _solvated(args, force_field)
    modeller.addExtraParticles(force_field)
    return Box(modeller.topology, _system(args, force_field, modeller.topology), modeller.positions)


def _serialised(args: argparse.Namespace) -> Box:
    if args.forcefield or args.solvate:
        raise ValueError("--forcefield and --solvate go with a PDB or PDBx file: a System has its forces already")
    system, state = (read_xml(file, kind) for file, kind in zip(args.files, (openmm.System, openmm.State), strict=True))
    if not state.getDataTypes() & openmm.State.Positions:
        raise ValueError(f"{args.files[1]} has no positions: save it with simulation.saveState")
    positions = state.getPositions(asNumpy=True)
    if len(positions) != system.getNumParticles():
        raise ValueError(f"the State has {len(positions)} particles, but the System {system.getNumParticles()}")
    return Box(topology_of(system, state), system, positions, state)


def _solvated(args: argparse.Namespace, force_field: app.ForceField) -> app.Modeller:
    """Return what is in the file, with water around it if that is asked for, or water alone."""
    if not args.files:
        if not args.solvate:
            raise ValueError("there is nothing to run: give a file, or --solvate 216 for that many molecules of water")
        topology, _, positions = rigid_water(args.solvate, args.seed, model=_water(args), nonbondedMethod=app.PME)
        return _without_extra_particles(topology, positions)
    (file,) = args.files
    content = _understood(str(file), _whole(_READERS[file.suffix.lower()]), file)
    modeller = app.Modeller(content.topology, content.positions)
    if args.solvate:
        model = _water(args)
        _understood("the box of water", modeller.addSolvent, force_field, model=model, numAdded=args.solvate)
    return modeller


def _whole(reader: Callable[[str], Any]) -> Callable[[Path], Any]:
    """Return a reader that refuses a PDB file which was cut off."""

    def read(file: Path) -> Any:
        ends = [line.startswith("END") for line in file.read_text().splitlines()]
        if reader is app.PDBFile and not any(ends):
            raise ValueError("there is no line END, so that it is no PDB file or a truncated one")
        return reader(str(file))

    return read


def _without_extra_particles(topology: app.Topology, positions: unit.Quantity) -> app.Modeller:
    """Return a Modeller of the atoms: the force field has its own extra particles."""
    modeller = app.Modeller(topology, positions)
    modeller.delete([atom for atom in topology.atoms() if atom.element is None])
    return modeller


def _water(args: argparse.Namespace) -> str:
    """Return the water model that is asked for, or the one that a force field file is named after."""
    if args.water is not None:
        return str(args.water)
    named = [model for model in WATERS for file in args.forcefield if model in Path(file).stem]
    if not named:
        raise ValueError(f"which water is it? Add --water, one of {', '.join(WATERS)}")
    return named[0]


def _system(args: argparse.Namespace, force_field: app.ForceField, topology: app.Topology) -> openmm.System:
    vectors = topology.getPeriodicBoxVectors()
    options: dict[str, Any] = {"nonbondedMethod": app.NoCutoff}
    if vectors is not None:
        width = min(vectors[i][i].value_in_unit(unit.nanometer) for i in range(3))
        if args.cutoff > 0.5 * width:
            raise ValueError(
                f"the box is {width:.3g} nm wide, and --cutoff {args.cutoff:g} more than half of that: "
                "make it smaller, or take a larger box"
            )
        options = {
            "nonbondedMethod": app.PME,
            "nonbondedCutoff": args.cutoff * unit.nanometer,
            "switchDistance": max(args.cutoff * unit.nanometer - _SWITCH, 0.5 * args.cutoff * unit.nanometer),
            "ewaldErrorTolerance": args.ewald_tolerance,
        }
    return _understood(
        "the force field",
        force_field.createSystem,
        topology,
        constraints=CONSTRAINTS[args.constraints],
        rigidWater=True,
        removeCMMotion=False,
        **options,
    )


def _understood(what: str, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Call a function of openmm.app, which raises whatever it stumbles over in a user's file, and say so."""
    try:
        return function(*arguments, **options)
    except OSError:
        raise
    except Exception as error:
        raise ValueError(f"{what} was not understood: {' '.join(str(error).split())}") from error


def begin_at(simulation: app.Simulation, state: openmm.State) -> None:
    """Put a State into a Simulation whose barostat keeps its own pressure and temperature.

    A State has those of the run that it was saved in.
    """
    loadState(simulation, state)
    for force in simulation.system.getForces():
        if isinstance(force, openmm.MonteCarloBarostat):
            pressure, temperature = force.getDefaultPressure(), force.getDefaultTemperature()
            simulation.context.setParameter(force.Pressure(), pressure.value_in_unit(unit.bar))
            simulation.context.setParameter(force.Temperature(), temperature.value_in_unit(unit.kelvin))


def topology_of(system: openmm.System, state: openmm.State) -> app.Topology:
    """Return a topology for a System without one: a residue per molecule, elements by mass.

    Parameters
    ----------
    system : openmm.System
    state : openmm.State
        With positions; its box is that of the topology.

    Raises
    ------
    ValueError
        If molecules are interleaved.
    """
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(state.getPositions())
    topology, chain = app.Topology(), None
    residues: dict[int, Any] = {}
    for molecule in map(tuple, context.getMolecules()):
        chain = chain or topology.addChain()
        residue = topology.addResidue(_residue_name(system, molecule), chain)
        residues |= dict.fromkeys(molecule, residue)
    atoms = [_add_atom(topology, residues[i], system.getParticleMass(i)) for i in _in_order(residues)]
    for constraint in range(system.getNumConstraints()):
        first, second, _ = system.getConstraintParameters(constraint)
        topology.addBond(atoms[first], atoms[second])
    if system.usesPeriodicBoundaryConditions():
        topology.setPeriodicBoxVectors(state.getPeriodicBoxVectors())
    return topology


def _in_order(residues: dict[int, Any]) -> list[int]:
    """Return the particles in their order, which must be that of the molecules for a Topology to keep it."""
    order = sorted(residues)
    if order != list(residues):
        raise ValueError("molecules of the System are interleaved: give their PDB or PDBx file instead")
    return order


def _residue_name(system: openmm.System, molecule: Sequence[int]) -> str:
    symbols = sorted(element.symbol for i in molecule if (element := _element(system.getParticleMass(i))) is not None)
    return "HOH" if symbols == ["H", "H", "O"] else "MOL"


def _element(mass: unit.Quantity) -> Any:
    return app.Element.getByMass(mass) if mass.value_in_unit(unit.dalton) > 0.0 else None


def _add_atom(topology: app.Topology, residue: Any, mass: unit.Quantity) -> Any:
    element = _element(mass)
    number = sum(1 for _ in residue.atoms()) + 1
    return topology.addAtom(f"{element.symbol if element else 'V'}{number}", element, residue)
