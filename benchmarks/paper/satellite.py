"""Figures 14 and 15: a satellite on a circular orbit, by the exact flow and by McLachlan-Reich.

The paper reports 7 and 10 conserved digits of the energy at steps of 0.1 and 0.05. We added schemes for a small
potential, at the same numbers of torque evaluations per unit of time.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.paper import common
from benchmarks.paper.claims import Claim, Criterion
from benchmarks.paper.problems import Satellite, energy, integrate
from openmm_exactrb.mathematics.quaternions import matrix
from openmm_exactrb.schemes import scheme

NAME = "satellite"
TITLE = "Figures 14 and 15: satellite simulation"
PICTURES = {
    "figure14": "Verlet with McLachlan-Reich. At h = 0.1 the axis of the satellite covers the whole sphere and the energy error exceeds 1; "
    "at h = 0.05 the axis draws lines in the upper half of the sphere and the error stays below 0.01.",
    "figure15": "SRKN6_14a with the exact rotor. At both steps the axis draws the same lines in the upper half of the sphere, and the "
    "energy error scatters without drift: about 1e-7 at h = 0.1, 4e-10 at h = 0.05.",
}
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
        figure, axes = plt.subplots(2, 2, figsize=(7.0, 5.4), sharex="col", layout="constrained")
        drawn = [data[" ".join(line) + f" {h}"]["axis"] for h in STEPS]
        bottom = -0.05 if np.array(drawn)[:, :, 2].min() >= 0.0 else -1.05
        for (left, right), h in zip(axes, STEPS, strict=True):
            entry = data[" ".join(line) + f" {h}"]
            u = np.array(entry["axis"])
            azimuth = np.degrees(np.arctan2(u[:, 1], u[:, 0]))
            left.plot(azimuth, u[:, 2], color=common.COLOURS[0], ls="", marker="o", ms=2, mew=0, alpha=0.7)
            left.set_xticks(range(-180, 181, 90))
            left.set_ylim(bottom, 1.05)
            left.set_ylabel("$u_3$")
            left.set_title(f"axis $u = Q^T e_3$, h = {h}", fontsize=10)
            right.plot(entry["t"], entry["error"], color=common.COLOURS[1], ls="", marker="o", ms=2, mew=0, alpha=0.7)
            right.set_ylabel("energy error")
            right.set_title(f"largest {entry['largest']:.1e}, h = {h}", fontsize=10)
            for axis in (left, right):
                axis.grid(True, alpha=0.3)
        axes[1, 0].set_xlabel("azimuth of u about $e_3$ (degrees)")
        axes[1, 1].set_xlabel("time (the paper's units)")
        names = {"exact": "exact rotor", "mclachlan_reich": "McLachlan-Reich"}
        figure.suptitle(f"satellite, {line[0]} with {names[line[1]]}: a dot every 0.4 of time", fontsize=11)
        yield f"figure{number}", figure


def table(data):
    rows = []
    for line in LINES:
        entries = [data[" ".join(line) + f" {h}"] for h in STEPS]
        rows.append((" + ".join(line), *(f"{e['largest']:.1e} (step {e['step']:.4g})" for e in entries)))
    return common.markdown(
        ("scheme + rotor", "as SRKN6_14a at h = 0.1: 140 evaluations per unit of time", "h = 0.05: 280"), rows
    )


def claims(data):
    H0 = data["SRKN6_14a exact 0.1"]["H0"]
    yield Claim(
        "H0 = 1.21595664e7.", f"{H0:.10g}.", (Criterion.of("the nine printed digits", abs(H0 - 1.21595664e7) < 0.1),)
    )
    ours = [data[f"SRKN6_14a exact {h}"]["largest"] for h in STEPS]
    printed = dict(zip(STEPS, (-7, -10), strict=True))
    yield Claim(
        "SRKN6_14a with the exact rotor has relative energy errors of the order 1e-7 at h = 0.1 and 1e-10 at h = 0.05: H0 is "
        "preserved to 7 and 10 digits.",
        f"{ours[0]:.1e} and {ours[1]:.1e}: {-np.log10(ours[0]):.1f} and {-np.log10(ours[1]):.1f} digits.",
        (
            *(
                Criterion.of(f"h = {h}: the power of ten is {power}", int(np.floor(np.log10(e))) == power)
                for (h, power), e in zip(printed.items(), ours, strict=True)
            ),
            *(
                Criterion.of(
                    f"h = {h}: at least {-power} digits when rounded", round(-np.log10(e)) >= -power, ours=True
                )
                for (h, power), e in zip(printed.items(), ours, strict=True)
            ),
        ),
    )
    other = [data[f"V2 mclachlan_reich {h}"]["largest"] for h in STEPS]
    yield Claim(
        "The splitting with the exact rigid body is very accurate (figure 15; figure 14 shows McLachlan-Reich).",
        f"Verlet with McLachlan-Reich has errors of {other[0]:.1e} and {other[1]:.1e} at the same steps, with a fourteenth of "
        f"the evaluations. Verlet with the exact rotor and the same number of evaluations as SRKN6_14a has errors of "
        f"{data['V2 exact 0.1']['largest']:.1e} and {data['V2 exact 0.05']['largest']:.1e}.",
        tuple(
            Criterion.of(
                f"h = {h}: the error of SRKN6_14a is less than 1/1000 of that of McLachlan-Reich", s < 1e-3 * o
            )
            for h, s, o in zip(STEPS, ours, other, strict=True)
        ),
    )
    best = data["ABA_10_6_4 exact 0.05"]["largest"]
    yield Claim(
        "The error of ABA_10_6_4 is at most 1/100 of SRKN6_14a's at 280 evaluations per unit of time.",
        f"{best:.1e} against {ours[1]:.1e}: 1/{ours[1] / best:.0f}.",
        (Criterion.of("at most 1/100", best <= 0.01 * ours[1]),),
        ours=True,
    )


if __name__ == "__main__":
    common.main(sys.modules[__name__])
