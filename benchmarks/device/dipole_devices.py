"""Dipoles from OpenMM's own forces on a device: what they cost, and how wrong they are.

The liquid is a Stockmayer fluid at density 0.822, kT = 1.15 and mu² = 3, molten for 1000 dipoles or fewer; more are
copies of it, shaken. Errors are root mean square, as a part of the quantity's own, of forces and torques on the bodies.

"bonds" compares the two forces of a reaction field, donors and acceptors beside a bond for each pair, both on the
device, in turns within one run, with the compiled kernel as the reference of their errors. "rods" measures the rods of
charges that stand for an Ewald sum over their length and the tolerance, against the compiled sum at 1e-10, dipoles
alone. Raw data go to out/benchmarks/dipole_devices.json.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.records import OUT
from openmm_exactrb.potentials import dipole_rod_forces, rod_length, soft_dipole_force

DENSITY, KT, MU2, KB = 0.822, 1.15, 3.0, 0.00831446261815324
REFERENCE = openmm.Platform.getPlatform("Reference")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("what", choices=("bonds", "rods"))
    add("-n", type=int, nargs="*", default=[125, 1000], help="numbers of dipoles (125 1000)")
    add("--platform", default="OpenCL", help="%(default)s")
    add("--precision", nargs="*", default=["single", "double"], help="single double; mixed costs what single does")
    add("--cutoff", type=float, help="sigma (3, or three tenths of a smaller box)")
    add("--scale", type=float, default=1.0, help='of all energies of "bonds": OpenMM adds up forces in fixed point')
    add("--rounds", type=int, default=8, help="%(default)s")
    arguments = parser.parse_args()
    rows = []
    for n in arguments.n:
        for precision in arguments.precision:
            measure = bonds if arguments.what == "bonds" else rods
            for row in measure(n, arguments, precision):
                rows.append({"n": n, "platform": arguments.platform, "precision": precision} | row)
                print("  ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()))
    OUT.mkdir(parents=True, exist_ok=True)
    data = OUT / "dipole_devices.json"
    old = json.loads(data.read_text()) if data.exists() else []
    data.write_text(json.dumps(old + rows, indent=1))


def liquid(n):
    """Return centres, unit vectors of the dipoles, and the edge of the box."""
    file = OUT / f"stockmayer_{n}.npz"
    if not file.exists():
        OUT.mkdir(parents=True, exist_ok=True)
        np.savez(file, *(copied(n) if n > 1000 else molten(n)))
    centres, u, edge = np.load(file).values()
    return centres, u, float(edge)


def molten(n):
    boundary = rb.Ewald(tolerance=1e-3)
    inertia, dipole = (0.2,) * 3, (0.0, 0.0, MU2**0.5)
    _, system, positions = rb.dipole_fluid(
        n, dipole=dipole, inertia=inertia, attraction=1.0, boundary=boundary, density=DENSITY
    )
    integrator = rb.ExactRigidBodyIntegrator(0.005, "S2_2")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    for k in range(4):
        integrator.setVelocitiesToTemperature(KT / KB, k)
        integrator.step(150)
    sites = context.getState(positions=True).getPositions(asNumpy=True)._value.reshape(n, -1, 3)[:, -2:]
    return sites[:, 0], 2.0 * (sites[:, 1] - sites[:, 0]), (n / DENSITY) ** (1.0 / 3.0)


def copied(n):
    """Return copies of a molten thousand side by side, each particle moved and turned a little."""
    side = round((n / 1000) ** (1.0 / 3.0))
    if 1000 * side**3 != n:
        raise SystemExit(f"dipole_devices.py: {n} is not 1000 times a cube: take 8000 or 27000")
    centres, u, edge = liquid(1000)
    rng = np.random.default_rng(1)
    shifts = edge * np.argwhere(np.ones(3 * (side,)))
    centres = (centres + shifts[:, None]).reshape(-1, 3) + 0.03 * rng.standard_normal((n, 3))
    u = np.tile(u, (side**3, 1)) + 0.2 * rng.standard_normal((n, 3))
    return centres, u / np.linalg.norm(u, axis=1, keepdims=True), side * edge


def context_of(forces, sites, edge, platform, precision=None):
    system = openmm.System()
    for _ in sites:
        system.addParticle(1.0)
    system.setDefaultPeriodicBoxVectors(*(edge * np.eye(3)))
    for force in forces:
        system.addForce(force)
    properties = {"Precision": precision} if precision else {}
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), platform, properties)
    context.setPositions(sites)
    return context


def on_bodies(context, centres, sites):
    """Return forces and torques (n, 3) of two sites a body."""
    forces = context.getState(forces=True).getForces(asNumpy=True)._value.reshape(-1, 2, 3)
    return forces.sum(axis=1), np.cross(sites.reshape(-1, 2, 3) - centres[:, None], forces).sum(axis=1)


def apart(one, other):
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def in_turns(contexts, rounds):
    """Return the least and the median wall time (ms) of a force evaluation, in turns."""
    times = {name: [] for name in contexts}
    for _ in range(rounds):
        for name, context in contexts.items():
            start = time.perf_counter()
            context.getState(forces=True)
            times[name].append(1e3 * (time.perf_counter() - start))
    return {name: (min(each), float(np.median(each))) for name, each in times.items()}


def bonds(n, arguments, precision):
    """Yield a row for each force of a reaction field."""
    centres, u, edge = liquid(n)
    sites = np.stack([centres, centres + 0.5 * u], axis=1).reshape(-1, 3)
    arrows = np.arange(2 * n).reshape(n, 2).tolist()
    around = {"box": 3 * [edge], "boundary": rb.ReactionField(cutoff=arguments.cutoff or min(3.0, 0.3 * edge))}
    platform = openmm.Platform.getPlatform(arguments.platform)
    around |= {"strength": (arguments.scale * MU2) ** 0.5, "epsilon": arguments.scale, "attraction": 1.0}
    kernels = ["openmm"] + ["bonds"] * (n <= 1000)

    def built(kernel, *where):
        return context_of([soft_dipole_force(arrows, length=0.5, kernel=kernel, **around)], sites, edge, *where)

    exact = on_bodies(built("compiled", REFERENCE), centres, sites)
    contexts = {kernel: built(kernel, platform, precision) for kernel in kernels}
    errors = {kernel: list(map(apart, on_bodies(contexts[kernel], centres, sites), exact)) for kernel in kernels}
    for kernel, (least, median) in in_turns(contexts, arguments.rounds).items():
        force, torque = errors[kernel]
        yield {"kernel": kernel, "force error": force, "torque error": torque, "ms": least, "median ms": median}


def rods(n, arguments, precision):
    """Yield a row for each tolerance and length."""
    centres, u, edge = liquid(n)
    cutoff = arguments.cutoff or min(3.0, 0.4 * edge)
    arrows = np.arange(2 * n).reshape(n, 2).tolist()
    around = {"box": 3 * [edge], "strength": MU2**0.5, "epsilon": 0.0}
    platform = openmm.Platform.getPlatform(arguments.platform)
    sites = np.stack([centres, centres + 0.5 * u], axis=1).reshape(-1, 3)
    exact = soft_dipole_force(
        arrows, length=0.5, kernel="compiled", boundary=rb.Ewald(cutoff=cutoff, tolerance=1e-10), **around
    )
    forces, torques = on_bodies(context_of([exact], sites, edge, REFERENCE), centres, sites)
    for tolerance in (1e-2, 1e-3, 3e-4, 1e-4):
        boundary = rb.Ewald(cutoff=cutoff, tolerance=tolerance)
        own = rod_length(n, around["box"], boundary)
        for length in (0.3 * own, own, 3.0 * own) if tolerance == 1e-3 else (own,):
            ends = np.stack([centres + 0.5 * length * u, centres - 0.5 * length * u], axis=1).reshape(-1, 3)
            parts = dipole_rod_forces(arrows, 2 * n, length=length, boundary=boundary, **around)
            context = context_of(parts, ends, edge, platform, precision)
            force, torque = on_bodies(context, centres, ends)
            least, median = in_turns({"rods": context}, 3)["rods"]
            row = {"tolerance": tolerance, "length": length, "mesh": parts[0].getPMEParameters()[1]}
            row |= {"force error": apart(force, forces), "torque error": apart(torque, torques)}
            yield row | {"ms": least, "median ms": median}


if __name__ == "__main__":
    main()
