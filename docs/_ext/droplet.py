"""A droplet of water that moves, for the view in the page."""

from __future__ import annotations

from pathlib import Path

import openmm

import openmm_exactrb as rb

FRAMES, MOLECULES = 50, 64


def write(file: Path) -> None:
    """Write a trajectory of rigid water as XYZ, in ångström, a frame every 10 fs."""
    topology, system, positions = rb.rigid_water(MOLECULES)
    integrator = rb.ExactRigidBodyIntegrator(0.005, scheme="W4_5")
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context)
    integrator.setVelocitiesToTemperature(250.0, 1)
    integrator.step(600)
    elements = [atom.element.symbol for atom in topology.atoms()]
    with file.open("w") as out:
        for frame in range(FRAMES):
            x = 10.0 * context.getState(positions=True).getPositions(asNumpy=True)._value
            print(len(elements), f"{10 * frame} fs", sep="\n", file=out)
            for element, place in zip(elements, x, strict=True):
                print(element, *(f"{number:.3f}" for number in place), file=out)
            integrator.step(2)
