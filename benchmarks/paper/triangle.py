"""Figures 3 to 11: the triangle of inertias, and significant digits of the orientation over it, for steps of 0.4 and 0.04.

The figures show for which moments of inertia each method rotates a body accurately. The methods are the exact methods,
their approximations by Gauss's rule of order 6, 8 and 10, and the preprocessed discrete Moser-Veselov methods of the
same orders. The reference is a Taylor series in double-double precision, whereas the paper used Matlab's ode45. The
corner at the top left, where I1 is much smaller than I2 and I3, contains thin rods (the paper calls them discs). Each
point is the mean over 20 momenta. White lines mark 2, 4, ... 12 correct digits of the orientation at t = 10. The
pictures are smoothed over neighbouring points, but the numbers are not.
"""

import sys
import warnings

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.paper import common
from benchmarks.paper.claims import Claim, Criterion
from benchmarks.paper.reference import taylor
from openmm_exactrb.errors import NotConvergedWarning
from openmm_exactrb.rotors import rotor

NAME = "triangle"
TITLE = "Figures 3 to 11: digits over the triangle of inertias"
STEPS = (0.4, 0.04)
PICTURES = {
    "figure03": "The triangle of moments of inertia, I2/I3 over I1/I3. Its corners are the thin rod at the top left, the sphere "
    "at the top right and the flat disc at the bottom. The paper's water molecule lies on the side of flat bodies.",
    "figure04": "Both exact methods, h = 0.4: 14 digits in the whole triangle.",
    "figure05": "Order 6, h = 0.4: the two methods with Gauss's rule rise from 0 to 5 digits at the thin rod to 14 along the "
    "side of symmetric bodies; dmv6 has 2 to 5 digits everywhere.",
    "figure06": "Order 8, h = 0.4: the methods with Gauss's rule have 14 digits in the right third of the triangle and few at "
    "the thin rod; dmv8 has 4 to 8 digits.",
    "figure07": "Order 10, h = 0.4: the methods with Gauss's rule have 13 to 14 digits in the right half of the triangle and "
    "few at the thin rod; dmv10 has 5 to 11 digits.",
    "figure08": "Both exact methods, h = 0.04: 13 to 14 digits, slightly fewer on the left than on the right.",
    "figure09": "Order 6, h = 0.04: the methods with Gauss's rule have 14 digits in the right half and lose them towards the "
    "thin rod, quaternion_gauss6 most; dmv6 rises from 3 digits there to 11 at the sphere.",
    "figure10": "Order 8, h = 0.04: rotation_gauss8 has 13 to 14 digits almost everywhere; quaternion_gauss8 and dmv8 have "
    "few digits at the thin rod.",
    "figure11": "Order 10, h = 0.04: all three methods have 14 digits except in a small corner at the thin rod.",
}
#: Pictures that the page shows next to each other, below what they share.
SHEET = {
    "h = 0.4": ("figure04", "figure05", "figure06", "figure07"),
    "h = 0.04": ("figure08", "figure09", "figure10", "figure11"),
}
T = 10.0
EXACT = ("rotation", "quaternion_a")
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
    columns, rows, momenta = (12, 3, 2) if quick else (100, 50, 20)
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
    data = {"x": x.round(6), "y": y.round(6), "momenta": momenta, "methods": {}}
    for key in rows[0]:
        data["methods"][key] = {
            "digits": [row[key]["digits"] for row in rows],
            "failures": sum(row[key]["failures"] for row in rows),
            "worst": max(row[key]["worst"] or 0.0 for row in rows),
        }
    return data


#: Width in points of the Gaussian window that the pictures are smoothed with; the numbers are not.
WINDOW = 2.0


def smoothed(values):
    """Return the digits of a method smoothed over neighbouring points, without those where no run converged."""
    known = values >= 0.0
    weight = gaussian_filter(known.astype(float), WINDOW, mode="nearest")
    return np.ma.masked_less(gaussian_filter(np.where(known, values, 0.0), WINDOW, mode="nearest"), 0.0) / weight


def draw(data):
    yield "figure03", domain(data)
    x, y = np.array(data["x"]), np.array(data["y"])
    for number, (h, methods) in FIGURES.items():
        figure, axes = plt.subplots(
            len(methods), 1, figsize=(4.8, 1.55 * len(methods)), sharex=True, layout="constrained"
        )
        for axis, method in zip(axes, methods, strict=True):
            values = smoothed(np.array(data["methods"][f"{method} {h}"]["digits"]))
            bands = axis.contourf(x, y, values, levels=range(17), cmap="viridis")
            axis.contour(x, y, values, levels=range(2, 13, 2), colors="white", linewidths=0.7)
            axis.set_title(method, fontsize=10)
            axis.set_ylabel("$I_2/I_3$")
        axes[-1].set_xlabel("$I_1/I_3$")
        figure.colorbar(bands, ax=axes, label="digits", ticks=range(0, 17, 2))
        figure.suptitle(f"figure {number}: h = {h}", fontsize=10)
        yield f"figure{number:02d}", figure


def domain(data):
    """Draw the triangle of inertias, with the bodies at its corners and sides."""
    figure, axis = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    axis.fill([0, 0.5, 1], [1, 0.5, 1], color=common.COLOURS[5], alpha=0.25)
    axis.plot([0, 0.5, 1, 0], [1, 0.5, 1, 1], color=common.COLOURS[0], lw=1.5)
    x, y = np.array(data["x"]), np.array(data["y"])
    axis.plot(x[::5, ::5].ravel(), y[::5, ::5].ravel(), ls="", marker=".", ms=2, color="0.4")
    for words, place, text, side in (
        ("thin rod\n$I_1 \\ll I_2 = I_3$", (0, 1), (0.0, 0.83), "left"),
        ("sphere\n$I_1 = I_2 = I_3$", (1, 1), (0.98, 0.80), "right"),
        ("flat disc\n$I_1 = I_2 = I_3/2$", (0.5, 0.5), (0.73, 0.52), "left"),
        ("the paper's water", (1 / 2.88, 1.88 / 2.88), (0.22, 0.6), "right"),
    ):
        axis.annotate(words, place, text, ha=side, va="center", fontsize=9, arrowprops={"arrowstyle": "->", "lw": 0.8})
    axis.plot(*(1 / 2.88, 1.88 / 2.88), marker="o", ms=5, color=common.COLOURS[1])
    axis.text(0.5, 1.012, "symmetric, $I_2 = I_3$", ha="center", fontsize=9)
    axis.text(0.19, 0.765, "flat, $I_1 + I_2 = I_3$", ha="center", va="center", rotation=-39, fontsize=9)
    axis.text(0.785, 0.745, "symmetric, $I_1 = I_2$", ha="center", va="center", rotation=39, fontsize=9)
    axis.set_xlabel("$I_1/I_3$")
    axis.set_ylabel("$I_2/I_3$")
    axis.set_xlim(-0.03, 1.03)
    axis.set_ylim(0.47, 1.05)
    axis.set_title("the triangle of inertias; dots: every 25th point of the grid", fontsize=10)
    return figure


def rows(data):
    """Return for each step and method: median and mean over points, least at a point, and failures."""
    found = {}
    for key, entry in data["methods"].items():
        values = np.array(entry["digits"])
        values = values[values >= 0.0]
        total = len(data["x"]) * len(data["x"][0]) * data["momenta"]
        found[key] = (float(np.median(values)), float(values.mean()), float(values.min()), entry["failures"] / total)
    return found


def table(data):
    lines = []
    for key, (median, mean, least, failures) in rows(data).items():
        method, h = key.split()
        lines.append((h, method, f"{median:.1f}", f"{mean:.1f}", f"{least:.1f}", f"{100 * failures:.1f} %"))
    return common.markdown(
        ("h", "method", "digits, median over points", "mean", "least at a point", "no convergence"), lines
    )


def corner(data, key):
    """Return the mean digits in the thin corner x < 0.1 and the median elsewhere."""
    x, values = np.array(data["x"]), np.array(data["methods"][key]["digits"])
    values = np.where(values < 0.0, 0.0, values)
    return float(values[x < 0.1].mean()), float(np.median(values[x >= 0.1]))


def claims(data):
    found = rows(data)
    yield from coarse(data, found)
    median = {key: entry[0] for key, entry in found.items()}
    yield Claim(
        "For h = 0.04 the exact methods reveal a worse accumulation of roundoff (figure 8).",
        "median digits at h = 0.4 and 0.04: "
        + ", ".join(f"{m} {median[f'{m} 0.4']:.1f} and {median[f'{m} 0.04']:.1f}" for m in (*EXACT, "dmv10"))
        + ".",
        (
            Criterion.of("both lose digits", all(median[f"{m} 0.04"] < median[f"{m} 0.4"] for m in EXACT)),
            Criterion.of(
                "at h = 0.04 both have fewer digits than dmv10",
                all(median[f"{m} 0.04"] < median["dmv10 0.04"] for m in EXACT),
            ),
        ),
    )
    inside, outside = corner(data, "dmv10 0.04")
    yield Claim(
        "For h = 0.04 dmv10 performs very well in the whole triangle but for the top left corner (figure 11).",
        f"median {outside:.1f} digits outside the corner I1 < 0.1 I3, and mean {inside:.1f} digits inside.",
        (
            Criterion.of("at least 13 digits in the median outside the corner", outside >= 13.0),
            Criterion.of("at least 2 digits fewer in the corner", inside <= outside - 2.0),
        ),
    )


def coarse(data, found):
    """Judge what is said of h = 0.4."""
    exact = [found[f"{m} 0.4"] for m in EXACT]
    yield Claim(
        "For h = 0.4 the exact methods perform very similarly and show a uniform accuracy (figure 4).",
        f"medians {exact[0][0]:.1f} and {exact[1][0]:.1f} digits, smallest values at a point {exact[0][2]:.1f} and {exact[1][2]:.1f}.",
        (
            Criterion.of("the medians differ by less than half a digit", abs(exact[0][0] - exact[1][0]) < 0.5),
            Criterion.of("no point is 2 digits below the median", all(e[0] - e[2] < 2.0 for e in exact)),
        ),
    )
    approximate = [
        key for key in found if key.endswith(" 0.4") and key.startswith(("dmv", "rotation_", "quaternion_g"))
    ]
    thin = {key.split()[0]: corner(data, key) for key in approximate}
    yield Claim(
        "All approximate methods are worse near the corner where I1 is much smaller than I2 and I3 (figures 5 to 7).",
        "mean digits in the corner I1 < 0.1 I3, and median elsewhere: "
        + ", ".join(f"{name} {a:.1f} and {b:.1f}" for name, (a, b) in thin.items())
        + ".",
        (
            Criterion.of(
                "at least one digit fewer in the corner for all nine methods",
                all(a <= b - 1.0 for a, b in thin.values()),
            ),
        ),
    )
    pairs = [(f"dmv{n} 0.4", f"{kind}_gauss{n} 0.4") for n in (6, 8, 10) for kind in ("rotation", "quaternion")]
    failures = [found[f"dmv{n} 0.4"][3] for n in (6, 8, 10)]
    yield Claim(
        "For h = 0.4 the dmv methods are less accurate on average than Gauss's rule of the same order, and fail for "
        "several initial conditions.",
        "mean digits "
        + ", ".join(f"{a.split()[0]} {found[a][1]:.1f} against {b.split()[0]} {found[b][1]:.1f}" for a, b in pairs)
        + "; runs without convergence with dmv6, dmv8 and dmv10: "
        + ", ".join(f"{100 * failed:.1f} %" for failed in failures)
        + ".",
        (
            Criterion.of("fewer digits on average in all six pairs", all(found[a][1] < found[b][1] for a, b in pairs)),
            Criterion.of("each of the three methods fails for some initial conditions", min(failures) > 0.0),
        ),
    )


if __name__ == "__main__":
    common.main(sys.modules[__name__])
