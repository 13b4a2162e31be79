"""Figures 12 and 13: energy error of the heavy top as a perturbed free body, for five kinetic energies.

The figures show the gain of an exact free flow if the potential is a perturbation. We added schemes for a small
potential, which require an exact flow. The paper reports the mean over 20 tops of the relative energy error. For each
top, we use the largest relative energy error at a hundred equidistant times (ten for a processed scheme). The verdicts
are based on five draws of 20 tops, at the basic steps 8, 5 and 4. The pictures, the table and the slope of S6_10 with
McLachlan-Reich are for the first draw.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.paper import common
from benchmarks.paper.claims import Claim, Criterion
from benchmarks.paper.problems import HeavyTop, energy, integrate
from openmm_exactrb.schemes import scheme

NAME = "tops"
TITLE = "Figures 12 and 13: the heavy top as a perturbed free body"
PICTURES = {
    "figure12": "Fifteen panels for ε = 1e-6: five kinetic energies, three groups of methods. With the exact rotor, errors are "
    "below ε, except for the longest steps at T0 = 1, where they fall steeply. With McLachlan-Reich, errors are 0.01 to 1 "
    "for long steps at T0 = 1, and near 1 for all steps at larger T0. The schemes for a small potential have the smallest "
    "errors at T0 = 1.",
    "figure13": "The same fifteen panels for ε = 1e-3. With the exact rotor, errors are below ε, except for the longest steps at "
    "T0 = 1. With McLachlan-Reich, errors are near 1 at larger T0. At T0 = 1 with the longest steps, the error of "
    "V2_gradient_C17 is 2e-9, whereas those of the paper's schemes are at least 8e-5.",
}
EPSILONS = (1e-6, 1e-3)
ENERGIES = ("ε²", "ε", "1", "1/ε", "1/ε²")
POWERS = (2, 1, 0, -1, -2)
H = (8.0, 5.0, 4.0, 2.0, 1.75, 1.5, 1.25, 1.0, 0.5)
PAPER = ("V2", "S4_6", "SRKN4_6b", "S6_10", "SRKN6_14a")
OURS = ("SABA_4", "ABA_8_6_4", "ABA_10_6_4", "V2_C17", "V2_gradient_C17")
TOPS = 20
#: Draws of the 20 tops by which the verdicts are reached; the picture is that of the first.
DRAWS = 5
#: The basic steps of all draws: the longest, where a method is above ε first, and the one of the table, 5.
DECIDING = (8.0, 5.0, 4.0)


def ensemble(draws, tops):
    """Return all tops of both figures as one problem, in the order draw, epsilon, energy, top, and their states."""
    drawn = [
        HeavyTop.random(np.random.default_rng((12, i, j, draw)), epsilon, epsilon**power, tops)
        for draw in range(draws)
        for i, epsilon in enumerate(EPSILONS)
        for j, power in enumerate(POWERS)
    ]
    problem = HeavyTop(
        np.hstack([top.inertia for top, _ in drawn]),
        np.tile(np.repeat(EPSILONS, len(POWERS) * tops), draws),
        np.hstack([top.direction for top, _ in drawn]),
    )
    return problem, tuple(np.hstack(parts) for parts in zip(*(state for _, state in drawn), strict=True))


def errors(name, method, h, draws, tops, T):
    """Return the largest relative energy error on [0, T], its mean over the tops of a draw: (draw, epsilon, energy)."""
    method_scheme = scheme(name)
    step = method_scheme.stages * h / 10.0
    problem, state = ensemble(draws, tops)
    start, largest = energy(problem, state), 0.0
    outputs = 10 if method_scheme.processor else 100
    done = 0
    for output in range(1, outputs + 1):
        n = round(output * T / outputs / step) - done
        if n:
            state = integrate(problem, state, step, n, method_scheme, method)
            done += n
            largest = np.maximum(largest, np.abs(energy(problem, state) / start - 1.0))
    means = np.reshape(largest, (draws, len(EPSILONS), len(POWERS), tops)).mean(axis=-1)
    return [[[float(f"{e:.3e}") for e in row] for row in draw] for draw in means]


def compute(quick):
    draws, tops, T = (2, 2, 40.0) if quick else (DRAWS, TOPS, 2000.0)
    lines = [(name, "exact") for name in PAPER + OURS] + [(name, "mclachlan_reich") for name in PAPER]
    pieces = [
        {"name": name, "method": method, "h": h, "draws": draws if h in DECIDING else 1, "tops": tops, "T": T}
        for h in H
        for name, method in lines
    ]
    data = {"h": H, "lines": {}, "draws": {}}
    for piece, means in zip(pieces, common.in_pieces(NAME, errors, pieces), strict=True):
        key = f"{piece['name']} {piece['method']}"
        data["lines"].setdefault(key, []).append(means[0])
        if piece["h"] in DECIDING:
            data["draws"].setdefault(key, []).append(means)
    return data


COLUMNS = (
    ("schemes of the paper,\nexact rotor", PAPER, "exact"),
    ("the same with\nMcLachlan-Reich", PAPER, "mclachlan_reich"),
    ("ours, for small potentials,\nexact rotor", OURS, "exact"),
)


def draw(data):
    rates = 10.0 / np.array(data["h"])
    for i, epsilon in enumerate(EPSILONS):
        figure, axes = plt.subplots(5, 3, figsize=(7.4, 11.0), sharex=True, sharey=True, layout="constrained")
        for panels, (words, names, method) in zip(axes.T, COLUMNS, strict=True):
            lines = [f"{name} {method}" for name in names]
            for j, axis in enumerate(panels):
                for key in sorted(data["lines"].keys() - set(lines)):
                    plot(axis, rates, data["lines"][key], i, j, color="0.87", lw=0.8)
                axis.axhline(epsilon, color="0.4", lw=0.9, ls=":")
                for k, key in enumerate(lines):
                    style = {"color": common.COLOURS[k], "marker": common.MARKERS[k], "ms": 3.5, "lw": 1.4}
                    plot(axis, rates, data["lines"][key], i, j, label=key.split()[0], **style)
                axis.grid(True, alpha=0.25)
            panels[0].legend(title=words, ncols=2, fontsize=7, title_fontsize=9, **ABOVE)
        for j, axis in enumerate(axes[:, 0]):
            axis.set_ylabel(f"$T_0$ = {ENERGIES[j]}: relative error", fontsize=9)
        for axis in axes[-1]:
            axis.set_xlabel("evaluations per unit of time", fontsize=9)
            axis.set_xticks([1.25, 2.5, 5, 10, 20], ["1.25", "2.5", "5", "10", "20"])
            axis.minorticks_off()
        axes[0, 0].set_ylim(1e-15, 10.0)
        words = "largest energy error on [0, 2000], mean of 20\ntops; dotted: ε; grey: the lines of the other columns"
        figure.suptitle(f"heavy top, ε = {epsilon:g}: {words}", fontsize=11)
        yield f"figure{12 + i}", figure


ABOVE = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.02), "frameon": False}


def plot(axis, rates, line, i, j, **style):
    """Draw the errors of a line that are finite."""
    values = np.array(line)[:, i, j]
    fine = np.isfinite(values) & (values < 1e3)
    axis.loglog(rates[fine], np.maximum(values[fine], 1e-16), **style)


def table(data):
    k = list(data["h"]).index(5.0)
    lines = []
    for key, line in data["lines"].items():
        cells = [f"{line[k][i][j]:.1e}" for j in (2, 1) for i in (0, 1)]
        lines.append((key.replace(" ", " + "), *cells))
    return (
        "The table shows the mean error of the first draw at 2 force evaluations per unit of time:\n\n"
        + common.markdown(
            ("scheme + rotor", "ε = 1e-6, T0 = 1", "ε = 1e-3, T0 = 1", "ε = 1e-6, T0 = ε", "ε = 1e-3, T0 = ε"), lines
        )
    )


def by_draw(data, names, method):
    """Return the mean errors of all draws: (scheme, step of DECIDING, draw, epsilon, energy)."""
    return np.array([data["draws"][f"{name} {method}"] for name in names])


def claims(data):
    yield below_epsilon(data)
    h5 = DECIDING.index(5.0)
    exact = by_draw(data, PAPER, "exact")[:, h5, :, :, 2]
    ratio = exact[:, :, 1] / exact[:, :, 0]
    yield Claim(
        "The leading error is expected to be linear in ε.",
        "ratio of the error for ε = 1e-3 to that for ε = 1e-6 at T0 = 1 and 2 evaluations per unit of time: "
        + ", ".join(f"{name} {r.min():.0f} to {r.max():.0f}" for name, r in zip(PAPER, ratio, strict=True))
        + ".",
        tuple(
            Criterion.mean(
                f"{name}: log10 of the ratio is within log10(3) of 3",
                np.log10(r),
                3.0 - np.log10(3.0),
                3.0 + np.log10(3.0),
            )
            for name, r in zip(PAPER, ratio, strict=True)
        ),
    )
    last, before = (np.array(data["lines"]["S6_10 mclachlan_reich"][-k])[:, 2] for k in (1, 2))
    slope = np.log2(before / last)
    yield Claim(
        "For the heavy top as well, a scheme of order 6 with McLachlan-Reich converges with order 2.",
        f"S6_10, slope over the last halving of the step at T0 = 1: {slope[0]:.2f} and {slope[1]:.2f} for the two ε.",
        (Criterion.of("both within 0.35 of 2", bool(np.all(np.abs(slope - 2.0) < 0.35))),),
        ours=True,
    )
    small = best(data, h5, 0, 2)
    yield Claim(
        "The error of a scheme for a small potential is at most 1/1000 of that of the paper's best scheme, for ε = 1e-6, "
        "T0 = 1, at 2 force evaluations per unit of time.",
        compared(small),
        (Criterion.of("the ratio is at most 1/1000", small[1][1] <= 1e-3 * small[0][1]),),
        ours=True,
    )
    large = best(data, h5, 1, 1)
    yield Claim(
        "Schemes for a small potential are not the best if the potential is as large as the kinetic energy, T0 = ε.",
        f"ε = 1e-3, 2 evaluations per unit of time: {compared(large)}",
        (Criterion.of("the paper's best scheme has a smaller error", large[0][1] < large[1][1]),),
        ours=True,
    )


def below_epsilon(data):
    """Judge that only the exact rotor stays below ε."""
    scale = np.array(EPSILONS)[:, None]
    exact, other = (by_draw(data, PAPER, method) / scale for method in ("exact", "mclachlan_reich"))
    above = [(name, np.argwhere(np.any(e > 1.0, axis=1))) for name, e in zip(PAPER, exact, strict=True)]
    where = sorted(
        {
            f"{name} at h = {DECIDING[h]:g}, ε = {EPSILONS[i]:g}, T0 = {ENERGIES[j]}"
            for name, places in above
            for h, i, j in places
        }
    )
    return Claim(
        "Only the methods with the exact rotor have an error below ε for all step sizes.",
        f"largest ratio of the mean error to ε, at the basic steps 8, 5 and 4: exact {np.max(exact[:, :, :, 0]):.1f} and "
        f"{np.max(exact[:, :, :, 1]):.1f}, McLachlan-Reich {np.max(other[:, :, :, 0]):.0e} and "
        f"{np.max(other[:, :, :, 1]):.0e} for ε = 1e-6 and 1e-3. Errors above ε with the exact rotor in some draw: "
        + ("; ".join(where) or "nothing")
        + ". Our errors are the largest along the run, which is stricter than the paper's mean.",
        (
            Criterion.of("all methods with the exact rotor are below ε", np.all(exact < 1.0, axis=(0, 1, 3, 4))),
            Criterion.of(
                "each method with McLachlan-Reich is above ε at some step and energy",
                np.all(np.any(other > 1.0, axis=(1, 4)), axis=(0, 2)),
            ),
        ),
    )


def best(data, h, i, j):
    """Return for the paper's schemes and for ours the name that is best in the median of the draws, and its errors."""
    found = []
    for names in (PAPER, OURS):
        errors_of = by_draw(data, names, "exact")[:, h, :, i, j]
        k = int(np.argmin(np.median(errors_of, axis=1)))
        found.append((names[k], errors_of[k]))
    return found


def compared(pair):
    """Say the errors of the paper's best scheme and of ours."""
    (paper, e1), (ours, e2) = pair
    return (
        f"{paper} {e1.min():.1e} to {e1.max():.1e}, {ours} {e2.min():.1e} to {e2.max():.1e}: "
        f"ratio of ours to theirs {np.min(e2 / e1):.1e} to {np.max(e2 / e1):.1e}."
    )


if __name__ == "__main__":
    common.main(sys.modules[__name__])
