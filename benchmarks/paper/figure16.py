"""Figure 16: 100 soft dipolar spheres at rest, energy error against force evaluations.

The figure shows the gain of a high order for a molecular system, and that all three schemes have only second order with
the McLachlan-Reich rotation instead of the exact flow. The paper's initial state is random, and only its energy is
given. We use those ten of 4000 random initial states whose energies are closest to the printed energy. In each of these
ten states, the smallest distance between two dipoles is 1.9 to 3.0. The verdicts are based on the ten states. For
comparison, the figure also shows five random initial states that were not selected, in which all distances exceed 14
and the dipoles hardly move.
"""

import sys
from functools import lru_cache, partial

import matplotlib.pyplot as plt
import numpy as np
import openmm
from openmm import unit

import openmm_exactrb as rb
from benchmarks.paper import common
from benchmarks.paper.claims import Claim, Criterion
from openmm_exactrb.rotors import rotor

NAME = "figure16"
TITLE = "Figure 16: dipoles at rest"
PICTURES = {
    "figure16": "Top, starts with energies near the paper's: with the exact rotor, the errors of SRKN4_6b and S6_10 fall with "
    "their order to roundoff. With McLachlan-Reich their lines become parallel to that of V2, whose two lines coincide. "
    "Bottom, starts that were not selected: the errors of all schemes except V2 are roundoff at every step."
}
SCHEMES = ("V2", "SRKN4_6b", "S6_10")
ROTORS = ("exact", "mclachlan_reich")
N = 100
T = 1.0
PRINTED = 0.14134185611814
RANDOM = 4000
#: What the verdicts are reached by, and what stands beside it.
GROUPS = {"nearest": "energies nearest to the paper's", "any": "not selected"}
STARTS = {"nearest": 10, "any": 5}
#: Numbers of bodies for the cost of the rotor beside that of the forces.
SIZES = (100, 1000, 4000)
#: The errors below are roundoff and show no order.
ROUNDOFF = 1e-12


@lru_cache(maxsize=1)
def spheres():
    """Return the System, and the sites (N, sites, 3) of every sphere about its centre."""
    _, system, positions = rb.dipole_fluid(N, seed=16)
    x = positions.value_in_unit(unit.nanometer).reshape(N, -1, 3)
    return system, x - x[:, -2, None]  # the last but one is the centre


def centres(seed):
    """Return random centres, 100 randn."""
    return N * np.random.default_rng(seed).standard_normal((N, 3))


def potential(seed):
    """Return the potential energy of a start: its H0, since all is at rest."""
    arrow = spheres()[1][:, -1]
    dipole = arrow * np.sqrt(2.0) / np.linalg.norm(arrow, axis=1)[:, None]
    i, j = np.triu_indices(N, 1)
    r = centres(seed)[i] - centres(seed)[j]
    inverse2 = 1.0 / np.einsum("kc,kc->k", r, r)
    along = [np.einsum("kc,kc->k", dipole[k], r) for k in (i, j)]
    turned = np.einsum("kc,kc->k", dipole[i], dipole[j]) - 3.0 * along[0] * along[1] * inverse2
    return float(np.sum(4.0 * inverse2**6 + turned * inverse2**1.5))


def errors(seed, halvings):
    """Return by scheme and rotor the largest relative energy error at the ends of steps, for each step size."""
    system, sites = spheres()
    found = {}
    for name in SCHEMES:
        for method in ROTORS:
            for i in range(halvings):
                steps = max(1, round(10 * 2**i * T / rb.SCHEMES[name].stages))
                integrator = rb.ExactRigidBodyIntegrator(T / steps, scheme=name, rotor=method)
                context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
                context.setPositions((centres(seed)[:, None] + sites).reshape(-1, 3))
                found.setdefault(f"{name} {method}", []).append(largest_error(integrator, steps))
    return found


def largest_error(integrator, steps):
    """Return the largest relative error of the energy along a run."""
    first, largest = integrator.totalEnergy()._value, 0.0
    for _ in range(steps):
        integrator.step(1)
        largest = max(largest, abs(integrator.totalEnergy()._value / first - 1.0))
    return float(f"{largest:.4g}")


def rotor_cost(n, rounds):
    """Return processor seconds of an evaluation of all forces, and of a call of numpy's rotors, for n bodies."""
    _, system, positions = rb.dipole_fluid(n, seed=1, spacing=3.0)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    rng = np.random.default_rng(2)
    q, m = common.unit_attitudes(n), rng.standard_normal((3, n))
    calls = {name: partial(rotor(name, (1.0, 1.88, 2.88)), q, m, 0.1) for name in ("exact_numpy", "mclachlan_reich")}
    return common.least_seconds(calls | {"forces": partial(context.getState, forces=True)}, rounds)


def compute(quick):
    few, halvings = (dict.fromkeys(GROUPS, 2), 4) if quick else (STARTS, 8)
    energies = np.array([potential(seed) for seed in range(200 if quick else RANDOM)])
    seeds = {
        "nearest": np.argsort(np.abs(energies - PRINTED), kind="stable")[: few["nearest"]],
        "any": np.arange(few["any"]),
    }
    data = {"energies": [float(f"{e:.5g}") for e in energies], "evaluations": [10 * 2**i for i in range(halvings)]}
    for group, chosen in seeds.items():
        pieces = [{"seed": int(seed), "halvings": halvings} for seed in chosen]
        results = common.in_pieces(NAME, errors, pieces)
        lines = {key: [result[key] for result in results] for key in results[0]}
        data[group] = {"seeds": chosen, "H0": energies[chosen], "lines": lines}
    data["cost"] = {str(n): rotor_cost(n, 2 if quick else 5) for n in SIZES[: 1 if quick else None]}
    return data


def draw(data):
    figure, axes = plt.subplots(2, 1, figsize=(5.6, 8.4), sharex=True, sharey=True, layout="constrained")
    x = np.array(data["evaluations"]) / T
    for axis, (group, words) in zip(axes, GROUPS.items(), strict=True):
        for k, name in enumerate(SCHEMES):
            for method in ROTORS:
                found = np.maximum(data[group]["lines"][f"{name} {method}"], 1e-16)
                exact, colour = method == "exact", common.COLOURS[k]
                style = {"color": colour, "marker": common.MARKERS[k], "ms": 5, "mfc": colour if exact else "white"}
                label = f"{name} + {'exact' if exact else 'McLachlan-Reich'}"
                axis.loglog(x, np.median(found, axis=0), ls="-" if exact else "--", label=label, **style)
                if exact:
                    axis.fill_between(x, found.min(axis=0), found.max(axis=0), color=colour, alpha=0.15, lw=0)
        axis.set_xticks(x[::2], [f"{value:g}" for value in x[::2]])
        axis.minorticks_off()
        axis.set_title(f"{len(data[group]['seeds'])} random starts, {words}", fontsize=10)
        axis.grid(True, alpha=0.3)
        axis.set_ylabel("largest relative error of the energy")
    axes[1].set_xlabel("force evaluations per unit of time (reduced units)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9)
    figure.suptitle(
        "100 dipoles on [0, 1]: medians of the starts;\nbands from the least to the largest (exact rotor)", fontsize=11
    )
    yield "figure16", figure


def order(evaluations, line, last=2):
    """Return the order over the last points above roundoff, nan if there are fewer than two."""
    x, y = np.log(evaluations), np.array(line)
    fine = np.flatnonzero((y > ROUNDOFF) & (y < 1e-2))[-last:]
    return float(-np.polyfit(x[fine], np.log(y[fine]), 1)[0]) if len(fine) > 1 else np.nan


def orders(data, group, name, method, last=2):
    """Return the order of every start."""
    return np.array([order(data["evaluations"], line, last) for line in data[group]["lines"][f"{name} {method}"]])


def table(data):
    rows = []
    for group in GROUPS:
        for key, lines in data[group]["lines"].items():
            found = np.array(lines)
            cells = [
                f"{np.median(column):.1e} ({column.min():.0e} to {column.max():.0e})" for column in found.T[[0, 2, -1]]
            ]
            slopes = orders(data, group, *key.split(), last=3)
            measured = slopes[np.isfinite(slopes)]
            rows.append(
                (
                    GROUPS[group],
                    key.replace(" ", " + "),
                    *cells,
                    f"{np.median(measured):.1f}" if len(measured) else "roundoff",
                )
            )
    numbers = [f"{data['evaluations'][k]} evaluations" for k in (0, 2, -1)]
    return common.markdown(("starts", "scheme + rotor", *numbers, "order over the last points"), rows)


def span(values, form=".2f"):
    return f"{np.min(values):{form}} to {np.max(values):{form}}"


def claims(data):
    energies = np.array(data["energies"])
    yield Claim(
        "The start of figure 16 has the energy 0.14134185611814.",
        f"the start is random and not printed. Of {len(energies)} random starts, half have energies below "
        f"{np.median(np.abs(energies)):.1g} in magnitude, and {np.sum(energies > 0.05)} have energies above 0.05. The ten "
        f"nearest have energies of {span(data['nearest']['H0'], '.4f')}.",
    )
    lines = {key: np.array(found) for key, found in data["nearest"]["lines"].items()}
    yield from order_claims(data, lines)
    gain = lines["V2 exact"] / np.maximum(lines["SRKN4_6b exact"], 1e-16)
    yield Claim(
        "The Nyström 4th order scheme is extremely accurate.",
        f"with the exact rotor, its error is {span(gain, '.0e')} times smaller than Verlet's at equal evaluations.",
        (Criterion.of("at least 100 times smaller at every step size", gain.min(axis=1) >= 100.0),),
    )
    yield rotor_claim(data)


def order_claims(data, lines):
    high = SCHEMES[1:]
    reduced = {s: orders(data, "nearest", s, "mclachlan_reich") for s in high}
    second = np.array([np.abs(reduced[s] - 2.0) < 0.4 for s in high])
    yield Claim(
        "All methods with McLachlan-Reich end as second order, parallel to Verlet.",
        "order over the last two points above roundoff: "
        + ", ".join(f"{s} {np.nanmedian(o):.2f} ({np.nanmin(o):.2f} to {np.nanmax(o):.2f})" for s, o in reduced.items())
        + ".",
        tuple(Criterion.of(f"{s}: within 0.4 of 2", met) for s, met in zip(high, second, strict=True)),
    )
    reference = lines["V2 mclachlan_reich"][:, -1]
    ahead = {s: reference / lines[f"{s} mclachlan_reich"][:, -1] for s in high}
    yield Claim(
        "With McLachlan-Reich the higher schemes still gain accuracy over Verlet, by their small error coefficients.",
        "ratio of Verlet's error to theirs at the smallest step size: "
        + ", ".join(f"{s} {span(g, '.0e')}" for s, g in ahead.items())
        + ".",
        tuple(Criterion.of(f"{s}: at least 10", g >= 10.0) for s, g in ahead.items()),
    )
    exact = {s: orders(data, "nearest", s, "exact", last=3) for s in SCHEMES}
    expected = {s: rb.SCHEMES[s].order for s in SCHEMES}
    ratio = {s: lines[f"{s} exact"][:, -1] / lines[f"{s} mclachlan_reich"][:, -1] for s in high}
    yield Claim(
        "The methods with the exact rotor display the correct order, and are more accurate at the same cost.",
        "orders "
        + ", ".join(f"{s} {np.nanmedian(o):.1f} ({np.nanmin(o):.1f} to {np.nanmax(o):.1f})" for s, o in exact.items())
        + "; ratio of the error with the exact rotor to that with McLachlan-Reich at the smallest step size: "
        + ", ".join(f"{s} {span(r, '.2g')}" for s, r in ratio.items())
        + ".",
        (
            *(
                Criterion.mean(f"{s}: order at least {expected[s]} - 0.5", exact[s], expected[s] - 0.5, np.inf)
                for s in SCHEMES
            ),
            *(Criterion.of(f"{s}: smaller error at the smallest step size", ratio[s] < 1.0) for s in high),
        ),
    )


def rotor_claim(data):
    whole = {
        n: (c["forces"] + c["exact_numpy"]) / (c["forces"] + c["mclachlan_reich"]) for n, c in data["cost"].items()
    }
    largest = max(whole, key=int)
    return Claim(
        "For sufficiently many particles it is irrelevant for the cost whether the rotor is McLachlan-Reich or exact.",
        "time of one evaluation of all forces (compiled, the same for both) and one call of the rotor (both numpy), ratio of "
        "the exact rotor to McLachlan-Reich: "
        + ", ".join(f"{ratio:.3f} for {n}" for n, ratio in whole.items())
        + " bodies.",
        (Criterion.of(f"within 5 % for {largest} bodies", abs(whole[largest] - 1.0) < 0.05),),
    )


if __name__ == "__main__":
    common.main(sys.modules[__name__])
