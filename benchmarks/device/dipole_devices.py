"""The cost and the errors of forces between dipoles that OpenMM itself computes on a device.

The liquid is a Stockmayer fluid at density 0.822, kT = 1.15 and mu² = 3, equilibrated for 1000 dipoles or fewer. Larger
samples are copies of the liquid with random displacements and rotations. Errors are those of forces and torques on the
bodies, as root mean squares relative to those of the exact values.

"bonds" compares the two forces for a reaction field, with donors and acceptors or with a bond for each pair. Both run
alternately on the device, and the compiled kernel is the reference for their errors. Where other programs run, use the
processor time of OpenCL on a CPU (--clock cpu). "rods" measures the rods of charges that represent dipoles in an Ewald
sum, as a function of their length and the tolerance, without spheres, relative to the compiled sum at 1e-10. Rows are
written to records/dipole_bonds.csv and records/dipole_rods.csv.
"""

from __future__ import annotations

import argparse
import time
from functools import partial

import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.common.clocks import in_turns
from benchmarks.common.provenance import PROVENANCE, provenance
from benchmarks.common.records import OUT, RECORDS, Record
from benchmarks.common.starts import context_of
from benchmarks.common.stockmayer import KELVIN, MU2, arrows, edge_of, fluid, relative_error
from openmm_exactrb.potentials import dipole_rod_forces, rod_length, soft_dipole_force

CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
TABLES = {
    "bonds": Record(
        RECORDS / "dipole_bonds.csv",
        ("dipoles", "precision", "energies scaled by", "kernel"),
        ("force error", "torque error", "clock", "ms", "median ms", *PROVENANCE),
    ),
    "rods": Record(
        RECORDS / "dipole_rods.csv",
        ("dipoles", "precision", "tolerance", "length (sigma)"),
        ("mesh", "force error", "torque error"),
    ),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("what", choices=("bonds", "rods"))
    add("-n", type=int, nargs="*", default=[125, 1000], help="numbers of dipoles (125 1000)")
    add("--platform", default="OpenCL", help="%(default)s")
    add("--precision", nargs="*", default=["single", "double"], help="single double; mixed costs what single does")
    add("--cutoff", type=float, help="sigma (3, or three tenths of a smaller box)")
    add("--scale", type=float, default=1.0, help='of all energies of "bonds": OpenMM adds up forces in fixed point')
    add("--clock", choices=CLOCKS, default="wall", help="cpu: processor time of all threads (%(default)s)")
    add("--rounds", type=int, default=8, help="%(default)s")
    arguments = parser.parse_args()
    for n in arguments.n:
        for precision in arguments.precision:
            measure = bonds if arguments.what == "bonds" else rods
            for row in measure(n, arguments, precision):
                shown = {name: f"{value:.3g}" if isinstance(value, float) else value for name, value in row.items()}
                TABLES[arguments.what].add({"dipoles": n, "precision": precision} | provenance() | shown)


def liquid(n):
    """Return centres, unit vectors of the dipoles, and the edge of the box."""
    file = OUT / f"stockmayer_{n}.npz"
    if not file.exists():
        OUT.mkdir(parents=True, exist_ok=True)
        np.savez(file, *(copied(n) if n > 1000 else molten(n)))
    centres, u, edge = np.load(file).values()
    return centres, u, float(edge)


def molten(n):
    integrator = rb.ExactRigidBodyIntegrator(0.005, "S2_2")
    context = fluid(n, integrator, rb.Ewald(tolerance=1e-3))
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    for k in range(4):
        integrator.setVelocitiesToTemperature(KELVIN, k)
        integrator.step(150)
    return *arrows(context.getState(positions=True).getPositions(asNumpy=True)._value, n), edge_of(n)


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


def evaluating(forces, sites, edge, platform, precision=None):
    """Return a Context of such forces between the sites."""
    system = openmm.System()
    for _ in sites:
        system.addParticle(1.0)
    system.setDefaultPeriodicBoxVectors(*(edge * np.eye(3)))
    for force in forces:
        system.addForce(force)
    properties = {"Precision": precision} if precision else {}
    return context_of(system, openmm.VerletIntegrator(0.001), sites, platform, properties)


def on_bodies(context, centres, sites):
    """Return forces and torques (n, 3) of two sites a body, and of its centre, if it has one as its last site."""
    forces = context.getState(forces=True).getForces(asNumpy=True)._value
    at_sites, at_centres = forces[: len(sites)].reshape(-1, 2, 3), forces[len(sites) :]
    torques = np.cross(sites.reshape(-1, 2, 3) - centres[:, None], at_sites).sum(axis=1)
    return at_sites.sum(axis=1) + (at_centres if len(at_centres) else 0.0), torques


def times_of(contexts, rounds, clock):
    """Return the least and the median time (ms) of a force evaluation, in turns."""
    runs = {name: partial(context.getState, forces=True) for name, context in contexts.items()}
    times = in_turns(runs, rounds, CLOCKS[clock])
    return {name: (1e3 * min(each), 1e3 * float(np.median(each))) for name, each in times.items()}


def bonds(n, arguments, precision):
    """Yield a row for each force of a reaction field."""
    centres, u, edge = liquid(n)
    sites = np.stack([centres, centres + 0.5 * u], axis=1).reshape(-1, 3)
    pairs = np.arange(2 * n).reshape(n, 2).tolist()
    around = {"box": 3 * [edge], "boundary": rb.ReactionField(cutoff=arguments.cutoff or min(3.0, 0.3 * edge))}
    around |= {"strength": (arguments.scale * MU2) ** 0.5, "epsilon": arguments.scale, "attraction": 1.0}
    kernels = ["openmm"] + ["bonds"] * (n <= 1000)

    def built(kernel, *where):
        return evaluating([soft_dipole_force(pairs, length=0.5, kernel=kernel, **around)], sites, edge, *where)

    exact = on_bodies(built("compiled", "Reference"), centres, sites)
    contexts = {kernel: built(kernel, arguments.platform, precision) for kernel in kernels}
    for kernel, (least, median) in times_of(contexts, arguments.rounds, arguments.clock).items():
        force, torque = map(relative_error, on_bodies(contexts[kernel], centres, sites), exact)
        yield {
            "energies scaled by": arguments.scale,
            "kernel": kernel,
            "force error": force,
            "torque error": torque,
            "clock": arguments.clock,
            "ms": least,
            "median ms": median,
        }


def rods(n, arguments, precision):
    """Yield a row for each tolerance and length."""
    centres, u, edge = liquid(n)
    cutoff = arguments.cutoff or min(3.0, 0.4 * edge)
    pairs = np.arange(2 * n).reshape(n, 2).tolist()
    around = {"box": 3 * [edge], "strength": MU2**0.5, "epsilon": 0.0}
    sites = np.stack([centres, centres + 0.5 * u], axis=1).reshape(-1, 3)
    exact = soft_dipole_force(
        pairs, length=0.5, kernel="compiled", boundary=rb.Ewald(cutoff=cutoff, tolerance=1e-10), **around
    )
    forces, torques = on_bodies(evaluating([exact], sites, edge, "Reference"), centres, sites)
    for tolerance in (1e-2, 1e-3, 3e-4, 1e-4):
        boundary = rb.Ewald(cutoff=cutoff, tolerance=tolerance)
        own = rod_length(n, around["box"], boundary)
        for length in (0.3 * own, own, 3.0 * own) if tolerance == 1e-3 else (own,):
            ends = np.stack([centres + 0.5 * length * u, centres - 0.5 * length * u], axis=1).reshape(-1, 3)
            middles = list(range(2 * n, 3 * n))
            parts = dipole_rod_forces(pairs, 3 * n, length=length, boundary=boundary, centres=middles, **around)
            context = evaluating(parts, np.concatenate([ends, centres]), edge, arguments.platform, precision)
            force, torque = on_bodies(context, centres, ends)
            yield {
                "tolerance": tolerance,
                "length (sigma)": length,
                "mesh": parts[0].getPMEParameters()[1],
                "force error": relative_error(force, forces),
                "torque error": relative_error(torque, torques),
            }


if __name__ == "__main__":
    main()
