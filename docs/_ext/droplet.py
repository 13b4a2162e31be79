"""A droplet of water that moves, for the view in the page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import openmm

import openmm_exactrb as rb

FRAMES, MOLECULES = 50, 64


def frames() -> Iterator[tuple[list[str], np.ndarray]]:
    """Yield the symbols of the elements and positions (n, 3) in nm, every 10 fs."""
    topology, system, positions = rb.rigid_water(MOLECULES)
    integrator = rb.ExactRigidBodyIntegrator(0.005, scheme="W4_5")
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context)
    integrator.setVelocitiesToTemperature(250.0, 1)
    integrator.step(600)
    elements = [atom.element.symbol for atom in topology.atoms()]
    for _ in range(FRAMES):
        yield elements, context.getState(positions=True).getPositions(asNumpy=True)._value
        integrator.step(2)


def write(file: Path) -> None:
    """Write them as XYZ, in ångström."""
    with file.open("w", encoding="utf-8") as out:
        for number, (elements, x) in enumerate(frames()):
            print(len(elements), f"{10 * number} fs", sep="\n", file=out)
            for element, place in zip(elements, 10.0 * x, strict=True):
                print(element, *(f"{coordinate:.3f}" for coordinate in place), file=out)
