"""Figure 17 of the paper: 125 soft dipolar spheres, averages of the energy error over 100 starts.

The methods are V2, SRKN4_6b and S6_10, each with the exact rotor and with McLachlan-Reich, over T = 1. The step sizes
of S6_10 are 1, 1/2, 1/4 and 1/8. Those of the other schemes divide T and need similar numbers of force evaluations (see
the table). The abscissa is the number of force evaluations, which is proportional to the paper's computational time and
does not depend on the machine.

The paper states neither its energies, nor the lattice constant, nor the directions of the momenta of the two corner
particles. Here the lattice constant is 3, and the momenta are opposite and point outward along the diagonal. The
energies are 4 (above the largest potential energy of the 100 starts, 3.18), 20, 100 and 1000. The positions in
the paper (q_1 = [1, 1, 1], q_125 = [5, 5, 5], sigma = 1) imply a lattice constant of 1. The mean potential energy is
then 1245, the spheres fly apart, and with the two largest steps the energy grows by at least eight orders of magnitude
with every method (options `--spacing 1 --energies 1400 2000 5000 20000 --starts 3`).
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from functools import lru_cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import openmm

import openmm_exactrb as rb
from benchmarks.paper import common
from benchmarks.paper.claims import Claim, Criterion
from openmm_exactrb import ensemble

NAME = "figure17"
TITLE = "Figure 17: dipoles at different energies, 100 starts"
PICTURES = {
    "figure17": "Four panels, one for each energy. At H0 = 4 the lines of SRKN4_6b and S6_10 with McLachlan-Reich flatten and "
    "end two powers of ten above those with the exact rotor. At H0 = 20 they separate at the shortest steps, and at 100 and "
    "1000 they coincide."
}
OUT = Path("out/paper")
N = 125
DURATION = 1.0
STARTS = 100
SPACING = 3.0
ENERGIES = (4.0, 20.0, 100.0, 1000.0)
FILES = """\
Each run is one job of an ensemble, whose result is a file in out/paper/figure17: the command continues where it stopped.
--quick and other energies or lattice constants do not change docs/."""
#: What a verdict on this figure depends on.
GUESSED = "This holds for our lattice constant and energies, which the paper does not give"
#: Force evaluations of the runs of S6_10 with the steps 1, 1/2, 1/4 and 1/8.
COSTS = (10, 20, 40, 80)
#: The paper's names; its V2 begins with a drift.
SCHEMES = {"V2": "V2_drift", "SRKN4_6b": "SRKN4_6b", "S6_10": "S6_10"}
ROTORS = {"exact": ("-", "exact rotor"), "mclachlan_reich": ("-.", "McLachlan-Reich")}
# Colours that a colour-blind reader can tell apart (Okabe and Ito), with markers of their own.
STYLES = {"V2": ("#0072B2", "^"), "SRKN4_6b": ("#D55E00", "x"), "S6_10": ("#009E73", "o")}
AVERAGES = ("energy", "scheme", "rotor", "steps", "evaluations", "starts", "failed", "mean_error", "max_error")


@lru_cache(maxsize=1)
def system(spacing):
    """Return the System, which is the same for all starts."""
    return rb.dipole_fluid(N, 0, spacing=spacing)[1]


@lru_cache(maxsize=2)
def positions(seed, spacing):
    """Return the positions of a start."""
    return rb.dipole_fluid(N, seed, spacing=spacing)[2]


def one_run(seed, energy, scheme, rotor, cost, spacing):
    """Return the energy before and after a run, and what it cost."""
    steps = max(1, round(cost * DURATION / rb.SCHEMES[SCHEMES[scheme]].stages))
    integrator = rb.ExactRigidBodyIntegrator(DURATION / steps, scheme=SCHEMES[scheme], rotor=rotor)
    context = openmm.Context(system(spacing), integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions(seed, spacing))
    push_corners(context, energy)
    first = integrator.totalEnergy()._value
    integrator.timings.reset()
    integrator.step(steps)
    last = integrator.totalEnergy()._value
    return {"first": first, "last": last, "steps": steps, "evaluations": integrator.timings.evaluations}


def push_corners(context, energy):
    """Give the first and the last sphere momenta, outward and opposite, for this total energy; the others rest."""
    potential = context.getState(energy=True).getPotentialEnergy()._value
    if potential > energy:
        raise ValueError(f"the start has the potential energy {potential:.6g}, more than {energy:.6g}")
    velocities = np.zeros((context.getSystem().getNumParticles(), 3))
    sites = len(velocities) // N
    velocities[-sites:] = np.sqrt((energy - potential) / 3.0)  # masses 1: v^2 = E - V for the two of them
    velocities[:sites] = -velocities[-sites:]
    context.setVelocities(velocities)


def jobs(energies, spacing, starts, costs):
    axes = {"seed": range(starts), "energy": energies, "scheme": SCHEMES, "rotor": ROTORS, "cost": costs}
    return ensemble.sweep(one_run, axes, spacing=spacing)


def averages(results):
    """Return the table of arithmetic means over the starts, of |H(T) - H(0)|/|H(0)|."""
    groups = defaultdict(list)
    for result in results:
        wanted = result.job.arguments
        groups[wanted["energy"], wanted["scheme"], wanted["rotor"], wanted["cost"]].append(result.value)
    table = []
    for (energy, scheme, rotor, _), results in groups.items():
        finished = [result for result in results if result is not None]
        errors = [abs(result["last"] / result["first"] - 1.0) for result in finished] or [np.inf]
        steps, evaluations = (finished[0][name] if finished else 0 for name in ("steps", "evaluations"))
        failed = len(results) - len(finished)
        mean, largest = float(np.mean(errors)), max(errors)
        row = (energy, scheme, rotor, steps, evaluations, len(results), failed, mean, largest)
        table.append(dict(zip(AVERAGES, row, strict=True)))
    return table


def compute(quick, *, starts=STARTS, energies=ENERGIES, spacing=SPACING, workers=None, scheduler=None):
    """Run what is missing, and return the averages."""
    starts, energies, costs = (2, ENERGIES[::3], COSTS[:2]) if quick else (starts, energies, COSTS)
    results = ensemble.run(
        jobs(energies, spacing, starts, costs), OUT / "figure17", workers=workers, scheduler=scheduler
    )
    return {"averages": averages(results)}


def of(data, energy, scheme, rotor):
    """Return the averages of one line."""
    return [r for r in data["averages"] if (r["energy"], r["scheme"], r["rotor"]) == (energy, scheme, rotor)]


def energies_of(data):
    return sorted({row["energy"] for row in data["averages"]})


def draw(data):
    """Draw the paper's figure: a panel for each energy."""
    energies = energies_of(data)
    figure, panels = plt.subplots(2, -(-len(energies) // 2), figsize=(6.0, 7.2), layout="constrained", squeeze=False)
    for energy, axes in zip(energies, panels.flat, strict=False):
        for scheme, (colour, marker) in STYLES.items():
            for rotor, (line, name) in ROTORS.items():
                points = of(data, energy, scheme, rotor)
                x, y = ([row[column] for row in points] for column in ("evaluations", "mean_error"))
                hollow = {"markerfacecolor": "none"} if marker != "x" else {}
                axes.loglog(x, y, line, color=colour, marker=marker, lw=1.4, label=f"{scheme}, {name}", **hollow)
        axes.set_title(f"$H_0$ = {energy:g} $\\epsilon$")
        axes.set_xticks(COSTS, [str(cost) for cost in COSTS])
        axes.minorticks_off()
        axes.grid(True, which="major", alpha=0.3)
    for axes in panels[-1]:
        axes.set_xlabel("force evaluations in T = 1\n(reduced units)")
    for axes in panels[:, 0]:
        axes.set_ylabel("mean relative energy error at T")
    starts = max(row["starts"] for row in data["averages"])
    figure.suptitle(f"{N} soft dipolar spheres, mean over {starts} starts")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9)
    yield NAME, figure


def table(data):
    """Return the averages as a table."""
    lines = []
    for energy in energies_of(data):
        for scheme in SCHEMES:
            for rotor in ROTORS:
                points = of(data, energy, scheme, rotor)
                cells = [f"{r['mean_error']:.1e} ({r['evaluations']})" for r in points]
                lines.append((f"{energy:g}", f"{scheme} + {rotor}", *cells, sum(r["failed"] for r in points)))
    steps = len(lines[0]) - 3
    return common.markdown(
        ("H0", "scheme + rotor", *("mean error (evaluations)" for _ in range(steps)), "failed"), lines
    )


def gain(data, energy, scheme):
    """Return how many times less error the exact rotor leaves at the shortest step."""
    exact, other = (of(data, energy, scheme, rotor)[-1]["mean_error"] for rotor in ROTORS)
    return other / exact


def claims(data):
    lowest, *_, highest = energies_of(data)
    low, high = ({s: gain(data, energy, s) for s in ("SRKN4_6b", "S6_10")} for energy in (lowest, highest))
    starts = max(row["starts"] for row in data["averages"])
    yield Claim(
        "For small energies the methods with the exact rotor perform very well.",
        f"means of {starts} starts at H0 = {lowest:g} and the shortest step: with McLachlan-Reich the errors are "
        + ", ".join(f"{g:.3g} times as large for {s}" for s, g in low.items())
        + f". {GUESSED}.",
        tuple(Criterion.of(f"{s}: at least 10 times", g >= 10.0) for s, g in low.items()),
    )
    yield Claim(
        "For higher energies the effect of the exact rotor is less relevant.",
        f"at H0 = {highest:g} the same ratio of errors is "
        + ", ".join(f"{g:.3g} for {s}" for s, g in high.items())
        + f". {GUESSED}.",
        tuple(Criterion.of(f"{s}: less than at H0 = {lowest:g}", high[s] < low[s]) for s in low),
    )


def command():
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=FILES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="two starts, energies and steps")
    parser.add_argument("--starts", type=int, default=STARTS, metavar="N", help="starts to average (%(default)s)")
    parser.add_argument("--energies", type=float, nargs="+", default=ENERGIES, metavar="E", help="energies H0")
    parser.add_argument("--spacing", type=float, default=SPACING, metavar="A", help="lattice constant (%(default)s)")
    parser.add_argument("--workers", type=int, metavar="N", help="processes here (one for each core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="dask scheduler whose workers can import this file")
    args = parser.parse_args()
    own = (args.starts, tuple(args.energies), args.spacing) != (STARTS, ENERGIES, SPACING)
    options = {key: value for key, value in vars(args).items() if key != "quick"}
    common.run(sys.modules[__name__], args.quick, own=own, **options)
    return 0


if __name__ == "__main__":
    from benchmarks.paper.figure17 import command as imported  # under the name by which the workers find the functions

    sys.exit(imported())
