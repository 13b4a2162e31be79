"""What an Ewald sum of dipoles costs for a given error: ours and LAMMPS's, on the same liquid, in turns.

The liquid is a Stockmayer fluid at density 0.822, kT = 1.15 and mu² = 3. The error is that of the torques, root mean
square, as a part of theirs, against our sum at a tolerance of 1e-13, which the tests compare with a plain sum and with
OpenMM's AMOEBA. LAMMPS (pair_style lj/cut/dipole/long, fix nve/sphere update dipole, one core) may choose: ewald/dipole
or pppm/dipole (with accuracies of 1e-2 and 1e-3: finer meshes take minutes to set up and were slower than the sum), the
accuracy, and the cutoff: half the box, or 3, 4 or 5 sigma. Its column is the fastest that reaches the error. Times are
the least of the rounds, of a stage of S6_10 with everything in it and of a step of LAMMPS, also one force evaluation
each. Raw data go to out/benchmarks/ewald_cost.json.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path

import numba
import numpy as np
import openmm
from openmm import unit

import lammps_peer
import openmm_exactrb as rb
from openmm_exactrb.kernels import threads

OUT = Path("out/benchmarks")
DENSITY, KT, MU2 = 0.822, 1.15, 3.0
KB = unit.MOLAR_GAS_CONSTANT_R.value_in_unit(unit.kilojoule_per_mole / unit.kelvin)
STAGES = rb.SCHEMES["S6_10"].stages
ERRORS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
CORES = threads.cores()
REFERENCE = openmm.Platform.getPlatform("Reference")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("-n", type=int, nargs="*", default=[125, 512, 1000], help="numbers of dipoles (125 512 1000)")
    add("--rounds", type=int, default=5, help="%(default)s")
    arguments = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    table = {n: measure(n, arguments.rounds) for n in arguments.n}
    data = OUT / "ewald_cost.json"
    old = json.loads(data.read_text()) if data.exists() else {}
    data.write_text(json.dumps(old | {str(n): rows for n, rows in table.items()}, indent=1))
    report(table)


def measure(n, rounds):
    """Return label, error of the torques and times (s) of every contender."""
    context, _ = liquid(n, 1e-13)
    state = context.getState(positions=True, velocities=True)
    exact = torques(context, n)
    contenders, contexts = {}, [context]  # an integrator does not keep its Context
    for tolerance in ERRORS:
        ours, integrator = liquid(n, tolerance)
        ours.setState(state)
        for cores in (1, CORES):
            name = f"ours on {cores}, tolerance {tolerance:g}"
            contenders[name] = error(torques(ours, n), exact), stages(integrator, cores)
        contexts.append(ours)
    if lammps_peer.INSTALLED:
        x = sites(context, n)
        places = x[:, -2], 2.0 * MU2**0.5 * (x[:, -1] - x[:, -2])
        choices = [("ewald", accuracy) for accuracy in ERRORS] + [("pppm", accuracy) for accuracy in ERRORS[:2]]
        for (kspace, accuracy), cutoff in itertools.product(choices, cutoffs(n)):
            lmp = peer(n, places, kspace, accuracy, cutoff)
            found = torques_of(lmp, n)
            contenders[f"LAMMPS, {kspace}/dipole {accuracy:g}, cutoff {cutoff:.2f}"] = error(found, exact), step(lmp)
    evaluations = STAGES * max(1, 20_000 // (n * STAGES))
    times = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, (_, run) in contenders.items():
            start = time.perf_counter()
            run(evaluations)
            times[name].append((time.perf_counter() - start) / evaluations)
    return {name: {"error": contenders[name][0], "rounds_s": times[name]} for name in contenders}


def liquid(n, tolerance):
    """Return the Context and the integrator of a liquid that has molten."""
    _, system, positions = rb.dipole_fluid(
        n,
        dipole=(0.0, 0.0, MU2**0.5),
        inertia=(0.2, 0.2, 0.2),
        attraction=1.0,
        boundary=rb.Ewald(tolerance=tolerance),
        density=DENSITY,
    )
    integrator = rb.ExactRigidBodyIntegrator(0.005, scheme="S6_10")
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    integrator.setVelocitiesToTemperature(KT / KB, 1)
    if tolerance == 1e-13:
        return molten(n, context, integrator)
    integrator.step(1)
    return context, integrator


def molten(n, context, integrator):
    """Run the liquid with a rough sum, and put it into this Context."""
    rough, mover = liquid(n, 1e-3)
    for k in range(4):
        mover.setVelocitiesToTemperature(KT / KB, k)
        mover.step(100)
    context.setState(rough.getState(positions=True, velocities=True))
    return context, integrator


def sites(context, n):
    """Return the sites (n, k, 3) of all spheres; the last two are centre and tip of the dipole."""
    return context.getState(positions=True).getPositions(asNumpy=True)._value.reshape(n, -1, 3)


def torques(context, n):
    """Return the torques (n, 3), from the forces on the sites with mass."""
    x = sites(context, n)
    forces = context.getState(forces=True).getForces(asNumpy=True)._value.reshape(x.shape)
    return np.cross(x[:, :-2] - x[:, -2:-1], forces[:, :-2]).sum(axis=1)


def error(found, exact):
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def stages(integrator, cores):
    def run(evaluations):
        numba.config.NUMBA_NUM_THREADS = cores
        integrator.step(evaluations // STAGES)

    return run


def edge(n):
    return (n / DENSITY) ** (1.0 / 3.0)


def cutoffs(n):
    return [0.5 * edge(n), 3.0, 4.0, 5.0]


def peer(n, places, kspace, accuracy, cutoff):
    """Return a LAMMPS with the same dipoles, after one evaluation."""
    lmp = lammps_peer.dipoles(
        *places,
        f"""
        pair_style lj/cut/dipole/long {cutoff} {cutoff}
        pair_coeff * * 1.0 1.0
        kspace_style {kspace}/dipole {accuracy}
        """,
        box=edge(n),
    )
    lmp.commands_string(
        """
        velocity all create 1.15 1
        fix motion all nve/sphere update dipole
        timestep 0.001
        run 0
        """
    )
    return lmp


def torques_of(lmp, n):
    order = np.argsort(lmp.numpy.extract_atom("id")[:n])
    return lmp.numpy.extract_atom("torque")[:n][order].copy()


def step(lmp):
    return lambda evaluations: lmp.command(f"run {evaluations} pre no post no")


def report(table):
    """Print what the fastest costs that reaches an error, in ms, and ratios on one core."""
    for n, rows in table.items():
        who = ["ours on 1", f"ours on {CORES}", "LAMMPS"]
        print(f"\nN = {n:<8}" + "".join(f"{name:>14}" for name in who) + f"{'ratio':>10}   LAMMPS with")
        for wanted in ERRORS:
            best = dict.fromkeys(who, (np.nan, "none reaches it"))
            for name, row in rows.items():
                contender, settings = name.split(", ", 1)
                if row["error"] <= wanted and not min(row["rounds_s"]) >= best[contender][0]:
                    best[contender] = min(row["rounds_s"]), settings
            times = [best[name][0] for name in who]
            print(
                f"  {wanted:<8g}  "
                + "".join(f"{1e3 * seconds:>14.3f}" for seconds in times)
                + f"{times[0] / times[2]:>10.2f}   {best['LAMMPS'][1]}"
            )


if __name__ == "__main__":
    main()
