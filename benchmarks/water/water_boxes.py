"""Rigid water in a periodic box with PME: the energy error over 30 ps, compared with OpenMM's Verlet at equal cost.

216 molecules of each model run on the CPU platform, whose forces have single precision. A switch before the cutoff and
a tight Ewald tolerance make the errors of the forces small compared with those of the integrator; --loose uses the
defaults of createSystem instead. Each seed has a separate start, which all methods share, drawn from the canonical
distribution with LangevinMiddleIntegrator. A run is a job of an ensemble, so that an interrupted command can be
resumed. Results are written to out/water_boxes: a table (CSV), to which --record gives another file whose other rows
stay, and `energy.png`, the energy of the first model over time with the first two methods.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from benchmarks.common import records
from benchmarks.common.energies import along, variance
from benchmarks.common.pictures import plt
from benchmarks.common.provenance import OF_RUN, of_run, of_runs
from benchmarks.common.starts import canonical, context_of, put, thermostat
from openmm_exactrb import ensemble

OUT = Path("out/water_boxes")
MODELS = ("tip3p", "spce", "tip4pew", "tip5p")
VERLET = "Verlet"
WINDOWS = (2.0, 10.0, 30.0)  # ps
SAMPLED = 0.1  # ps
POINT = ("model", "forces_per_ps", "method", "starts")
STDS = tuple(f"{what}_{window:g}_ps" for window in WINDOWS for what in ("std", "error"))


def water(n: int, model: str, integrator: openmm.Integrator, loose: bool = False) -> openmm.Context:
    """Return water on a lattice."""
    smooth = {} if loose else {"switchDistance": 0.75, "ewaldErrorTolerance": 1e-5}
    _, system, positions = rb.rigid_water(n, model=model, nonbondedMethod=app.PME, nonbondedCutoff=0.85, **smooth)
    return context_of(system, integrator, positions)


def energies_of(model: str, method: str, rate: float, duration: float, seed: int, n: int, loose: bool = False) -> dict:
    """Run water and return its total energy in kJ/mol per molecule, every 0.1 ps, and where it comes from."""
    if method == VERLET:
        integrator = openmm.VerletIntegrator(1.0 / rate)
        integrator.setConstraintTolerance(1e-8)
    else:
        integrator = rb.ExactRigidBodyIntegrator(rb.SCHEMES[method].forces / rate, scheme=method)
    context = water(n, model, integrator, loose)
    (start,) = canonical(water(n, model, thermostat(seed=seed)), 2_500, seed=seed)
    put(context, start)
    energies, interval = along(context, duration, SAMPLED)
    if not np.isfinite(energies).all():
        raise rb.NonFiniteError(f"{method} diverged")
    return {"interval": interval, "energies": (energies / n).tolist(), "origin": of_run(context)}


def spread(runs: list[dict], window: float) -> tuple[float, float]:
    """Return the standard deviation of the energy within windows, over all runs, and its error between the runs."""
    variances = [variance(run["energies"], run["interval"], window) for run in runs]
    mean = np.mean(variances)
    error = np.std(variances, ddof=1) / np.sqrt(len(variances)) if len(variances) > 1 else np.nan
    return float(np.sqrt(mean)), float(error / (2 * np.sqrt(mean)))


def main() -> None:
    args = parse()
    points = list(itertools.product(args.models, args.rates, args.methods))
    fixed = {"duration": args.picoseconds, "n": args.molecules} | ({"loose": True} if args.loose else {})
    jobs = {
        point: [
            ensemble.Job(energies_of, model=point[0], rate=point[1], method=point[2], seed=seed, **fixed)
            for seed in range(1, args.starts + 1)
        ]
        for point in points
    }
    results = ensemble.run([r for some in jobs.values() for r in some], args.out / "runs", workers=args.workers)
    by_key = {result.job.key: result for result in results}
    record = records.Record(args.record or args.out / "table.csv", POINT, ("failed", *STDS, *OF_RUN))
    rows, found = [], {}
    for point, some in jobs.items():
        runs = [by_key[job.key] for job in some]
        found[point] = [run.value for run in runs if run.error is None]
        failed = len(runs) - len(found[point])
        row = [*point, len(found[point]), failed]
        for window in WINDOWS:
            row += spread(found[point], window) if found[point] and window <= args.picoseconds else (np.nan, np.nan)
        rows.append(row)
        named = dict(zip((*POINT, "failed"), row[:5], strict=True))
        stds = {name: f"{number:.4g}" for name, number in zip(STDS, row[5:], strict=True)}
        record.add(named | stds | of_runs(run["origin"] for run in found[point]))
    show(rows)
    first = (args.models[0], args.rates[0])
    draw({method: found[*first, method][0] for method in args.methods[:2]}, *first, args.out / "energy.png")


def show(rows: list[list]) -> None:
    """Print the table with how many times each lies below Verlet's."""
    verlet = {tuple(row[:2]): row[5::2] for row in rows if row[2] == VERLET}
    for model, rate, method, n_starts, failed, *numbers in rows:
        theirs = verlet.get((model, rate), [np.nan] * len(WINDOWS))
        measured = [*zip(numbers[::2], theirs, WINDOWS, strict=True)]
        measured = [one for one in measured if np.isfinite(one[0])]
        shown = ", ".join(f"{std:.2e} in {w:g} ps" for std, _, w in measured)
        times = measured[-1][1] / measured[-1][0] if measured else np.nan
        print(f"{model} {rate:g} per ps {method}: {shown}, {times:.1f} times less ({n_starts} starts, {failed} failed)")


def draw(runs: dict[str, dict], model: str, rate: float, file: Path) -> None:
    """Draw the total energy less its mean, in J/mol per molecule."""
    figure, axes = plt.subplots(figsize=(7.5, 3.6), layout="constrained")
    for (method, run), colour in zip(runs.items(), ("#E69F00", "#0072B2"), strict=False):
        energies = 1000.0 * np.array(run["energies"])
        time = run["interval"] * np.arange(1, len(energies) + 1)
        name = "OpenMM's VerletIntegrator" if method == VERLET else f"ExactRigidBodyIntegrator, {method}"
        width = 0.5 if method == VERLET else 1.2
        label = f"{name}: standard deviation {energies.std():.2g} J/mol"
        axes.plot(time, energies - energies.mean(), color=colour, lw=width, label=label)
    axes.set_xlabel("time (ps)")
    axes.set_ylabel("total energy − mean\n(J/mol per molecule)")
    axes.set_title(f"{model.upper()} in a periodic box, one force evaluation every {1000.0 / rate:g} fs", fontsize=10)
    axes.margins(x=0.01)
    legend = figure.legend(loc="outside lower center", ncols=1, frameon=False)
    for line in legend.get_lines():
        line.set_linewidth(2.5)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--models", nargs="+", choices=MODELS, default=MODELS, metavar="NAME", help=", ".join(MODELS))
    add("--rates", nargs="+", type=float, default=[500.0], metavar="RATE", help="force evaluations per ps")
    methods = [VERLET, "W4_4", "W2_1", "W2_5", "S2_2"]
    add("--methods", nargs="+", choices=[VERLET, *rb.SCHEMES], default=methods, metavar="NAME", help="%(default)s")
    add("--starts", type=int, default=3, help="runs of each, each from a start of its own (%(default)s)")
    add("--picoseconds", type=float, default=30.0, help="length of a run (%(default)s)")
    add("--molecules", type=int, default=216)
    add("--loose", action="store_true", help="OpenMM's defaults: no switch, an ewaldErrorTolerance of 5e-4")
    add("--workers", type=int, default=None, help="processes; one for each core unless given")
    add("--out", type=Path, default=OUT, metavar="FOLDER", help="%(default)s")
    add("--record", type=Path, metavar="CSV", help="a table that gains these rows (table.csv in the folder)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
