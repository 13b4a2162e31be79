"""
The energy error of all schemes
===============================

The picture shows all schemes of the catalogue on one problem: heavy tops whose potential energy is as large as their
kinetic energy. Each row shows the largest energy error of one scheme at four costs. Dots further to the left are
better, and the distance between the dots of a scheme grows with its order. Schemes with several orders reach the higher
orders only if the potential is small, unlike here.
"""

import matplotlib.pyplot as plt
import numpy as np

import openmm_exactrb as rb
from benchmarks.paper.problems import HeavyTop, energy, integrate

tops, start = HeavyTop.random(np.random.default_rng(1), epsilon=1.0, T0=1.0, n=20)
first = energy(tops, start)
T = 20.0
evaluations = (10, 20, 40, 80)


def largest_error(scheme, per_time):
    """Return the median over the tops of the largest energy error along a run."""
    n = max(1, round(T * per_time / scheme.forces))
    pause, state, largest = max(1, n // 40), start, np.zeros(len(first))
    for _ in range(max(1, n // pause)):
        state = integrate(tops, state, T / n, pause, scheme)
        largest = np.maximum(largest, np.abs(energy(tops, state) - first))
    return np.median(largest)


errors = {name: [largest_error(scheme, k) for k in evaluations] for name, scheme in rb.SCHEMES.items()}

# %%
# Rows are sorted by order, and within an order by the error at the largest number of evaluations.

names = sorted(errors, key=lambda name: (rb.SCHEMES[name].order, -errors[name][-1]), reverse=True)
colours = plt.get_cmap("viridis_r")(np.linspace(0.15, 1.0, len(evaluations)))
figure, axis = plt.subplots(figsize=(8.0, 0.27 * len(names) + 1.4), layout="constrained")
rows = np.arange(len(names))
table = np.maximum([errors[name] for name in names], 1e-16)
axis.hlines(rows, table.min(axis=1), table.max(axis=1), color="0.8", lw=2.0, zorder=1)
for k, (per_time, colour) in enumerate(zip(evaluations, colours, strict=True)):
    axis.scatter(table[:, k], rows, s=34, color=colour, label=f"{per_time}", zorder=2)
axis.set_xscale("log")
axis.set_yticks(rows, [f"{name} (order {rb.SCHEMES[name].order})" for name in names], fontsize=9)
axis.set_ylim(-0.7, len(names) - 0.3)
axis.set_xlabel("largest error of the energy (reduced units, median of 20 tops)")
axis.grid(True, axis="x", alpha=0.3)
figure.legend(title="torque evaluations per unit of time", ncols=4, loc="outside lower center", fontsize=9)
axis.set_title("All schemes on heavy tops with epsilon = T0 = 1 over 20 units of time", fontsize=10)
plt.show()
