"""Time and errors of an evaluation of N dipoles by rb.Ewald, by its direct sum and by LAMMPS: CSV and picture.

The liquid is a Stockmayer fluid at density 0.822, kT = 1.15 and mu² = 3, with spheres on a lattice with random
displacements and directions. Errors are root mean squares of the errors of forces and torques, relative to those of the
forces and torques, with an independent sum at 1e-12 as the reference (nufft_ewald.py, which needs finufft). Times are
the smallest over rounds in which all candidates alternate: processor times on one core, wall times on several cores.

rb.Ewald has a row for each tolerance. LAMMPS, if it is installed, runs pair_style lj/cut/dipole/long and pppm/dipole.
Its splitting follows from the error of its pairs, and its mesh is refined until forces and torques reach each level of
error, for several cutoffs and orders. A row contains the fastest of these settings; for samples below 2000 dipoles,
ewald/dipole is tried too. Samples above 8000 dipoles use the settings that were fastest for 8000, with the same mesh
spacing. The spheres do not interact in LAMMPS, and a step is one evaluation. "level" is the smallest level of error
that forces and torques both reach; rows of the same level are comparable.
"""

from __future__ import annotations

import argparse
import itertools
import math
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

import openmm_exactrb as rb
from benchmarks.common import lammps_peer, records
from benchmarks.common.clocks import timed
from benchmarks.common.pictures import plt
from benchmarks.common.stockmayer import MU2, edge_of, relative_error
from benchmarks.dipoles import nufft_ewald
from openmm_exactrb.potentials import SoftDipoles, ewald_errors
from openmm_exactrb.potentials.compiled.mesh import fast_size

SEARCHED = 8000  # the most dipoles for which settings of LAMMPS are searched
DIRECT = 4096  # the most dipoles of which the direct sum is timed
LEVELS = (1e-3, 1e-4, 1e-5)
TOLERANCES = (3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 1e-6)
OURS, SUM, PEER = "rb.Ewald", "direct sum", "LAMMPS"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("-n", type=int, nargs="*", default=[125, 512, 1000, 4096, 8000, 27000], help="numbers of dipoles")
    add("--rounds", type=int, default=7, help="%(default)s")
    add("--cores", type=int, nargs="*", default=[1], help="of rb.Ewald (1)")
    add("--peer", type=int, nargs="*", default=[1000, 8000, 27000], help="numbers of dipoles for LAMMPS")
    add("--cutoffs", type=float, nargs="*", default=[3.0, 4.0, 5.0], help="of LAMMPS, sigma (3 4 5)")
    add("--csv", type=Path, default=records.RECORDS / "dipole_scale.csv", help="%(default)s")
    add("--draw", action="store_true", help="only draw what the file has")
    arguments = parser.parse_args()
    if not arguments.draw:
        old = [row for row in records.read(arguments.csv) if int(row["n"]) not in arguments.n]
        for n in arguments.n:
            like = [row["settings"] for row in old if row["who"] == PEER and int(row["n"]) == SEARCHED]
            old = sorted(old + measure(n, arguments, like if n > SEARCHED else []), key=lambda row: int(row["n"]))
            records.write(arguments.csv, list(old[0]), old)  # after each: the last take long
    draw(records.read(arguments.csv), records.picture_of(arguments.csv))


def liquid(n):
    """Return centres and dipoles (n, 3), and the edge of the box."""
    rng = np.random.default_rng(1)
    side, box = round(n ** (1 / 3)), edge_of(n)
    R = (np.argwhere(np.ones((side, side, side))) + 0.5 + 0.05 * rng.standard_normal((n, 3))) * box / side
    u = rng.standard_normal((n, 3))
    return R, MU2**0.5 * u / np.linalg.norm(u, axis=1, keepdims=True), box


def measure(n, arguments, like):
    """Return the rows of all contenders, LAMMPS with settings like these if there are any."""
    R, u, box = liquid(n)
    _, forces, fields = nufft_ewald.dipole_sum(R, u, box)
    exact = forces, np.cross(u, fields)
    contenders = []  # who, cores, tolerance, settings, errors, run
    for tolerance, method in [(t, "auto") for t in TOLERANCES] + [(1e-4, "direct")] * (n <= DIRECT):
        boundary = rb.Ewald(tolerance=tolerance, method=method)
        errors = apart(parts(evaluation(boundary, R, u, box, 1, 0.0)(), u), exact)
        who, settings = (OURS if method == "auto" else SUM), described(boundary.getParameters(n, 3 * [box]))
        for cores in arguments.cores:
            run = evaluation(boundary, R, u, box, cores, 4.0)
            contenders.append((who, cores, tolerance, settings, errors, run))
    if lammps_peer.INSTALLED and n in arguments.peer:
        samples = R, u, box, exact
        peers = scaled_peers(*samples, like) if like else fastest_peers(*samples, arguments.cutoffs)
        contenders += [(PEER, 1, "", *found) for found in peers]
    best = [math.inf] * len(contenders)
    for _ in range(arguments.rounds):
        for i, (_, cores, *_, run) in enumerate(contenders):
            best[i] = min(best[i], timed(run, time.process_time if cores == 1 else time.perf_counter))
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:  # without the others' memory
        memory = pool.submit(peak, n).result()
    rows = []
    for (who, cores, tolerance, settings, errors, _), seconds in zip(contenders, best, strict=True):
        rows.append(
            {
                "n": n,
                "who": who,
                "cores": cores,
                "tolerance": tolerance,
                "settings": settings,
                "ms": round(1e3 * seconds, 3),
                "force_error": f"{errors[0]:.2e}",
                "torque_error": f"{errors[1]:.2e}",
                "level": min((level for level in LEVELS if max(errors) <= level), default=""),
                "process_MB": memory if who == OURS and tolerance == 1e-4 else "",
            }
        )
        print(*rows[-1].values(), sep="  ", flush=True)
    return rows


def described(chosen):
    if chosen.method == "direct":
        return f"direct, cutoff {chosen.cutoff:.2f}"
    return f"mesh {chosen.points[0]}, order {chosen.order}, cutoff {chosen.cutoff:.2f}"


def evaluation(boundary, R, u, box, threads, repulsion):
    """Return a function that evaluates energy and forces."""
    n, edges = len(R), (box, box, box)
    kernel = SoftDipoles(boundary.truncation(edges, n), boundary.images(n, edges))
    sites = np.stack([R, R + u], axis=1).reshape(-1, 3)
    parameters = {"soft_repulsion": repulsion, "soft_attraction": repulsion, "dipole_coupling": 1.0}

    def run():
        return kernel.energy_and_forces(sites, parameters, np.diag(edges), threads)[1]

    run()
    return run


def peak(n):
    """Return the most memory (MB) of a process that evaluates n dipoles with a tolerance of 1e-4."""
    evaluation(rb.Ewald(), *liquid(n), 1, 4.0)
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()  # getrusage has the parent's peak too
    return round(int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024)


def parts(forces, u):
    """Return forces and torques of the dipoles."""
    return forces[0::2] + forces[1::2], np.cross(u, forces[1::2])


def apart(found, exact):
    """Return the errors of forces and torques."""
    return tuple(map(relative_error, found, exact))


def fastest_peers(R, u, box, exact, cutoffs):
    """Return settings, errors and a run of the fastest LAMMPS for each level of error."""
    distance, found = (box**3 / len(R)) ** (1 / 3), {}
    for level, order, cutoff in itertools.product(LEVELS, (7, 5), cutoffs):
        if cutoff > 0.5 * box:
            continue
        alpha = ewald_errors.widest_splitting(cutoff, 0.999 * cutoff, distance, 0.5 * level)
        for step in (0.65, 0.5, 0.4, 0.32, 0.25, 0.2):  # of the mesh, in widths of the Gaussians
            points = fast_size(alpha * box / step)
            mesh = f"kspace_modify mesh {points} {points} {points} order {order} gewald {alpha:.4f}"
            error, seconds = consider(found, exact, (R, u, box, "pppm", 1e-3, cutoff, mesh))
            if error <= level or seconds > 1.3 * found.get(level, (math.inf,))[0]:  # finer ones are slower
                break
    for accuracy, cutoff in itertools.product((1e-2, 1e-3, 1e-4), (*cutoffs, 0.5 * box)) if len(R) < 2000 else ():
        consider(found, exact, (R, u, box, "ewald", accuracy, cutoff, ""))
    return list({each[1]: each[1:] for each in found.values()}.values())


def scaled_peers(R, u, box, exact, like):
    """Return settings, errors and a run of LAMMPS for each of some settings, with their cutoffs and mesh spacings."""
    found = {}
    for words in like:
        _, _, cutoff, _, points, _, _, _, order, _, alpha = words.replace(",", "").split()
        points = fast_size(int(points) * box / edge_of(SEARCHED))
        mesh = f"kspace_modify mesh {points} {points} {points} order {order} gewald {alpha}"
        consider(found, exact, (R, u, box, "pppm", 1e-3, float(cutoff), mesh))
    return list({each[1]: each[1:] for each in found.values()}.values())


def consider(found, exact, setting):
    """Keep a LAMMPS for the levels that it reaches faster than any before; return its larger error and its time."""
    lmp, values = peer(*setting)
    errors = apart(values, exact)

    def run():
        lmp.command("run 1 pre no post no")

    seconds = min(timed(run, time.process_time) for _ in range(2))
    *_, kspace, accuracy, cutoff, mesh = setting
    words = f"{kspace}/dipole, cutoff {cutoff:.2f}, " + (
        mesh.removeprefix("kspace_modify ") or f"accuracy {accuracy:g}"
    )
    print(f"  {words}: {errors[0]:.1e} {errors[1]:.1e}, {1e3 * seconds:.1f} ms", flush=True)
    for level in LEVELS:
        if max(errors) <= level and seconds < found.get(level, (math.inf,))[0]:
            found[level] = seconds, words, errors, run
    return max(errors), seconds


def peer(R, u, box, kspace, accuracy, cutoff, mesh):
    """Return a LAMMPS and its forces and torques."""
    lmp = lammps_peer.dipoles(
        R,
        u,
        f"""
        pair_style lj/cut/dipole/long {cutoff} {cutoff}
        pair_coeff * * 0.0 1.0
        kspace_style {kspace}/dipole {accuracy}
        {mesh}
        """,
        box=box,
    )
    lmp.commands_string("fix motion all nve/sphere update dipole\ntimestep 1e-9\nrun 0")
    order = np.argsort(lmp.numpy.extract_atom("id")[: len(R)])
    return lmp, tuple(lmp.numpy.extract_atom(name)[: len(R)][order].copy() for name in ("f", "torque"))


def draw(rows, file):
    """Draw cost against N at one level of error, and errors against the tolerance."""
    figure, (upper, lower) = plt.subplots(2, figsize=(5.6, 7.8), layout="constrained")
    for who, colour in ((OURS, "#0072B2"), (SUM, "#D55E00"), (PEER, "#009E73")):
        points = {}
        for row in rows:
            if row["who"] == who and row["cores"] == "1" and row["level"] and float(row["level"]) <= 1e-4:
                n = int(row["n"])
                points[n] = min(points.get(n, math.inf), float(row["ms"]))
        upper.loglog(*zip(*sorted(points.items()), strict=True), "o-", color=colour, label=who)
    upper.set(xlabel="number of dipoles", ylabel="time of an evaluation (ms)")
    upper.set_title("One core, errors of forces and torques up to 1e-4", fontsize=11)
    for n, colour in ((125, "#0072B2"), (1000, "#D55E00"), (8000, "#009E73"), (27000, "#CC79A7")):
        ours = [row for row in rows if row["who"] == OURS and int(row["n"]) == n and row["cores"] == "1"]
        tolerances = [float(row["tolerance"]) for row in ours]
        lower.loglog(tolerances, [float(row["force_error"]) for row in ours], "o-", color=colour, label=f"{n} dipoles")
        lower.loglog(tolerances, [float(row["torque_error"]) for row in ours], "s--", color=colour, mfc="none")
    lower.loglog([1e-6, 3e-3], [1e-6, 3e-3], color="0.5", lw=1.0)
    lower.annotate("tolerance", (1.2e-6, 2.2e-6), rotation=36, color="0.4", fontsize=9)
    lower.set(xlabel="tolerance of rb.Ewald", ylabel="error, relative to the root mean square")
    lower.set_title("Forces (filled) and torques (open)", fontsize=11)
    for axes in (upper, lower):
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize=9)
    figure.savefig(file, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    main()
