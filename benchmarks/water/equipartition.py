"""Rigid water at constant temperature: the effect of the step size on equipartition, energy and density.

With SETTLE and leapfrog, rigid water deviates from equipartition at every step above 0.5 fs: D. Asthagiri and T. L.
Beck, arXiv:2308.08383. Here OpenMM's LangevinMiddleIntegrator, rigid-body BAOAB and BAOA, W2_3m and W2_4g simulate the
same water with the same time between force evaluations. Optionally, hybrid Monte Carlo is added, which has no step-size
error (--methods hybrid --intervals 4). The results are T_rot - T_tr, the potential energy and, at constant pressure,
the density, each with its error. NoseHoover is OpenMM's NoseHooverIntegrator, and NoseHoover/W2_3m the chains of this
package with that scheme.

T_rot of LangevinMiddleIntegrator is computed twice: from the reported velocities, and after applyVelocityConstraints,
which leaves only the linear and angular momentum of each molecule.

A point consists of several runs with different seeds. Each run is a job of an ensemble and a row of the record
records/equipartition.csv. Runs in the record are not repeated, so that the study can continue on another machine.
Errors are those of the mean of independent runs. They do not include the effect of the initial state: all runs of a
model start from the end of one run of 20 ps, and their first 5 ps are omitted. Some runs at 0.5 and 1 fs used a faster
build of OpenMM's CPU platform, whose forces agree with those of the installed build within 2e-6 of their root mean
square. The default study, 1 ns per point of 216 molecules, takes 86 million force evaluations; --models, --ensembles,
--methods, --intervals and --runs select a part of it. Several commands run fastest with one core and one worker each:
taskset -c 0.
"""

from __future__ import annotations

import argparse
import itertools
import math
from functools import cache
from pathlib import Path

import numpy as np
import openmm
from matplotlib.artist import Artist
from openmm import app

import openmm_exactrb as rb
from benchmarks.common.group_temperatures import of_rigid
from benchmarks.common.pictures import plt
from benchmarks.common.provenance import of_run
from benchmarks.common.starts import R, canonical, context_of, masses_of, positions_and_velocities, thermostat
from benchmarks.water.equipartition_record import (
    FRICTION,
    GOALS,
    KELVIN,
    LABELS,
    LFM,
    NAMES,
    RECORD,
    Point,
    Run,
    merge,
    points,
    read,
)
from openmm_exactrb import ensemble
from openmm_exactrb.ensemble.execution import stored_result

OUT = Path("out/equipartition")
PRESSURE = 1.0  # bar
CUTOFF, SWITCH = 0.85, 0.75  # nm; a switch, so that forces are those of the energy that Metropolis and barostats see
BAROSTAT = 0.02  # ps between two moves of the barostat: the volume forgets in 1 ps, with 0.1 in four times as long
LOOKED, SAMPLED = 0.05, 0.1  # ps, at least, between two looks at velocities, and between two samples: a mean of looks
BURN = 5.0  # ps at the start of each run that are not counted
EXACT = "hybrid"  # Metropolis over S2_2: no error of the step
CHAINS = "NoseHoover"
OPENMM = {LFM: openmm.LangevinMiddleIntegrator, CHAINS: openmm.NoseHooverIntegrator}
METHODS = (LFM, "BAOAB", "W2_3m", "W2_4g", "BAOA:30")  # with a friction of its own, in 1/ps, behind a colon
AT_CONSTANT = {"NVT": "constant volume", "NPT": "constant pressure"}
# Colours that a colour-blind reader can tell apart (Okabe and Ito), with markers of their own.
STYLES = {
    f"{LFM}, as reported": ("#D55E00", "o"),
    f"{LFM}, constrained": ("#E69F00", "s"),
    "BAOAB, at the end": ("#56B4E9", "^"),
    "BAOAB, around O": ("#009E73", "v"),
    "W2_3m": ("#0072B2", "D"),
    "W2_4g": ("#CC79A7", "P"),
    "BAOA, friction 30/ps": ("#8C510A", "<"),
    "S2_2": ("#999999", "X"),
    "hybrid Monte Carlo": ("#000000", "*"),
}


def system_of(model: str, n: int, kelvin: float, pressure: float | None, every: int):
    """Return a System of water and its positions."""
    _, system, positions = rb.rigid_water(
        n,
        model=model,
        nonbondedMethod=app.PME,
        nonbondedCutoff=CUTOFF,
        switchDistance=SWITCH,
        ewaldErrorTolerance=1e-4,
    )
    if pressure is not None:
        system.addForce(openmm.MonteCarloBarostat(pressure, kelvin, every))
    return system, positions


@cache
def start_of(model: str, n: int, kelvin: float) -> openmm.State:
    """Return water that has forgotten its lattice."""
    system, positions = system_of(model, n, kelvin, None, 0)
    return canonical(context_of(system, thermostat(kelvin), positions), 10_000)[0]


def integrator_of(method: str, interval: float, friction: float, kelvin: float) -> openmm.Integrator:
    """Return what makes a force evaluation every `interval` ps."""
    if method in OPENMM:
        return OPENMM[method](kelvin, friction, interval)
    if method == EXACT:
        return rb.ExactRigidBodyHybridIntegrator(kelvin, friction, 2 * interval, scheme="S2_2")
    chains, _, scheme = method.rpartition("/")
    integrator = rb.ExactRigidBodyNoseHooverIntegrator if chains else rb.ExactRigidBodyLangevinIntegrator
    return integrator(kelvin, friction, forceInterval=interval, scheme=scheme)


def run_of(
    *,
    model: str,
    method: str,
    interval: float,
    pressure: float | None,
    length: float,
    seed: int,
    n: int,
    friction: float,
    kelvin: float,
) -> dict:
    """Run water and return samples by name, and where they come from.

    Temperatures are in K, the energy in kJ/mol per molecule, and the density in kg/m³.
    """
    integrator = integrator_of(method, interval, friction, kelvin)
    h = integrator.getStepSize()._value
    system, _ = system_of(model, n, kelvin, pressure, max(1, round(BAROSTAT / h)))
    if method != CHAINS:
        integrator.setRandomNumberSeed(seed)
    context = context_of(system, integrator, start_of(model, n, kelvin))
    if method.startswith(CHAINS):  # which draw no random numbers of their own
        context.setVelocitiesToTemperature(kelvin, seed)
    look = of_openmm(context, n) if method in OPENMM else of_ours(integrator)
    every = max(1, math.ceil(LOOKED / h - 1e-9))
    looks = max(1, round(SAMPLED / (every * h)))
    integrator.step(round(BURN / h))
    samples = []
    for _ in range(round(length / (looks * every * h))):
        seen = []
        for _ in range(looks):
            integrator.step(every)
            seen.append(look())
        means = {name: float(np.mean([values[name] for values in seen])) for name in seen[0]}
        samples.append(means | energy_and_density(context, n))
    result = {"interval": looks * every * h, "samples": {name: [s[name] for s in samples] for name in samples[0]}}
    result |= {"acceptance": integrator.acceptanceRate()} if method == EXACT else {}
    return result | {"origin": of_run(context)}


def of_openmm(context: openmm.Context, n: int):
    """Return what looks at the velocities that an integrator of OpenMM reports.

    The linear and the angular momentum of each molecule give its translation and rotation as a rigid body, which is
    what applyVelocityConstraints leaves; what the velocities have besides is not a rigid molecule's.
    """
    system = context.getSystem()
    masses = masses_of(system)
    atoms = np.flatnonzero(masses).reshape(n, -1)

    def look() -> dict[str, float]:
        x, v = positions_and_velocities(context.getState(positions=True, velocities=True))
        translation, rotation, all_but_translation = of_rigid(masses[atoms[0]], x[atoms], v[atoms])
        return {
            "T_tr": temperature(translation, n),
            "T_rot": temperature(all_but_translation, n),
            "T_rot, other": temperature(rotation, n),
        }

    return look


def of_ours(integrator: rb.ExactRigidBodyLangevinIntegrator):
    """Return what looks at the temperatures of an integrator of ours."""

    def look() -> dict[str, float]:
        at_end, around = integrator.temperatures(), integrator.temperaturesAroundThermostat()
        names = ("T_tr", "T_rot", "T_tr, other", "T_rot, other")
        return {name: T._value for name, T in zip(names, (*at_end, *around), strict=True)}

    return look


def temperature(kinetic: float, n: int) -> float:
    return 2.0 * kinetic / (3 * n * R)


def energy_and_density(context: openmm.Context, n: int) -> dict[str, float]:
    state, mass = context.getState(energy=True), masses_of(context.getSystem()).sum()
    density = mass * 1.66053906892 / state.getPeriodicBoxVolume()._value
    return {"U": state.getPotentialEnergy()._value / n, "density": density}


def gist(method: str, result: dict) -> dict[str, float]:
    """Return the means over a run of what is measured."""
    means = {name: float(np.mean(series)) for name, series in result["samples"].items()}
    reference = means["T_tr"] if method in OPENMM else means["T_tr, other"]
    return {
        "T_tr": means["T_tr"],
        "T_rot - T_tr": means["T_rot"] - means["T_tr"],
        "other T_rot - T_tr": means["T_rot, other"] - reference,
        "U": means["U"],
        "density": means["density"],
        "acceptance": result.get("acceptance", math.nan),
    }


def job_of(run: Run) -> ensemble.Job:
    return ensemble.Job(
        run_of,
        model=run.model,
        method=run.method,
        interval=run.interval / 1000.0,
        pressure=PRESSURE if run.ensemble == "NPT" else None,
        length=run.ps,
        seed=run.seed,
        n=run.molecules,
        friction=run.friction,
        kelvin=run.kelvin,
    )


def main() -> None:
    args = parse()
    record = read(args.record)
    seeds = range(1, args.runs + 1)
    kinds = itertools.product(args.models, args.ensembles, args.methods, args.intervals, seeds)
    wanted = [
        Run(model, kind, method, interval, args.molecules, friction or args.friction, args.kelvin, args.length, seed)
        for model, kind, (method, friction), interval, seed in kinds
    ]
    missing = {run: job_of(run) for run in wanted if run not in record}
    results = finished(list(missing.values()), args)
    new = {
        run: gist(run.method, result) | result["origin"]
        for run, job in missing.items()
        if (result := results.get(job.key)) is not None
    }
    record = merge(new, args.record)
    asked = {run._replace(seed=0) for run in wanted}
    found = points({run: means for run, means in record.items() if run._replace(seed=0) in asked})
    if not found:
        raise SystemExit(f"no run of these points is in {args.record} or finished in {args.out}")
    for point in found:
        means = (f"{name} {mean:.5g}({error:.2g})" for name, (mean, error) in point.found.items())
        print(*point[:4], f"friction {point.friction:g}, {point.ps:g} ps ", "  ".join(means))
    whole = [point for point in found if point.ps >= args.runs * args.length]
    if whole:
        args.out.mkdir(parents=True, exist_ok=True)
        for model in {point.model for point in whole}:
            draw([point for point in whole if point.model == model], args.out / f"equipartition_{model}.png")
        draw_difference(whole, args.out / "equipartition_difference.png")


def finished(jobs: list[ensemble.Job], args: argparse.Namespace) -> dict[str, dict]:
    """Return the results of jobs by their keys: of all of them, or only those already finished."""
    folder = args.out / "runs"
    if not jobs:
        return {}
    if args.finished:
        results = [result for job in jobs if (result := stored_result(job, folder)) is not None]
    else:
        results = ensemble.run(jobs, folder, workers=args.workers)
    for result in results:
        if result.error is not None:
            print(f"{result.job!r} failed: {result.error}")
    return {result.job.key: result.value for result in results if result.error is None}


def draw(drawn: list[Point], file: Path) -> None:
    """Draw panels for one model: temperatures and energy at constant volume, density at constant pressure.

    Where there are runs of one ensemble only, its temperatures and energies are drawn.
    """
    kinds = {point.ensemble for point in drawn}
    main = "NVT" if "NVT" in kinds else "NPT"
    panels = [("T_rot - T_tr", main), ("U", main)] + [("density", "NPT")] * ("NPT" in kinds)
    size = (5.6, 1.2 + 2.5 * len(panels))
    figure, column = plt.subplots(len(panels), figsize=size, sharex=True, squeeze=False, layout="constrained")
    for (quantity, kind), (axes,) in zip(panels, column, strict=True):
        axes.set_ylabel(LABELS[quantity].replace(" (kJ", "\n(kJ") + f"\n{AT_CONSTANT[kind]}")
        shown = [point for point in drawn if point.ensemble == kind]
        shade_goal(axes, quantity, shown)
        plot(axes, quantity, shown)
    top, bottom = column[0, 0], column[-1, 0]
    top.set_title(NAMES.get(drawn[0].model, drawn[0].model))
    top.set_yscale("symlog", linthresh=2.0)
    low, high = top.get_ylim()
    top.set_yticks([K for K in (-20, -10, -5, -2, -1, 0, 1, 2, 5, 10) if low <= K <= high])
    top.yaxis.set_major_formatter("{x:g}")
    bottom.set_xscale("log", base=2)
    bottom.set_xticks(sorted({point.interval for point in drawn}))
    bottom.xaxis.set_major_formatter("{x:g}")
    bottom.set_xlabel("time per force evaluation (fs)")
    legend: dict[str, Artist] = {}
    for axes in column.flat:
        legend |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(legend.values(), legend.keys(), loc="outside lower center", ncols=2, fontsize=9)
    figure.savefig(file, dpi=150)


def draw_difference(drawn: list[Point], file: Path) -> None:
    """Draw the difference of the temperatures of SPC/E, of OpenMM as a Context reports it and after projection."""
    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    reported, projected = "T_rot - T_tr", "other T_rot - T_tr"
    for method, quantity, name, style in (
        (LFM, reported, "LangevinMiddleIntegrator, as reported", f"{LFM}, as reported"),
        (LFM, projected, "LangevinMiddleIntegrator, projected on the constraints", f"{LFM}, constrained"),
        ("W2_3m", reported, "ExactRigidBodyLangevinIntegrator, W2_3m", "W2_3m"),
        ("W2_4g", reported, "ExactRigidBodyLangevinIntegrator, W2_4g", "W2_4g"),
    ):
        of_method = [point for point in drawn if (*point[:3], point.friction) == ("spce", "NVT", method, FRICTION)]
        rows = sorted((point.interval, *point.found[quantity]) for point in of_method if quantity in point.found)
        if rows:
            colour, marker = STYLES[style]
            axes.errorbar(*np.array(rows).T, color=colour, marker=marker, capsize=3, label=name)
    axes.axhline(0.0, color="0.6", lw=1.0)
    axes.set(xlabel="time per force evaluation (fs)", ylabel="T of rotation − T of translation (K)")
    axes.set_title("216 SPC/E at 298 K, friction 5/ps, 1 ns each", fontsize=10)
    axes.legend(frameon=False)
    figure.savefig(file, dpi=150)


def shade_goal(axes: plt.Axes, quantity: str, drawn: list[Point]) -> None:
    """Shade where a quantity should be: about no difference, or about the reference, if it was measured."""
    reference = [point.found[quantity][0] for point in drawn if point[2:5] == (LFM, 0.5, FRICTION)]
    middles = [0.0] if quantity.startswith("T_rot") else reference
    for middle in middles:
        reach = GOALS[quantity] * (middle / 100.0 if quantity == "density" else 1.0)
        axes.axhspan(middle - reach, middle + reach, color="0.87", lw=0.0, label=f"goal, about 0 or {LFM} at 0.5 fs")


def plot(axes: plt.Axes, quantity: str, drawn: list[Point]) -> None:
    """Plot what was measured over the time a force, a line for each method."""
    lines: dict[str, list] = {}
    for point in drawn:
        for name, look in zip(labels(point), (quantity, f"other {quantity}"), strict=False):
            if look in point.found:
                lines.setdefault(name, []).append((point.interval, *point.found[look]))
    for name, of_method in lines.items():
        colour, marker = STYLES.get(name, ("#999999", "x"))
        x, y, error = np.array(sorted(of_method)).T
        beside = 1.0 + 0.012 * (list(STYLES).index(name) - 3 if name in STYLES else 4)  # not one over the other
        axes.errorbar(x * beside, y, error, color=colour, marker=marker, capsize=3, lw=1.2, ms=5, label=name)


def labels(point: Point) -> tuple[str, ...]:
    """Return what the lines of a point are called: its velocities as they are, and as they are looked at besides."""
    if point.friction != FRICTION:
        return (f"{point.method}, friction {point.friction:g}/ps",)
    names = {
        LFM: (f"{LFM}, as reported", f"{LFM}, constrained"),
        "BAOAB": ("BAOAB, at the end", "BAOAB, around O"),
        "W2_3m": ("W2_3m",),
        EXACT: ("hybrid Monte Carlo",),
    }
    return names.get(point.method, (point.method,))


def method_of(word: str) -> tuple[str, float | None]:
    """Read a method, and the friction behind a colon if there is one."""
    name, _, friction = word.partition(":")
    return name, float(friction) if friction else None


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Equipartition, energy and density of rigid water over the step.")
    add = parser.add_argument
    add("--models", nargs="+", default=["spce", "tip4p2005"], metavar="NAME", help="as rigid_water takes them")
    add("--ensembles", nargs="+", default=["NVT", "NPT"], choices=["NVT", "NPT"])
    methods = (
        f"{LFM}, {CHAINS}, BAOAB, a splitting, {CHAINS}/ and one, or {EXACT}; as BAOA:30 with a friction of its own"
    )
    add("--methods", nargs="+", type=method_of, default=[*map(method_of, METHODS)], metavar="NAME", help=methods)
    add("--intervals", nargs="+", type=float, default=[0.5, 1, 2, 4, 6], metavar="FS", help="time a force evaluation")
    add("--runs", type=int, default=20, help="runs a point, each with its own seed (%(default)s)")
    add("--length", type=float, default=50.0, metavar="PS", help="of a run (%(default)s)")
    add("--molecules", type=int, default=216)
    add("--friction", type=float, default=FRICTION, metavar="1/PS", help="%(default)s")
    add("--kelvin", type=float, default=KELVIN, metavar="K", help="%(default)s")
    add("--finished", action="store_true", help="run nothing: table and picture of the runs that are there")
    add("--workers", type=int, default=None, help="processes; one for each core unless given")
    add("--out", type=Path, default=OUT, metavar="FOLDER", help="%(default)s")
    add("--record", type=Path, default=RECORD, metavar="CSV", help="what runs gave; read first, added to at the end")
    return parser.parse_args()


if __name__ == "__main__":
    main()
