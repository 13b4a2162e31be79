"""What an evaluation of N dipoles costs by rb.Ewald, beside its direct sum and LAMMPS, and its error: CSV and picture.

The liquid is a Stockmayer fluid at density 0.822, kT = 1.15 and mu² = 3, spheres on a lattice with random displacements
and directions. Errors are root mean square of forces and torques of the dipoles, as a part of theirs, against a
tolerance of 1e-10. Times are the least of the rounds, all contenders in turns. LAMMPS (one core, where it is installed)
may choose between ewald/dipole and pppm/dipole, cutoffs of 3, 4 and 5 sigma and two accuracies; a step is one
evaluation, with the motion of the spheres, and only its torques are compared.
"""

from __future__ import annotations

import argparse
import csv
import resource
import time
from pathlib import Path

import numpy as np

import lammps_peer
import openmm_exactrb as rb
from openmm_exactrb.potentials import SoftDipoles

DENSITY, MU2 = 0.822, 3.0
DIRECT, EXACT = 4096, 8000  # the most dipoles of which the direct sum is timed, and taken as exact


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("-n", type=int, nargs="*", default=[125, 512, 1000, 4096, 8000, 27000], help="numbers of dipoles")
    add("--tolerance", type=float, default=1e-4, help="%(default)s")
    add("--rounds", type=int, default=5, help="%(default)s")
    add("--cores", type=int, nargs="*", default=[1], help="of rb.Ewald (1)")
    add("--peer", type=int, default=1000, help="most dipoles of LAMMPS, whose setup takes minutes (%(default)s)")
    add("--csv", type=Path, default=Path("docs/dipole_scale.csv"), help="%(default)s")
    arguments = parser.parse_args()
    rows = [row for n in arguments.n for row in measure(n, arguments)]
    with arguments.csv.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    draw(rows, arguments.csv.with_suffix(".png"))


def liquid(n):
    """Return centres and dipoles (n, 3), and the edge of the box."""
    rng = np.random.default_rng(1)
    side, box = round(n ** (1 / 3)), (n / DENSITY) ** (1 / 3)
    R = (np.argwhere(np.ones((side, side, side))) + 0.5 + 0.05 * rng.standard_normal((n, 3))) * box / side
    u = rng.standard_normal((n, 3))
    return R, MU2**0.5 * u / np.linalg.norm(u, axis=1, keepdims=True), box


def measure(n, arguments):
    """Return a row for each contender."""
    R, u, box = liquid(n)
    exact = (
        parts(evaluation(rb.Ewald(tolerance=1e-10, method="direct"), R, u, box, 2, 0.0)(), u) if n <= EXACT else None
    )
    contenders, errors = {}, {}
    for method in ("auto", "direct")[: 1 + (n <= DIRECT)]:
        boundary = rb.Ewald(tolerance=arguments.tolerance, method=method)
        chosen = boundary.getParameters(n, 3 * [box])
        print(n, method, chosen, flush=True)
        for cores in arguments.cores:
            name = f"{method}, {cores} core" + "s" * (cores > 1)
            contenders[name] = evaluation(boundary, R, u, box, cores, 4.0)
        errors[method] = error(parts(evaluation(boundary, R, u, box, 2, 0.0)(), u), exact)
    if lammps_peer.INSTALLED and n <= arguments.peer:
        for kspace, accuracy, cutoff in CHOICES:
            if cutoff < 0.5 * box:
                name = f"LAMMPS {kspace} {accuracy:g} cutoff {cutoff:g}"
                torques, contenders[f"{name}, 1 core"] = peer(R, u, box, kspace, accuracy, cutoff)
                errors[name] = np.nan, error((torques,), exact[1:])[0] if exact else np.nan
    best = dict.fromkeys(contenders, np.inf)
    for _ in range(arguments.rounds):
        for name, run in contenders.items():
            start = time.perf_counter()
            run()
            best[name] = min(best[name], time.perf_counter() - start)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    rows = []
    for name, seconds in best.items():
        force, torque = errors.get(name.split(",")[0], (np.nan, np.nan))
        rows.append(
            {
                "n": n,
                "who": name,
                "ms": round(1e3 * seconds, 3),
                "force_error": f"{force:.2e}",
                "torque_error": f"{torque:.2e}",
                "process_MB": round(memory),
            }
        )
        print(*rows[-1].values(), sep="  ", flush=True)
    return rows


CHOICES = [(k, a, c) for k in ("pppm", "ewald") for a in (1e-2, 1e-3) for c in (3.0, 4.0, 5.0)]


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


def parts(forces, u):
    """Return forces and torques of the dipoles."""
    return forces[0::2] + forces[1::2], np.cross(u, forces[1::2])


def error(found, exact):
    """Return the errors of forces and torques, or no numbers where nothing is exact."""
    if exact is None:
        return np.nan, np.nan
    return tuple(float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in zip(found, exact, strict=True))


def peer(R, u, box, kspace, accuracy, cutoff):
    """Return the torques by LAMMPS, and a step of it."""
    lmp = lammps_peer.dipoles(
        R,
        u,
        f"""
        pair_style lj/cut/dipole/long {cutoff} {cutoff}
        pair_coeff * * 1.0 1.0
        kspace_style {kspace}/dipole {accuracy}
        """,
        box=box,
    )
    lmp.commands_string("fix motion all nve/sphere update dipole\ntimestep 1e-6\nrun 0")
    order = np.argsort(lmp.numpy.extract_atom("id")[: len(R)])
    torques = lmp.numpy.extract_atom("torque")[: len(R)][order].copy()
    return torques, lambda: lmp.command("run 1 pre no post no")


def draw(rows, file):
    """Draw cost against N."""
    import matplotlib.pyplot as plt

    fastest = {}
    for row in rows:
        who = "LAMMPS, 1 core, fastest setting tried" if row["who"].startswith("LAMMPS") else f"rb.Ewald, {row['who']}"
        key = who, row["n"]
        fastest[key] = min(fastest.get(key, np.inf), row["ms"])
    figure, axes = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
    for who in dict.fromkeys(who for who, _ in fastest):
        n = [n for name, n in fastest if name == who]
        axes.loglog(n, [fastest[who, m] for m in n], "o-", label=who)
    axes.set(xlabel="number of dipoles", ylabel="ms for an evaluation")
    axes.legend(fontsize=8)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
