"""The molecules of a run, read from files or created."""

from __future__ import annotations

import argparse
import errno
import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from operator import attrgetter, methodcaller
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from openmm import app, unit

from openmm_exactrb.command import arguments
from openmm_exactrb.command.topology import topology_of
from openmm_exactrb.integrators.states import loadState, read_xml
from openmm_exactrb.support.warn import warn
from openmm_exactrb.systems.fluids import rigid_water
from openmm_exactrb.systems.masses import heavy_hydrogens

#: Water models of `openmm.app.Modeller.addSolvent` and `openmm_exactrb.rigid_water`.
WATERS = ("tip3p", "spce", "tip4pew", "tip5p")
#: Constraints of ForceField.createSystem in addition to those of rigid water.
CONSTRAINTS = {"none": None, "HBonds": app.HBonds, "AllBonds": app.AllBonds, "HAngles": app.HAngles}

#: The files that can describe molecules, as text for messages.
FILES = (
    "one file (PDB .pdb or PDBx .cif), or two (system.xml and state.xml, a prmtop and an inpcrd, or a top and a gro)"
)

#: Defaults of options that apply only to some files.
DEFAULTS: dict[str, Any] = {"cutoff": 0.9, "ewald_tolerance": 1e-5, "constraints": "none"}

_READERS = dict.fromkeys((".pdb", ".ent"), app.PDBFile) | dict.fromkeys((".cif", ".pdbx", ".mmcif"), app.PDBxFile)
# For each type of file with positions only: the readers of positions and of a topology, and a function for the box.
_AMBER = app.AmberInpcrdFile, app.AmberPrmtopFile, attrgetter("boxVectors")
_GROMACS = app.GromacsGroFile, app.GromacsTopFile, methodcaller("getPeriodicBoxVectors")
_POSITIONS: dict[str, tuple[Any, Any, Callable[[Any], Any]]]
_POSITIONS = {".gro": _GROMACS, ".inpcrd": _AMBER, ".rst7": _AMBER, ".crd": _AMBER}
_SWITCH = 0.1 * unit.nanometer  # width of the switching function, without which the energy jumps at the cutoff
# The edge (nm) of the cell in files of molecules that are not in a crystal (wwPDB format, CRYST1), the smallest width
# (nm) of a periodic box, and the largest number of atoms per nm³; diamond has 176.
_PLACEHOLDER, _NARROWEST, _DENSEST = 0.1, 0.2, 180.0
# Records of atoms in a PDB file, and records that follow all atoms of a molecule.
_ATOMS, _BEHIND_ATOMS = ("ATOM", "HETATM"), ("TER", "MASTER", "CONECT")
_COORDINATES = 54  # columns of a PDB line up to the end of its coordinates


@dataclass(frozen=True)
class Box:
    """The molecules of a run, and the State from which they were read, if any."""

    topology: app.Topology
    system: openmm.System
    positions: unit.Quantity
    state: openmm.State | None = None

    @property
    def moves(self) -> bool:
        """Whether the initial state has nonzero velocities."""
        if self.state is None or not self.state.getDataTypes() & openmm.State.Velocities:
            return False
        return bool(np.any(self.state.getVelocities(asNumpy=True)._value))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments for files and molecules; options that are not given are None or empty lists."""
    positive, shown = arguments.positive, {name: f"(default: {of})" for name, of in DEFAULTS.items()}
    add = parser.add_argument_group("molecules").add_argument
    files = (
        "a PDB or PDBx file, or two files: system.xml and state.xml of OpenMM, prmtop and inpcrd of Amber, or top "
        "and gro of GROMACS"
    )
    add("files", nargs="*", type=Path, metavar="FILE", help=files)
    add("--forcefield", nargs="+", default=[], metavar="FILE", help="force field files for openmm.app.ForceField")
    add(
        "--solvate",
        type=arguments.count,
        metavar="N",
        help="add N water molecules; without FILE, create a box of N water molecules",
    )
    water = "water model of --solvate (default: the model in the name of a force field file)"
    add("--water", **arguments.one_of(WATERS), help=water)
    add("--cutoff", type=positive, metavar="NM", help=f"cutoff of PME in a periodic box, nm {shown['cutoff']}")
    add("--ewald-tolerance", type=positive, metavar="X", help=f"ewaldErrorTolerance of PME {shown['ewald_tolerance']}")
    add(
        "--constraints",
        **arguments.one_of(CONSTRAINTS),
        help=f"constraints in addition to rigid water {shown['constraints']}",
    )
    heavy = "mass of each hydrogen atom, amu; the increase is subtracted from the bonded heavier atom"
    add("--hydrogen-mass", type=positive, metavar="AMU", help=heavy)


def with_defaults(args: argparse.Namespace, others: Mapping[str, Any] | None = None) -> argparse.Namespace:
    """Return the options, with values from `DEFAULTS` and `others` for options that were not given."""
    named = {name: value for name, value in vars(args).items() if value is not None}
    return argparse.Namespace(**vars(args) | {"seed": 1} | DEFAULTS | dict(others or {}) | named)


def check_idle(args: argparse.Namespace, box: Box, others: Iterable[tuple[bool, str, str]] = ()) -> None:
    """Raise ValueError if a given option has no effect; `others` are further conditions, options and reasons."""
    unboxed = box.topology.getPeriodicBoxVectors() is None
    idle = [
        (
            box.state is not None,
            "constraints cutoff ewald_tolerance water",
            "because the System already contains forces and constraints",
        ),
        (unboxed, "cutoff ewald_tolerance", "without a periodic box"),
        (not args.solvate, "water", "without --solvate"),
        *others,
    ]
    for applies, names, reason in idle:
        for name in names.split():
            if applies and getattr(args, name) is not None:
                raise ValueError(f"--{name.replace('_', '-')} has no effect {reason}: omit --{name.replace('_', '-')}")


def load(args: argparse.Namespace) -> Box:
    """Return the molecules that the options describe; raise ValueError if the options are inconsistent."""
    if not args.files and not args.solvate:
        raise ValueError(
            f"molecules are missing: pass {FILES}, or --solvate 216 --forcefield tip4pew.xml for 216 water molecules"
        )
    for file in args.files:
        if not file.exists():
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(file))
    kinds = [file.suffix.lower() for file in args.files]
    if kinds == [".xml", ".xml"]:
        return _serialised(args)
    if len(kinds) == 2 and set(kinds) & set(_POSITIONS):
        return _with_topology(args, *sorted(args.files, key=lambda file: file.suffix.lower() in _POSITIONS))
    if len(kinds) > 1 or not all(kind in _READERS for kind in kinds):
        raise ValueError(
            f"molecules cannot be read from {' '.join(map(str, args.files))}: pass {FILES}, or use --solvate without "
            "a file"
        )
    if not args.forcefield:
        what = f"{args.files[0]} contains no force field" if kinds else "--solvate needs a force field"
        such = "amber14-all.xml amber14/tip4pew.xml" if kinds else "tip4pew.xml"
        raise ValueError(f"{what}: add --forcefield and its files, such as --forcefield {such}")
    force_field = _understood("the force field", app.ForceField, *args.forcefield)
    modeller = _read(args, force_field) if kinds else _water_box(args)
    modeller.addExtraParticles(force_field)
    create = partial(force_field.createSystem, modeller.topology)
    system = _system(args, create, modeller.topology, modeller.topology.getPeriodicBoxVectors())
    return Box(modeller.topology, system, modeller.positions)


def _serialised(args: argparse.Namespace) -> Box:
    if args.forcefield or args.solvate:
        raise ValueError(
            f"neither --forcefield nor --solvate applies to {args.files[0]}, which already contains the solvent and "
            "the forces: omit them"
        )
    if args.hydrogen_mass is not None:
        raise ValueError(
            f"--hydrogen-mass does not apply to {args.files[0]}, which already contains masses: omit "
            "--hydrogen-mass, and call heavy_hydrogens() in Python before you save the System"
        )
    system, state = (read_xml(file, kind) for file, kind in zip(args.files, (openmm.System, openmm.State), strict=True))
    if not state.getDataTypes() & openmm.State.Positions:
        raise ValueError(f"{args.files[1]} contains no positions: save the State with simulation.saveState")
    positions = state.getPositions(asNumpy=True)
    if len(positions) != system.getNumParticles():
        raise ValueError(
            f"the numbers of particles in {args.files[1]} ({len(positions)}) and in {args.files[0]} "
            f"({system.getNumParticles()}) differ: pass files of the same run"
        )
    if system.usesPeriodicBoundaryConditions():
        system.setDefaultPeriodicBoxVectors(*state.getPeriodicBoxVectors())
    return Box(topology_of(system, state), system, positions, state)


def _with_topology(args: argparse.Namespace, topology: Path, places: Path) -> Box:
    """Return the molecules of an Amber or GROMACS topology, which also defines the forces."""
    if args.forcefield or args.solvate:
        raise ValueError(
            f"neither --forcefield nor --solvate applies to {topology}, which already contains the solvent and the "
            "forces: omit them"
        )
    read_start, read_topology, box_of = _POSITIONS[places.suffix.lower()]
    start: Any = _understood(str(places), read_start, str(places))
    vectors = box_of(start)
    if vectors is not None and not any(vectors[i][i]._value for i in range(3)):  # as a .gro file without a box has
        vectors = None
    content: Any = _understood(str(topology), read_topology, str(topology), periodicBoxVectors=vectors)
    if vectors is None and content.topology.getPeriodicBoxVectors() is not None:
        raise ValueError(
            f"{topology} has a periodic box, but {places} contains none and may be truncated: pass a coordinate file "
            "that contains the box"
        )
    if len(start.positions) != content.topology.getNumAtoms():
        raise ValueError(
            f"the numbers of particles in {places} ({len(start.positions)}) and in {topology} "
            f"({content.topology.getNumAtoms()}) differ: pass files of the same molecules"
        )
    system = _system(args, content.createSystem, content.topology, vectors)
    return Box(content.topology, system, start.positions)


def _read(args: argparse.Namespace, force_field: app.ForceField) -> app.Modeller:
    """Return the molecules in the file, surrounded by water if requested."""
    (file,) = args.files
    reader = _READERS[file.suffix.lower()]
    if reader is app.PDBFile:
        _check_complete(file)
    content = _understood(str(file), reader, str(file))
    vectors = content.topology.getPeriodicBoxVectors()
    if vectors is not None and np.array_equal(vectors.value_in_unit(unit.nanometer), _PLACEHOLDER * np.eye(3)):
        warn(f"the cell of 1 Å in {file} is a placeholder, so the molecules of this file have no periodic box")
        content.topology.setPeriodicBoxVectors(None)
    modeller = app.Modeller(content.topology, content.positions)
    if args.solvate:
        model = _water(args)
        _understood("the box of water", modeller.addSolvent, force_field, model=model, numAdded=args.solvate)
    return modeller


def _check_complete(file: Path) -> None:
    """Raise ValueError for a PDB file without atoms or with a cut line; warn if no line marks the end of the atoms."""
    lines = [line for line in file.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    atoms = [line for line in lines if line.startswith(_ATOMS)]
    if not atoms:
        raise ValueError(f"{file} contains no atoms: pass a PDB file with lines ATOM or HETATM")
    if lines[-1] is atoms[-1] and len(lines[-1]) < _COORDINATES:
        raise ValueError(f"{file} is truncated, because its last line is incomplete: pass a complete PDB file")
    if not lines[-1].startswith(_BEHIND_ATOMS) and not any(line.startswith("END") for line in lines):
        warn(
            f"{file} contains no END line, so it may be truncated: check that none of its atoms are missing, the last "
            f"of which is {atoms[-1][12:26].strip()}"
        )


def _water_box(args: argparse.Namespace) -> app.Modeller:
    """Return a box of water without extra particles, which the force field adds."""
    topology, _, positions = rigid_water(args.solvate, args.seed, model=_water(args), nonbondedMethod=app.PME)
    modeller = app.Modeller(topology, positions)
    modeller.delete([atom for atom in topology.atoms() if atom.element is None])
    return modeller


def _water(args: argparse.Namespace) -> str:
    """Return the requested water model, or the water model that the name of a force field file contains."""
    if args.water is not None:
        return str(args.water)
    named = [model for model in WATERS for file in args.forcefield if model in Path(file).stem]
    if not named:
        raise ValueError(
            "--solvate needs a water model, but no force field file is named after one: add --water with one of "
            f"{', '.join(WATERS)}"
        )
    return named[0]


def _system(
    args: argparse.Namespace, create: Callable[..., openmm.System], topology: app.Topology, vectors: Any
) -> openmm.System:
    options: dict[str, Any] = {"nonbondedMethod": app.NoCutoff}
    if vectors is not None:
        edges = [vectors[i][i].value_in_unit(unit.nanometer) for i in range(3)]
        if min(edges) < _NARROWEST or topology.getNumAtoms() > _DENSEST * math.prod(edges):
            raise ValueError(
                f"the periodic box of {' x '.join(f'{edge:.4g}' for edge in edges)} nm is too small for "
                f"{topology.getNumAtoms()} atoms: correct the box in the file, such as CRYST1 in a PDB file, or remove "
                "it"
            )
        width = min(edges)
        if args.cutoff > 0.5 * width:
            raise ValueError(
                f"--cutoff must be at most half the width of the box, {0.5 * width:.6g} nm, not {args.cutoff:g} nm: "
                "use a smaller cutoff or a larger box"
            )
        options = {
            "nonbondedMethod": app.PME,
            "nonbondedCutoff": args.cutoff * unit.nanometer,
            "switchDistance": max(args.cutoff * unit.nanometer - _SWITCH, 0.5 * args.cutoff * unit.nanometer),
            "ewaldErrorTolerance": args.ewald_tolerance,
        }
    system: openmm.System = _understood(
        "the force field",
        create,
        constraints=CONSTRAINTS[args.constraints],
        rigidWater=True,
        removeCMMotion=False,
        **options,
    )
    if args.hydrogen_mass is not None:
        heavy_hydrogens(system, topology, args.hydrogen_mass)
    return system


def _understood(what: str, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Call a function of openmm.app, and convert its exceptions other than OSError to ValueError."""
    try:
        return function(*arguments, **options)
    except OSError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError) as error:  # whose text says nothing about the file
        raise ValueError(
            f"{what} is incomplete, or has another format than its name states: pass a complete file"
        ) from error
    except Exception as error:
        raise ValueError(f"{what} cannot be used: {' '.join(str(error).split())}") from error


def begin_at(simulation: app.Simulation, state: openmm.State) -> None:
    """Load a State, but keep the pressure and temperature of the Simulation's barostat."""
    loadState(simulation, state)
    for force in simulation.system.getForces():
        if isinstance(force, openmm.MonteCarloBarostat):
            pressure, temperature = force.getDefaultPressure(), force.getDefaultTemperature()
            simulation.context.setParameter(force.Pressure(), pressure.value_in_unit(unit.bar))
            simulation.context.setParameter(force.Temperature(), temperature.value_in_unit(unit.kelvin))
