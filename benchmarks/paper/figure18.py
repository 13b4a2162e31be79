"""Figure 18: two Nyström splittings on [0, 10], from the starts of figure 17.

The paper's "initial conditions as before" are those of figure 17: 125 soft dipolar spheres on a lattice, all at rest
but the two in opposite corners, whose momenta give the energy. It shows one start; ours are ten of each energy. It
tells where the higher order pays, and where it does not: beyond a step of one.
"""

import sys

import common
import figure17
import matplotlib.pyplot as plt
import numpy as np
import openmm
from claims import Claim, Criterion

import openmm_exactrb as rb

NAME = "figure18"
TITLE = "Figure 18: two Nyström splittings on a longer interval"
SCHEMES = ("SRKN4_6b", "SRKN6_14a")
#: Force evaluations per unit of time; with 14 the step of SRKN6_14a is one.
COSTS = (6, 8, 10, 12, 14, 17, 20, 28, 40, 80, 160)
STARTS = 10
T = 10.0


def errors(seed, energy, costs, duration):
    """Return the step and the largest relative energy error at the ends of steps, by scheme and cost."""
    found = {}
    for name in SCHEMES:
        for cost in costs:
            steps = max(1, round(cost * duration / rb.SCHEMES[name].stages))
            integrator = rb.ExactRigidBodyIntegrator(duration / steps, scheme=name)
            platform = openmm.Platform.getPlatform("Reference")
            context = openmm.Context(figure17.system(figure17.SPACING), integrator, platform)
            context.setPositions(figure17.positions(seed, figure17.SPACING))
            figure17.push_corners(context, energy)
            entry = {"step": duration / steps, "error": largest_error(integrator, steps)}
            found.setdefault(name, []).append(entry)
    return found


def largest_error(integrator, steps):
    """Return the largest relative error of the energy along a run, at most 1e300: then it blew up."""
    first, largest = integrator.totalEnergy()._value, 0.0
    try:
        for _ in range(steps):
            integrator.step(1)
            largest = max(largest, abs(integrator.totalEnergy()._value / first - 1.0))
    except rb.NonFiniteError:
        return 1e300
    return float(f"{min(largest, 1e300):.4g}")


def compute(quick):
    energies, costs, starts, duration = figure17.ENERGIES, COSTS, STARTS, T
    if quick:
        energies, costs, starts, duration = energies[::3], COSTS[2::4], 2, 5.0
    pieces = [
        {"seed": seed, "energy": energy, "costs": costs, "duration": duration}
        for energy in energies
        for seed in range(starts)
    ]
    data = {"costs": costs, "energies": {}}
    for piece, result in zip(pieces, common.in_pieces(NAME, errors, pieces), strict=True):
        lines = data["energies"].setdefault(f"{piece['energy']:g}", {})
        for name, line in result.items():
            entry = lines.setdefault(name, {"step": [e["step"] for e in line], "errors": []})
            entry["errors"].append([e["error"] for e in line])
    return data
