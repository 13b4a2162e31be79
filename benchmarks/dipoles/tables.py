"""Tables of dipole_scale.py, dipole_devices.py, and the dielectric constants of examples/dielectric_constant.py."""

from __future__ import annotations

import math

from benchmarks.common.markdown import distinct, rows, table
from benchmarks.common.records import Row


def dipole_costs() -> str:
    """Return the time of an evaluation at equal measured errors, on one core: ours and that of LAMMPS."""
    found, body = rows("dipole_scale"), []
    levels = {"1e-3": 1e-3, "1e-4": 1e-4, "1e-5": 1e-5}
    for (n,) in distinct(found, "n"):
        of = [row for row in found if (row["n"], row["cores"]) == (n, "1") and row["level"]]

        def least(who: str, level: float, of: list[Row] = of) -> float:
            times = (float(row["ms"]) for row in of if row["who"] == who and float(row["level"]) <= level)
            return min(times, default=math.inf)

        pairs = [tuple(least(who, level) for who in ("rb.Ewald", "LAMMPS")) for level in levels.values()]
        if math.isfinite(pairs[1][1]):
            cells = (f"{ours:.3g}, {theirs:.3g}" for ours, theirs in pairs)
            body.append((n, *cells))
    return table(("dipoles", *(f"errors up to {name}" for name in levels)), body)


def dipole_memory() -> str:
    """Return the memory of a process with the fewest and with the most dipoles."""
    found = [row for row in rows("dipole_scale") if row["process_MB"]]
    few, many = (
        f"{row['process_MB']} MB with {int(row['n']):,} dipoles".replace(",", " ") for row in found[:: len(found) - 1]
    )
    return f"{few} and {many}"


def largest_error() -> float:
    """Return the largest error of forces and torques of rb.Ewald, divided by the tolerance."""
    found = [row for row in rows("dipole_scale") if row["who"] == "rb.Ewald"]
    return max(float(row[name]) / float(row["tolerance"]) for row in found for name in ("force_error", "torque_error"))


def dipole_bonds() -> str:
    """Return errors and times of the two forces of OpenMM for a reaction field, without those of scaled energies."""
    body = [
        (row["precision"], f'`"{row["kernel"]}"`', row["force error"], row["torque error"], row["ms"])
        for row in rows("dipole_bonds")
        if float(row["energies scaled by"]) == 1.0
    ]
    return table(("precision", "`kernel`", "error of forces", "of torques", "ms"), body)


def dipole_rods() -> str:
    """Return the errors of forces and torques of rods of charges of the length that a tolerance chooses."""
    found, body = rows("dipole_rods"), []
    for (tolerance,) in distinct(found, "tolerance"):
        some = [row for row in found if row["tolerance"] == tolerance]
        lengths = sorted({float(row["length (sigma)"]) for row in some})
        chosen = [row for row in some if float(row["length (sigma)"]) == lengths[len(lengths) // 2]]  # of one or three
        errors = {row["precision"]: (row["force error"], row["torque error"]) for row in chosen}
        body.append((tolerance, *errors["single"], *errors["double"]))
    return table(("tolerance", "forces, single", "torques, single", "forces, double", "torques, double"), body)


def stockmayer_constants() -> str:
    """Return dielectric constants of the Stockmayer fluid, with the mean of six equal runs."""
    return _constants("stockmayer")


def ferrofluid_constants() -> str:
    """Return those of the ferrofluid."""
    return _constants("ferrofluid")


def _constants(fluid: str) -> str:
    found, body = [row for row in rows("dielectric") if row["fluid"] == fluid], []
    what = ("mu2_over_kT", "program", "boundary", "dipoles", "ps")
    for point in distinct(found, *what):
        some = [row for row in found if tuple(row[name] for name in what) == point]
        seeds = [row for row in some if row["options"].startswith("--seed")]
        strength, program, boundary, dipoles, ps = point
        method = ", ".join(filter(None, (program if program != "this package" else "", boundary)))
        for row in [row for row in some if row not in seeds]:
            body.append((strength, method, dipoles, " ".join((ps, row["options"])).strip(), _constant([row])))
        if seeds:
            body.append((strength, method, dipoles, f"{len(seeds)} × {ps}", _constant(seeds)))
    return table(("mu²/kT", "method", "dipoles", "ps", "dielectric constant"), body)


def _constant(some: list[Row]) -> str:
    """Return the mean of a dielectric constant over independent runs, and its error."""
    value = sum(float(row["epsilon"]) for row in some) / len(some)
    digits = len(some[0]["epsilon"].partition(".")[2])
    if not some[0]["error"]:
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} ± {math.hypot(*(float(row['error']) for row in some)) / len(some):.{digits}f}"


def dipole_droplets() -> str:
    """Return the relative energy errors of a droplet of dipoles, by dipole_droplet.py."""
    found, body = rows("dipole_droplet"), []
    for point in distinct(found, "scheme", "rotor", "step"):
        some = [row for row in found if (row["scheme"], row["rotor"], row["step"]) == point]
        forces = round(sum(int(row["forces"]) for row in some) / len(some), -2)
        errors = ", ".join(f"{float(row['relative_std']):.1e}".replace("e-0", "e-") for row in some)
        body.append((f"{point[0]} + {point[1]}", f"{float(point[2]):.2g}", f"{forces:g}", errors))
    return table(("scheme + rotor", "step", "force evaluations", "relative energy error"), body)


def droplet_gains() -> tuple[float, float]:
    """Return by how many times the error of W4_4 is below that of `VerletIntegrator`, at least and at most."""
    errors = {(row["scheme"], row["seed"]): float(row["relative_std"]) for row in rows("dipole_droplet")}
    gains = [errors["VerletIntegrator", seed] / errors["W4_4", seed] for scheme, seed in errors if scheme == "W4_4"]
    return min(gains), max(gains)
