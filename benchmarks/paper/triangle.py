"""Figures 4 to 11: significant digits of the attitude over the triangle of inertias, for steps of 0.4 and 0.04.

They tell for which bodies each method is good: the exact ones, their approximations by Gauss's rule of order 6, 8 and
10, and the preprocessed discrete Moser-Veselov methods of the same orders. The reference is a Taylor series in
double-double precision; the paper took Matlab's ode45 at its tolerance.
"""

import sys
import warnings

import common
import matplotlib.pyplot as plt
import numpy as np
from reference import taylor

from openmm_exactrb.rotors import NotConvergedWarning, rotor

NAME = "triangle"
TITLE = "Figures 4 to 11: digits over the triangle of inertias"
STEPS = (0.4, 0.04)
T = 10.0
EXACT = ("rotation", "quaternion_a", "exact")
FIGURES = {
    4: (0.4, EXACT),
    5: (0.4, ("rotation_gauss6", "quaternion_gauss6", "dmv6")),
    6: (0.4, ("rotation_gauss8", "quaternion_gauss8", "dmv8")),
    7: (0.4, ("rotation_gauss10", "quaternion_gauss10", "dmv10")),
    8: (0.04, EXACT),
    9: (0.04, ("rotation_gauss6", "quaternion_gauss6", "dmv6")),
    10: (0.04, ("rotation_gauss8", "quaternion_gauss8", "dmv8")),
    11: (0.04, ("rotation_gauss10", "quaternion_gauss10", "dmv10")),
}


def grid(quick):
    """Return x = I1/I3 and y = I2/I3 (rows, columns) inside the triangle 1 - y <= x <= y < 1, and momenta a point."""
    columns, rows, momenta = (12, 6, 2) if quick else (100, 50, 20)
    y = 0.5 + 0.5 * (np.arange(rows)[:, None] + 0.5) / rows
    return (1.0 - y) + (2.0 * y - 1.0) * (np.arange(columns) + 0.5) / columns, y * np.ones(columns), momenta


def bodies(quick, row):
    """Return inertia (3, n) and momenta (3, n) of the points of a row, each with its random momenta."""
    x, y, momenta = grid(quick)
    inertia = np.repeat(np.stack([x[row], y[row], np.ones_like(x[row])]), momenta, axis=1)
    m = np.abs(np.random.default_rng((14, row)).standard_normal(inertia.shape))
    return inertia, m / np.linalg.norm(m, axis=0)


def digits(quick, row):
    """Return the mean digits at each point of a row and the number of failures, by step and method."""
    inertia, m = bodies(quick, row)
    momenta = grid(quick)[2]
    reference, _ = taylor(inertia, m, T)
    result = {}
    for h in STEPS:
        for method in dict.fromkeys(method for step, methods in FIGURES.values() if step == h for method in methods):
            flow = rotor(method, inertia.T)
            q, p = common.unit_attitudes(m.shape[1]), m
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", NotConvergedWarning)  # counted below
                for _ in range(round(T / h)):
                    q, p = flow(q, p, h)
            error = common.attitude_errors(q, reference).reshape(-1, momenta)
            failed = np.isnan(error)
            value = -np.log10(np.maximum(error, 1e-17))
            counts = (~failed).sum(axis=1)
            mean = np.where(failed, 0.0, value).sum(axis=1) / np.maximum(counts, 1)
            result[f"{method} {h}"] = {
                "digits": np.where(counts > 0, np.round(mean, 2), -1.0),  # -1: no run converged
                "failures": int(failed.sum()),
                "worst": float(np.nanmax(error)) if counts.any() else None,
            }
    return result


def compute(quick):
    x, y, momenta = grid(quick)
    rows = common.in_pieces(NAME, digits, [{"quick": quick, "row": row} for row in range(len(x))])
    data = {"x": x, "y": y, "momenta": momenta, "methods": {}}
    for key in rows[0]:
        data["methods"][key] = {
            "digits": [row[key]["digits"] for row in rows],
            "failures": sum(row[key]["failures"] for row in rows),
            "worst": max(row[key]["worst"] or 0.0 for row in rows),
        }
    return data


def draw(data):
    x, y = np.array(data["x"]), np.array(data["y"])
    for number, (h, methods) in FIGURES.items():
        figure, axes = plt.subplots(
            len(methods), 1, figsize=(7.0, 2.3 * len(methods)), sharex=True, layout="constrained"
        )
        for axis, method in zip(axes, methods, strict=True):
            values = np.ma.masked_less(np.array(data["methods"][f"{method} {h}"]["digits"]), 0.0)
            mesh = axis.pcolormesh(x, y, values, vmin=0.0, vmax=16.0, cmap="viridis", shading="gouraud")
            axis.contour(x, y, values, levels=range(2, 17, 2), colors="white", linewidths=0.5)
            axis.set_title(f"{method}, h = {h}", fontsize=10)
            axis.set_ylabel("$I_2/I_3$")
            axis.set_facecolor("0.85")
        axes[-1].set_xlabel("$I_1/I_3$")
        figure.colorbar(mesh, ax=axes, label="significant digits of the attitude at t = 10")
        yield f"figure{number:02d}", figure


def rows(data):
    """Return for each step and method: median over points, least at a point, and failures."""
    found = {}
    for key, entry in data["methods"].items():
        values = np.array(entry["digits"])
        values = values[values >= 0.0]
        total = len(data["x"]) * len(data["x"][0]) * data["momenta"]
        found[key] = (float(np.median(values)), float(values.min()), entry["failures"] / total)
    return found


def table(data):
    lines = []
    for key, (median, least, failures) in rows(data).items():
        method, h = key.split()
        lines.append((h, method, f"{median:.1f}", f"{least:.1f}", f"{100 * failures:.1f} %"))
    return common.markdown(("h", "method", "digits, median over points", "least at a point", "no convergence"), lines)


def corner(data, key):
    """Return the mean digits in the thin corner x < 0.1 and the median elsewhere."""
    x, values = np.array(data["x"]), np.array(data["methods"][key]["digits"])
    values = np.where(values < 0.0, 0.0, values)
    return float(values[x < 0.1].mean()), float(np.median(values[x >= 0.1]))


def claims(data):
    found = rows(data)
    exact = [found[f"{m} 0.4"] for m in EXACT[:2]]
    yield common.Claim(
        "For h = 0.4 the exact methods perform very similarly and show a uniform accuracy (figure 4).",
        f"medians {exact[0][0]:.1f} and {exact[1][0]:.1f} digits, least at a point {exact[0][1]:.1f} and {exact[1][1]:.1f}.",
        abs(exact[0][0] - exact[1][0]) < 1.0 and min(e[1] for e in exact) > 12.0,
    )
    approximate = [
        key for key in found if "0.4" in key.split()[1] and ("gauss" in key or "dmv" in key) and key.endswith(" 0.4")
    ]
    thin = {key: corner(data, key) for key in approximate}
    yield common.Claim(
        "All approximate methods are worse near the corner where I1 is much smaller than I2 and I3 (figures 5 to 7).",
        "digits in the corner I1 < 0.1 and elsewhere: "
        + ", ".join(f"{key.split()[0]} {a:.1f} and {b:.1f}" for key, (a, b) in thin.items())
        + ".",
        all(a < b for a, b in thin.values()),
    )
    pairs = [(f"dmv{n} 0.4", f"{kind}_gauss{n} 0.4") for n in (6, 8, 10) for kind in ("rotation", "quaternion")]
    failures = [found[f"dmv{n} 0.4"][2] for n in (6, 8, 10)]
    yield common.Claim(
        "For h = 0.4 the dmv methods are less accurate on average than Gauss's rule of the same order, and fail for several initial values.",
        ", ".join(f"{a.split()[0]} {found[a][0]:.1f} against {b.split()[0]} {found[b][0]:.1f}" for a, b in pairs)
        + " digits; without convergence "
        + ", ".join(f"{100 * failed:.1f} %" for failed in failures)
        + ".",
        all(found[a][0] < found[b][0] for a, b in pairs) and min(failures) > 0.0,
    )
    fine = [(found[f"{m} 0.4"][0], found[f"{m} 0.04"][0]) for m in EXACT]
    yield common.Claim(
        "For h = 0.04 the exact methods show a worse accumulation of roundoff (figure 8).",
        "digits at h = 0.4 and 0.04: "
        + ", ".join(f"{m} {a:.1f} and {b:.1f}" for m, (a, b) in zip(EXACT, fine, strict=True))
        + ".",
        all(b < a for a, b in fine),
    )
    dmv = found["dmv10 0.04"], corner(data, "dmv10 0.04")
    yield common.Claim(
        "For h = 0.04 dmv10 performs very well in the whole triangle but for the thin corner (figure 11).",
        f"median {dmv[0][0]:.1f} digits, in the corner {dmv[1][0]:.1f}, elsewhere {dmv[1][1]:.1f}.",
        dmv[1][1] > 13.0 and dmv[1][0] < dmv[1][1],
    )


if __name__ == "__main__":
    common.main(sys.modules[__name__])
