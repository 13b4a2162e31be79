"""Figures 14 and 15: a satellite on a circular orbit, by the exact flow and by McLachlan-Reich.

They tell whether 7 and 10 digits of the energy are kept at steps of 0.1 and 0.05. Schemes for a small potential at the
same number of torque evaluations are added.
"""

import sys

import common
import matplotlib.pyplot as plt
import numpy as np

from openmm_exactrb.problems import Satellite, energy, integrate
from openmm_exactrb.quaternions import matrix
from openmm_exactrb.schemes import scheme

NAME = "satellite"
TITLE = "Figures 14 and 15: satellite simulation"
STEPS = (0.1, 0.05)
LINES = (
    ("V2", "mclachlan_reich"),
    ("SRKN6_14a", "exact"),
    ("V2", "exact"),
    ("S6_10", "exact"),
    ("SABA_4", "exact"),
    ("ABA_10_6_4", "exact"),
    ("V2_C17", "exact"),
    ("V2_gradient_C17", "exact"),
)
DRAWN = {14: LINES[0], 15: LINES[1]}


def run(name, method, h, T):
    """Return times, the axis Q^T e3 and the relative error of the energy along a run."""
    satellite, state = Satellite.paper()
    start = energy(satellite, state)[0]
    every = max(1, round(0.4 / h))
    times, axes, errors = [0.0], [matrix(state[0])[2, :, 0]], [0.0]
    for _ in range(round(T / h) // every):
        state = integrate(satellite, state, h, every, scheme(name), method)
        times.append(times[-1] + every * h)
        axes.append(matrix(state[0])[2, :, 0])
        errors.append(energy(satellite, state)[0] / start - 1.0)
    return {"t": times, "axis": axes, "error": errors, "H0": start}


def compute(quick):
    T = 40.0 if quick else 400.0
    evaluations = {h: scheme("SRKN6_14a").stages / h for h in STEPS}
    pieces = []
    for name, method in LINES:
        for h in STEPS:
            # The paper's method with the paper's step; all others with as many evaluations as SRKN6_14a.
            own = h if method == "mclachlan_reich" else scheme(name).stages / evaluations[h]
            pieces.append({"name": name, "method": method, "h": own, "T": T})
    data = {}
    for piece, (line, h), result in zip(
        pieces, [(line, h) for line in LINES for h in STEPS], common.in_pieces(NAME, run, pieces), strict=True
    ):
        entry = {"step": piece["h"], "largest": float(np.max(np.abs(result["error"]))), "H0": result["H0"]}
        if line in DRAWN.values():
            entry |= {
                "t": np.round(result["t"], 6),
                "axis": np.round(result["axis"], 5),
                "error": [float(f"{e:.4g}") for e in result["error"]],
            }
        data[" ".join(line) + f" {h}"] = entry
    return data


def draw(data):
    for number, line in DRAWN.items():
        figure = plt.figure(figsize=(9.0, 7.5), layout="constrained")
        for k, h in enumerate(STEPS):
            entry = data[" ".join(line) + f" {h}"]
            sphere = figure.add_subplot(2, 2, 2 * k + 1, projection="3d")
            sphere.plot(*np.array(entry["axis"]).T, color=common.COLOURS[0], lw=0.4, marker=".", ms=1.5)
            sphere.set_box_aspect((1, 1, 1))
            sphere.set_xlabel("$u_1$")
            sphere.set_ylabel("$u_2$")
            sphere.set_zlabel("$u_3$")
            sphere.set_title(f"$Q^T e_3$, h = {h}")
            axis = figure.add_subplot(2, 2, 2 * k + 2)
            axis.plot(entry["t"], entry["error"], color=common.COLOURS[1], lw=0.7)
            axis.set_xlabel("time")
            axis.set_ylabel("relative energy error")
            axis.grid(True, alpha=0.3)
        figure.suptitle(f"satellite, {line[0]} + {line[1]}")
        yield f"figure{number}", figure


def table(data):
    rows = []
    for line in LINES:
        entries = [data[" ".join(line) + f" {h}"] for h in STEPS]
        rows.append((" + ".join(line), *(f"{e['largest']:.1e} (step {e['step']:.4g})" for e in entries)))
    return common.markdown(
        ("scheme + rotor", "as SRKN6_14a at h = 0.1: 140 evaluations a unit of time", "h = 0.05: 280"), rows
    )


def claims(data):
    H0 = data["SRKN6_14a exact 0.1"]["H0"]
    yield common.Claim("H0 = 1.21595664e7.", f"{H0:.9g}.", abs(H0 - 1.21595664e7) < 1.0)
    ours = [data[f"SRKN6_14a exact {h}"]["largest"] for h in STEPS]
    yield common.Claim(
        "SRKN6_14a with the exact rotor has relative energy errors of the order 1e-7 at h = 0.1 and 1e-10 at h = 0.05.",
        f"{ours[0]:.1e} and {ours[1]:.1e}.",
        3e-8 < ours[0] < 3e-7 and 3e-11 < ours[1] < 1e-9,
    )
    other = [data[f"V2 mclachlan_reich {h}"]["largest"] for h in STEPS]
    yield common.Claim(
        "The corresponding plots for the MR method are worse (figure 14; the text gives no number).",
        f"McLachlan-Reich leaves {other[0]:.1e} and {other[1]:.1e} at the same steps, with a fourteenth of the evaluations.",
        all(o > s for o, s in zip(other, ours, strict=True)),
    )
    best = data["ABA_10_6_4 exact 0.05"]["largest"]
    yield common.Claim(
        "Beyond the paper: ABA(10,6,4) leaves at most 1/100 of SRKN6_14a's error at 280 evaluations a unit of time.",
        f"{best:.1e} against {ours[1]:.1e}: 1/{ours[1] / best:.0f}.",
        best <= 0.01 * ours[1],
    )


if __name__ == "__main__":
    common.main(sys.modules[__name__])
