"""Tables of droplets and boxes of water, of energy balances, averages, reading points and shadow energies."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from benchmarks.common.markdown import distinct, rows, table, with_error
from benchmarks.common.records import Row
from benchmarks.common.reported import error_over_runs
from benchmarks.water import corrected_water, energy_drift
from benchmarks.water.averages import OFFSET, PARTS, UNITS
from benchmarks.water.equipartition_record import FRICTION, LFM, NAMES, RECORD, less, read, whole

WINDOWS = ("2", "10", "30")  # ps
OURS = ("W2_1", "W4_4", "W4_6")  # the best at some rate


def droplet_energies() -> str:
    """Return the energy errors of a droplet, and by how much they are below Verlet's."""
    found = {
        (row["force_evaluations_a_ps"], row["method"]): [float(row[f"energy_std_{ps}_ps"]) for ps in WINDOWS]
        for row in rows("water_droplet")
    }
    body = []
    for rate in dict.fromkeys(rate for rate, _ in found):
        verlet = found[rate, "OpenMM's Verlet"]
        best = min(OURS, key=lambda name: found[rate, name][-1])
        errors = ", ".join(f"{error:.1e}" for error in found[rate, best])
        gains = ", ".join(f"{theirs / ours:.3g}" for theirs, ours in zip(verlet, found[rate, best], strict=True))
        body.append((rate, f"{verlet[-1]:.1e}", f"`{best}`", errors.replace("e-0", "e-"), gains))
    head = ("force evaluations per ps", "Verlet, 30 ps", "best scheme", "its error over 2, 10 and 30 ps")
    return table((*head, "times less than Verlet"), [[cell.replace("e-0", "e-") for cell in line] for line in body])


def box_energies() -> str:
    """Return the energy errors of a periodic box of TIP3P."""
    last = {row["method"]: row for row in rows("water_boxes") if (row["model"], row["starts"]) == ("tip3p", "6")}
    verlet = float(last["Verlet"]["std_30_ps"])
    body = []
    for name in ("Verlet", "W2_1", "W4_4"):
        row = last[name]
        std, error = (float(row[f"{kind}_30_ps"]) for kind in ("std", "error"))
        spread = math.hypot(error / std, float(last["Verlet"]["error_30_ps"]) / verlet)
        gain = "" if name == "Verlet" else f"{verlet / std:.2g} ± {verlet / std * spread:.1g}"
        cells = (f"{float(row[f'std_{ps}_ps']):.1e}".replace("e-0", "e-") for ps in WINDOWS)
        body.append((f"`{name}`" if name != "Verlet" else name, *cells, gain))
    return table(("TIP3P", *(f"{ps} ps" for ps in WINDOWS), "times less than Verlet over 30 ps"), body)


def long_box_energies() -> str:
    """Return the energy errors of a periodic box of TIP3P over 300 ps, and their slopes and gains by start."""
    runs = {(row["method"], row["start"]): row for row in rows("energy_drift") if row["molecules"] == "216"}
    verlet = {start: float(row["std_300_ps"]) for (name, start), row in runs.items() if name == energy_drift.VERLET}
    starts, body = sorted(verlet), []
    for method in dict.fromkeys(method for method, _ in runs):
        some = [runs[method, start] for start in starts if (method, start) in runs]
        gains = (verlet[row["start"]] / float(row["std_300_ps"]) for row in some)
        name, gain = f"`{method}`", ", ".join(f"{ratio:.2g}" for ratio in gains)
        if method == energy_drift.VERLET:
            name, gain = method, ""
        body.append((name, *_drifts(some, energy_drift.WINDOWS), gain))
    windows = (f"{window} ps" for window in energy_drift.WINDOWS)
    return table(("TIP3P", *windows, "slope per ns", "times less than Verlet over 300 ps"), body)


def energy_drifts() -> str:
    """Return the energy errors of W4_4 by the interval and the forces, within windows of increasing length."""
    found = [row for row in rows("energy_drift") if row["molecules"] == "64"]
    body, run = [], energy_drift.RUN[:-1]
    windows = [window for window in energy_drift.WINDOWS if any(row[f"std_{window}_ps"] != "nan" for row in found)]
    for point in distinct(found, *run):
        some = [row for row in found if tuple(row[name] for name in run) == point]
        of = some[0]
        precision = "double" if of["platform"] == "Reference" else "single"
        tolerances = (f"{float(of[name]):.0e}" for name in ("direct", "tolerance"))
        length = f"{len(some)} x {float(of['picoseconds']):g} ps"
        settings = (f"{float(of['fs']):g} fs", precision, *(text.replace("e-0", "e-") for text in tolerances))
        body.append((*settings, length, *_drifts(some, windows)))
    head = ("interval", "precision", "tolerance of direct sum", "of mesh", "", *(f"{window} ps" for window in windows))
    return table((*head, "slope per ns"), body)


def _drifts(some: list[Row], windows: Sequence[int]) -> list[str]:
    """Return the root mean squares over runs of the standard deviations within windows, and the slopes of the runs."""
    values = np.array([[float(row[f"std_{window}_ps"]) for window in windows] for row in some])
    stds = (f"{std:.1e}" if np.isfinite(std) else "" for std in np.sqrt(np.square(values).mean(axis=0)))
    slopes = ", ".join(f"{float(row['drift_a_ns']):.1e}" for row in some)
    return [cell.replace("e-0", "e-") for cell in (*stds, slopes)]


def energy_balances() -> str:
    """Return the standard deviations of the sum of the energies and of the energy balance, by the step."""
    found = rows("energy_balance")
    body = [
        (
            name,
            *(
                ", ".join(f"{float(row[key]):#.2g}" for row in found if row["integrator"] == name)
                for key in ("sum", "balance")
            ),
        )
        for (name,) in distinct(found, "integrator")
    ]
    return table(("standard deviation at 2, 1, 0.5 fs per force", "kinetic + potential energy", "balance"), body)


def averages() -> str:
    """Return averages of W2_3m with heavy hydrogens at 8 fs, the means over seeds by length, as they are and corrected.

    References are the means over all steps of corrected_water.py. Models without them are in the record, and so are
    response coefficients.
    """
    groups: dict[tuple[str, ...], list[Row]] = {}
    shown = {"scheme": "W2_3m", "molecules": "216", "masses": "heavy", "fs": "8.0"}
    known_models = {model for model, *_ in corrected_water.studied()}
    for row in (row for row in rows("averages") if shown.items() <= row.items() and row["model"] in known_models):
        groups.setdefault((row["model"], row["ensemble"]), []).append(row)
    body = []
    for (model, ensemble), some in groups.items():
        of_run = NAMES[model], "constant volume" if ensemble == "NVT" else "1 bar, with offset"
        times = np.array([float(row["ps"]) for row in some])
        # Not by estimated errors, which are small where a fluctuation happens to be small.
        weights = times / times.sum()
        for name in ("potential energy", "density", "enthalpy"):
            values = np.array([[float(row[f"{name}{part}"]) for part in PARTS] for row in some])
            if np.isfinite(values).all():
                plain, after, *_ = weights @ values
                error, of_correction = (error_over_runs(weights, values[:, k], values[:, -1]) for k in (2, 3))
                digits = max(0, 1 - math.floor(math.log10(error)))
                cells = with_error(after - plain, of_correction, digits), with_error(after, error, digits)
                known = corrected_water.at_small_steps(model, ensemble, name)
                reference = with_error(*known, digits) if known else ""
                label, as_it_is = f"{name} ({UNITS[name]})", f"{plain:.{digits}f}".replace("-", "−")
                body.append((*of_run, label, as_it_is, *cells, reference))
        offset, *errors = np.array([[float(row[name]) for name in OFFSET] for row in some]).T
        if np.isfinite(offset).all():
            cell = with_error(weights @ offset, error_over_runs(weights, *errors), 0)
            body.append((*of_run, "offset of a barostat (bar)", "", cell, "", ""))
    head = ("", "", "average", "as it is", "correction", "corrected", "all steps up to 4 fs")
    return table(head, body)


def reading_points() -> str:
    """Return by how much potential energies where a step of W2_3m ends are above the reference."""
    found, record, body = rows("reading_point"), whole(read(RECORD)), []
    for (model,) in distinct(found, "model"):
        above = []
        for row in (row for row in found if row["model"] == model):
            change, error, fs = -float(row["U_less"]), float(row["error"]), float(row["fs"])
            ours, reference = (
                record[model, "NVT", method, step, FRICTION]["U"] for method, step in (("W2_3m", fs), (LFM, 0.5))
            )
            above.append(with_error(*less((ours[0] - change, math.hypot(ours[1], error)), reference), 2))
        body.append((f"{NAMES[model]}, above the reference", *above))
    return table(("potential energy, kJ/mol per molecule", "2 fs", "4 fs", "6 fs"), body)


def equal_costs() -> str:
    """Return what integrators give with a force evaluation every 4 fs, W2_3m where its steps end, and a reference."""
    record, body = whole(read(RECORD)), []
    lower = {row["model"]: -float(row["U_less"]) for row in rows("reading_point") if float(row["fs"]) == 4.0}
    openmm = "`LangevinMiddleIntegrator`"
    for model, (name, method, fs) in itertools.product(
        lower, ((openmm, LFM, 0.5), (openmm, LFM, 4.0), ("`W2_3m`", "W2_3m", 4.0), ("`W2_4g`", "W2_4g", 4.0))
    ):
        of = record[model, "NVT", method, fs, FRICTION]
        energy = of["U"][0] - lower[model] * (method == "W2_3m"), of["U"][1]
        difference = of["T_rot - T_tr"]
        projected = of["other T_rot - T_tr"] if method == LFM else difference
        density = record.get((model, "NPT", method, fs, FRICTION), {}).get("density")
        cells = (with_error(*difference, 1), with_error(*projected, 1), with_error(*energy, 2))
        body.append((NAMES[model], f"{name}, {fs:g} fs", *cells, "" if density is None else with_error(*density, 1)))
    head = ("T_rot − T_tr as reported (K)", "after projection (K)", "U (kJ/mol per molecule)", "density (kg/m³)")
    return table(("", "integrator, time per force", *head), body)


def shadow_predictions() -> str:
    """Return T_rot - T_tr in K and the error of U in kJ/mol per molecule that the spectrum of SPC/E makes."""
    found, body = [row for row in rows("shadow") if row["model"] == "spce" and row["masses"] == "plain"], []
    labels = {"BAOAB": "BAOAB, at the step's end"}
    for scheme in ("S2_2", "W2_3", "W2_3m", "W2_4g", "BAOAB", "BAOA"):
        cells = (
            ", ".join(
                f"{round(float(row[name]), digits) + 0.0:+.{digits}f}"
                for name, digits in (("T_rot - T_tr", 1), ("dU oscillators", 2))
            )
            for row in found
            if row["scheme"] == scheme
        )
        body.append((labels.get(scheme, scheme), *(cell.replace("-", "−") for cell in cells)))
    return table(("scheme", "2 fs per force", "4 fs", "6 fs"), body)


def settings_of_forces() -> str:
    """Return energy errors of Verlet and W4_4 within 2 ps and costs, with OpenMM's settings of forces and with ours."""
    loose, tight = rows("water_boxes_loose"), [row for row in rows("water_boxes") if row["starts"] == "6"]
    costs = costs_of_settings("216")
    body = []
    for label, settings, found in (
        ("OpenMM's defaults", "defaults", loose),
        ("`switchDistance` and a tolerance of 1e-5", "switch and tolerance 1e-5", tight),
    ):
        std = {row["method"]: float(row["std_2_ps"]) for row in found if row["model"] == "tip3p"}
        errors = (f"{std[name]:.1e}" for name in ("Verlet", "W4_4"))
        body.append((label, found[-1]["starts"], *errors, f"{costs[settings]:.1f}"))
    return table(("forces", "starts", "Verlet", "`W4_4`", "time of a step"), body)


def costs_of_settings(molecules: str) -> dict[str, float]:
    """Return the time of a step of Verlet by the settings of forces, over that with OpenMM's defaults."""
    found = rows("force_settings")
    return {row["settings"]: float(row["median"]) for row in found if row["molecules"] == molecules}


def acceptance() -> str:
    """Return the fraction of accepted proposals of hybrid Monte Carlo, and the force evaluations per proposal."""
    body = [
        (f"`{row['scheme']}`", row["fs"], f"{row['accepted']} ± {row['error']}", row["forces_per_proposal"])
        for row in rows("acceptance")
    ]
    return table(("scheme", "fs", "accepted", "forces per proposal"), body)
