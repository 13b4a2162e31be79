"""The subcommand ``exactrb info``, which describes a user's files, or the installation."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Iterator
from pathlib import Path

import openmm

import openmm_exactrb
from openmm_exactrb.command import inputs
from openmm_exactrb.command.description import PROTEIN, PROTEIN_AND_WATER, described
from openmm_exactrb.engines import ENGINES
from openmm_exactrb.integrators.states import read_xml
from openmm_exactrb.openmm_access.platforms import platforms, why_not_by_default
from openmm_exactrb.rotors import ROTORS
from openmm_exactrb.schemes import CATALOGUE, scheme_for_thermostat
from openmm_exactrb.support.version import version

#: The purpose of the subcommand, in one sentence.
PURPOSE = (
    "Print how the molecules in files move, a suitable step and what is not supported; without files, print what is "
    "installed."
)

_INTEGRATORS = [name for name in openmm_exactrb.__all__ if name.endswith("Integrator")]
# Schemes that docs/which.md recommends.
_RECOMMENDED = ("W2_1", "W4_4", PROTEIN, "W2_4g", PROTEIN_AND_WATER)
_LIBRARIES = ("numpy", "scipy", "numba", "matplotlib")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments for files and for the forces on their molecules."""
    inputs.add_options(parser)


def carry_out(args: argparse.Namespace) -> int:
    """Print the description of the files or of the installation; return the exit status 0."""
    if not args.files and not args.solvate:
        print("\n".join(_lines()))
        return 0
    if [file.suffix.lower() for file in args.files] == [".xml"]:
        system = read_xml(args.files[0], openmm.System)
        print("\n".join(described(system)))
        return 0
    box = inputs.load(inputs.with_defaults(args))
    print("\n".join(described(box.system, box.positions, box.topology)))
    return 0


def _lines() -> Iterator[str]:
    yield f"openmm-exactrb {openmm_exactrb.__version__} in {Path(openmm_exactrb.__file__).parent}"
    yield f"Python {platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores"
    yield f"OpenMM {openmm.__version__}, {', '.join(f'{name} {version(package=name)}' for name in _LIBRARIES)}"
    yield from (f"{name} engine: {engine.information()}" for name, engine in ENGINES.items())
    yield "platforms, fastest first:"
    for found in platforms():
        why = why_not_by_default(found.getName())
        yield f"  {found.getName()}, speed {found.getSpeed():g}{f'; used only if named: {why}' if why else ''}"
    for failure in openmm.Platform.getPluginLoadFailures():
        yield f"  a plugin could not be loaded: {' '.join(failure.split())}"
    yield "integrators:"
    for name in _INTEGRATORS:
        yield f"  {name}: {str(getattr(openmm_exactrb, name).__doc__).splitlines()[0]}"
    yield f"schemes: {len(CATALOGUE)} in openmm_exactrb.SCHEMES, of which these are recommended for most runs:"
    yield from (f"  {scheme_for_thermostat(name)!r}" for name in _RECOMMENDED)
    yield f'rotors: {len(ROTORS)} in openmm_exactrb.ROTORS; "exact" is the default'
