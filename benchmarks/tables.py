"""Markdown tables of the documentation, generated from the measurements in records/*.csv."""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from benchmarks.common.markdown import distinct, rows, table, with_error
from benchmarks.common.records import Row
from benchmarks.common.starts import R
from benchmarks.cost.tables import cost_at_8_fs
from benchmarks.water.equipartition_record import LFM
from openmm_exactrb import SCHEMES
from openmm_exactrb.schemes import CATALOGUE, stability_limit

THEIRS = {"Verlet": "`VerletIntegrator`", LFM: "`LangevinMiddleIntegrator`"}


def scheme_table() -> str:
    """Return the catalogue of schemes whose change of the angular momentum is in the record."""
    measured, body = {row["scheme"] for row in rows("angular_momentum")}, []
    for name, scheme in ((name, scheme) for name, scheme in CATALOGUE.items() if name in measured):
        orders = ", ".join(map(str, scheme.generalised or (scheme.order,)))
        stable = stability_limit(scheme) / scheme.forces
        more = scheme.output_forces if scheme.processor else int(scheme.first == "kick")
        body.append((f"`{name}`", orders, f"{scheme.forces}", f"{more}", f"{stable:.2f}"))
    return table(("name", "orders", "forces per step", "more per call", "stable step per force"), body)


# -- the default at constant energy: benchmarks/proteins/default_energies.py -----------------------------------------


def default_energies() -> tuple[list[float], list[float]]:
    """Return the energy errors of the default in a box of water, and their ratios to Verlet's, by the start."""
    found = [row for row in rows("default_energies") if row["system"] == "water"]
    verlet, ours = (
        {row["seed"]: float(row["std_kJ_mol"]) for row in found if row["integrator"] == name}
        for name in ("Verlet", "default")
    )
    return [*ours.values()], [std / verlet[seed] for seed, std in ours.items()]


def default_stability() -> str:
    """Return whether the default and Verlet hold at 2 and 4 fs, and their energy errors, for solutes with HBonds."""
    found, steps = [row for row in rows("default_energies") if row["system"] != "water"], (2.0, 4.0)
    kinds = distinct(found, "system", "atoms", "start")
    body = []
    for (system, atoms, start), (method, label) in product(
        kinds, (("Verlet", THEIRS["Verlet"]), ("default", "the default"))
    ):
        cells = []
        for fs in steps:
            asked = (system, start, method, fs)
            stds = [float(r["std_kJ_mol"]) for r in found if _what(r) == asked]
            held = [std for std in stds if math.isfinite(std)]
            lost = len(stds) - len(held)
            cells.append(
                (f"{np.sqrt(np.mean(np.square(held))):.2g}" if held else "")
                + (f" ({lost} of {len(stds)} diverge)" if lost and held else "diverges" if lost else "")
            )
        where = "from the file" if start == "file" else start
        body.append((f"{system}, {atoms} atoms, {where}", label, *cells))
    return table(("", "", *(f"{fs:g} fs" for fs in steps)), body)


def _what(row: Row) -> tuple[str, str, str, float]:
    return row["system"], row["start"], row["integrator"], float(row["fs"])


# -- the output of processed schemes: benchmarks/schemes/outputs.py --------------------------------------------------


def outputs() -> str:
    """Return the energy errors of the output and of the exact inverse, means over starts."""
    found, body = rows("outputs"), []
    for scheme, rate in distinct(found, "scheme", "forces per ps"):
        some = [row for row in found if (row["scheme"], row["forces per ps"]) == (scheme, rate)]
        inverse, output = (np.array([float(row[name]) for row in some]) for name in ("inverse", "output"))
        ratios, shifts = output / inverse, [abs(float(row[name])) for row in some for name in ("shift tr", "shift rot")]
        body.append(
            (
                f"`{scheme}`",
                *(f"{values.mean():.2g}" for values in (inverse, output)),
                f"{output.mean() / inverse.mean():.2f} ({ratios.min():.2f} to {ratios.max():.2f})",
                f"{max(shifts):.2f}",
            )
        )
    head = ("", "exact inverse", "output", "output over inverse", "largest shift of a kinetic energy")
    return table(head, body)


# -- the default at constant temperature: benchmarks/proteins/protein_steps.py ---------------------------------------


def default_temperatures() -> str:
    """Return temperatures and energies of the default and of LangevinMiddleIntegrator, of a peptide in water."""
    found, body = rows("protein_steps"), []
    names = {"T_tr": 1, "T_rot": 1, "T_rot reported": 1, "U": 2}
    of_point = {"solute": "peptide", "masses": "plain", "friction": "5.0", "ensemble": "NVT"}
    of_defaults = [row for row in found if all(row[key] == value for key, value in of_point.items())]
    for step, (method, label) in product((2.0, 4.0, 6.0), ((LFM, THEIRS[LFM]), ("BAOA", "`BAOA`, the default"))):
        some = [row for row in of_defaults if (row["integrator"], float(row["fs"])) == (method, step)]
        if some:
            of_runs, _, _ = ended(some).partition(" runs")
            body.append((f"{step:g} fs", label, of_runs, *(mean_of(some, *column) for column in names.items())))
    units = (*(f"{name} (K)" for name in names if name != "U"), "U (kJ/mol)")
    return table(("", "", "ended", *units), body)


#: Integrators, fs and constraints of a peptide with heavy hydrogens that are compared: the reference, and equal costs.
_EQUAL = (
    *((LFM, "2.0", "HBonds"), (LFM, "8.0", "AllBonds")),
    *(("BAOA", "8.0", "HBonds"), ("W2_3m", "8.0", "HBonds")),
)


def protein_limits() -> dict[str, tuple[tuple[float, float], tuple[float, float]]]:
    """Return, of a peptide in water with heavy hydrogens, lines in the square of the time per force evaluation.

    By name, they are the limit at zero and the change up to 8 fs, each with its error.
    """
    of_point = {"solute": "peptide", "masses": "all", "constraints": "HBonds", "friction": "5.0", "ensemble": "NVT"}
    found = [row for row in rows("protein_steps") if all(row[key] == value for key, value in of_point.items())]
    runs = [[row for row in found if (row["integrator"], row["fs"]) == ("W2_3m", fs)] for fs in ("4.0", "6.0", "8.0")]
    names = ("T_tr", "T_rot", "T_solute", "U", "bonds", "angles", "torsions", "peak", "D")
    lines = (_line([[float(row[name]) for row in some] for some in runs], (16.0, 36.0, 64.0), 64.0) for name in names)
    return {
        name: ((limit, errors[0]), (change, errors[1]))
        for name, (limit, change, errors) in zip(names, lines, strict=True)
    }


def _line(runs: list[list[float]], squares: tuple[float, ...], at: float) -> tuple[float, float, list[float]]:
    """Return limit and change of a straight line through the means of runs, and their errors.

    The scatter of a run is that of all of them about the means.
    """
    n, means = np.array([len(some) for some in runs]), np.array([np.mean(some) for some in runs])
    scatter = np.sqrt(sum(np.var(some) * len(some) for some in runs) / (n.sum() - len(n)))
    line, covariance = np.polyfit(np.array(squares) / at, means, 1, w=np.sqrt(n) / scatter, cov="unscaled")
    change, limit = map(float, line)
    return limit, change, [float(error) for error in np.sqrt(np.diag(covariance)[::-1])]


def heating() -> str:
    """Return the power that long steps add to villin in water, and how much hotter than its thermostat it is then."""
    body, found = [], rows("long_step_heating")
    for scheme, fs in sorted(distinct(found, "scheme", "fs"), key=lambda point: (point[0] != "W2_3m", float(point[1]))):
        some = [row for row in found if (row["scheme"], row["fs"]) == (scheme, fs)]
        power = np.array([float(row["kJ/mol/ps"]) for row in some])
        mean, error = float(power.mean()), float(power.std(ddof=1) / np.sqrt(len(power)))
        per_friction = 1.0 / (int(some[0]["freedom"]) * R)
        excess = (with_error(mean * per_friction / g, error * per_friction / g, 1) for g in (1.0, 5.0))
        body.append((f"`{scheme}`", f"{fs} fs", with_error(mean, error, 0), *excess))
    return table(("", "", "power (kJ/mol/ps)", "excess (K) at 1/ps", "at 5/ps"), body)


def equal_protein_costs() -> str:
    """Return how many runs of a peptide with heavy hydrogens ended, and their temperatures and potential energies."""
    of_point = {"solute": "peptide", "masses": "all", "friction": "5.0", "ensemble": "NVT"}
    found = [row for row in rows("protein_steps") if all(row[key] == value for key, value in of_point.items())]
    names = {"T_tr": 1, "T_rot": 1, "T_rot reported": 1, "T_solute": 1, "T_solute reported": 1, "U": 2}
    body = []
    for method, fs, constraints in _EQUAL:
        some = [row for row in found if (row["integrator"], row["fs"], row["constraints"]) == (method, fs, constraints)]
        label = f"{THEIRS.get(method, f'`{method}`')}, {float(fs):g} fs, `{constraints}`"
        body.append((label, ended(some), *(mean_of(some, *column) for column in names.items())))
    units = (f"{name} (K)".replace("T_solute", "T_peptide") for name in names if name != "U")
    return table(("", "ended", *units, "U (kJ/mol per molecule of water)"), body)


def ended(some: list[Row]) -> str:
    """Return how many of the runs that were started ended: those that diverged are nan in the record."""
    lengths = {float(row["picoseconds"]) for row in some}
    whole = sum(math.isfinite(float(row["T_tr"])) for row in some)
    return f"{whole} of {len(some)} runs of {lengths.pop():g} ps"


def populations() -> dict[str, dict[str, str]]:
    """Return dihedral populations and the energy of bonds of a peptide in implicit solvent, by integrator and name."""
    names = {"helical": 3, "left": 3, "bonds": 2}
    found, means = rows("peptide_populations"), {}
    for (integrator,) in distinct(found, "integrator"):
        some = [row for row in found if row["integrator"] == integrator]
        values = {name: [[float(row[column]) for row in some] for column in (name, f"{name} error")] for name in names}
        means[integrator] = {
            name: with_error(float(np.mean(of)), float(np.hypot.reduce(errors)) / len(some), names[name])
            for name, (of, errors) in values.items()
        }
    return means


def mean_of(some: list[Row], name: str, digits: int) -> str:
    """Return the mean of a column over runs, with its standard error."""
    values = np.array([float(row[name]) for row in some])
    held = values[np.isfinite(values)]
    lost = f" ({len(values) - len(held)} of {len(values)} diverge)" if 0 < len(held) < len(values) else ""
    if len(held) < 2:
        alone = f"{held[0]:.{digits}f}" if len(held) else "diverges"
        return alone if len(values) else ""
    return with_error(float(held.mean()), float(held.std(ddof=1) / np.sqrt(len(held))), digits) + lost


def protein_energies() -> str:
    """Return energy errors of villin with a nonbonded evaluation every 4 fs, and bonded evaluations in between."""
    labels = {"Verlet": "`VerletIntegrator`", "MTSIntegrator": "`MTSIntegrator`, bonded forces every 1 fs"}
    found, body = rows("protein"), []
    verlet = {row["method"]: float(row["std_2_ps_kJ_mol"]) for row in found}["Verlet"]
    for row in found:
        name = row["method"]
        half, whole = (float(row[f"std_{window}_ps_kJ_mol"]) for window in ("half", "2"))
        bonded = "" if name == "Verlet" else f"{float(row['bonded_per_force']):.2g}"
        gain = "" if name == "Verlet" else f"{verlet / whole:.1f}"
        body.append((labels.get(name, f"`{name}`"), f"{half:.1f}", f"{whole:.1f}", gain, bonded))
    head = (
        "std in 0.5 ps, kJ/mol",
        "in 2 ps",
        "times less than Verlet in 2 ps",
        "bonded evaluations per slow one",
    )
    return table(("", *head), body)


# -- physical_validation: benchmarks/water/validation.py -------------------------------------------------------------


def validation() -> str:
    """Return the extreme results of physical_validation for each integrator, and those of its two ensembles."""
    found, body = rows("physical_validation"), []
    for (integrator,) in distinct((row for row in found if row["test"] == "ensemble"), "integrator"):
        of = [(row["test"], row["point"], row["value"]) for row in found if row["integrator"] == integrator]
        p = min((value for test, _, value in of if test == "kinetic energy, p"), key=float)
        deviation = max((value for test, _, value in of if not test.startswith(("kinetic", "ensemble"))), key=float)
        ratios = {"bar" in point: value for test, point, value in of if test == "ensemble"}
        body.append((integrator, p, deviation, ratios[False], ratios[True]))
    return table(("integrator", "smallest p", "largest deviation", "two temperatures", "two pressures"), body)


# -- schemes of others: benchmarks/water/droplet.py ------------------------------------------------------------------


def earlier_schemes() -> str:
    """Return the energy error of water by schemes of others and of this project, at equal rates of evaluations."""
    found = {
        (row["method"], row["force_evaluations_a_ps"]): float(row["energy_std_30_ps"])
        for row in rows("water_earlier_schemes")
        if row["method"] not in ("PEFRL", "Chin4C")
    }
    methods, rates = (list(dict.fromkeys(key[k] for key in found)) for k in (0, 1))
    methods.sort(key=lambda name: (name in SCHEMES, name.startswith("W"), name in SCHEMES and SCHEMES[name].order))
    body = []
    for name in methods:
        scheme = SCHEMES.get(name)
        label = (f"`{name}`", f"{scheme.order}") if scheme else ("`VerletIntegrator`", "2")
        errors = (found.get((name, rate), math.nan) for rate in rates)
        body.append((*label, *(f"{error:.1e}" if error < 1.0 else "unstable" for error in errors)))
    return table(("", "order", *(f"{rate} per ps" for rate in rates)), body)


# -- single figures of the pages -------------------------------------------------------------------------------------


def figures() -> dict[str, str]:
    """Return figures of the README and of the page of recommendations; each is that of the last run."""
    return {
        "default_over_verlet": rounded(over_verlet("W2_1")),
        "W4_4_gain": rounded(1.0 / over_verlet("W4_4")),
        "W4_4_gain_error": f"{error_over_verlet('W4_4') / over_verlet('W4_4'):.0f}",
        "protein_gain": f"{protein_gain():.1f}",
        "protein_gain_over_mts": f"{protein_gain('MTSIntegrator'):.1f}",
        "protein_throughput": f"{2.0 / cost_at_8_fs():.1f}",
        "protein_time": f"{cost_at_8_fs() / 2.0:.2f}",
    }


def over_verlet(scheme: str) -> float:
    """Return the energy error of a scheme over Verlet's, in TIP3P over 30 ps: benchmarks/water/water_boxes.py."""
    found = {row["method"]: float(row["std_30_ps"]) for row in rows("water_boxes") if row["model"] == "tip3p"}
    return found[scheme] / found["Verlet"]


def error_over_verlet(scheme: str) -> float:
    """Return the relative error of that ratio, from the scatter of the starts."""
    found = {row["method"]: row for row in rows("water_boxes") if row["model"] == "tip3p"}
    return math.hypot(
        *(float(found[name]["error_30_ps"]) / float(found[name]["std_30_ps"]) for name in (scheme, "Verlet"))
    )


def protein_gain(over: str = "Verlet") -> float:
    """Return the energy error of a method over the default's, for villin over 2 ps: benchmarks/proteins/protein.py."""
    std = {row["method"]: float(row["std_2_ps_kJ_mol"]) for row in rows("protein")}
    return std[over] / std["W2_1"]


def asked(scheme: str) -> float:
    """Return the force evaluations of a step through `Simulation.step`: benchmarks/schemes/outputs.py."""
    return float(np.mean([float(row["asked per step"]) for row in rows("outputs") if row["scheme"] == scheme]))


def rounded(value: float) -> str:
    """Return a number with two digits, below one with one."""
    return f"{float(f'{value:.{1 + (value >= 1.0)}g}'):g}"
