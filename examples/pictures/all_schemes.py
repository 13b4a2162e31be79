"""
The energy error of all schemes
===============================

Every scheme of the catalogue on heavy tops, at the same cost. A scheme that is added gets a panel by itself.
"""

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

import openmm_exactrb as rb
from openmm_exactrb.problems import HeavyTop, energy, integrate

tops, start = HeavyTop.random(np.random.default_rng(1), epsilon=1.0, T0=1.0, n=20)
first = energy(tops, start)
T, names = 20.0, list(rb.SCHEMES)
evaluations = np.array([5.0, 10.0, 20.0, 40.0, 80.0])
curves = {}
for name in names:
    scheme, errors = rb.SCHEMES[name], []
    for per_time in evaluations:
        n = max(1, round(T * per_time / scheme.forces))
        pause, state, largest = max(1, n // 40), start, np.zeros(len(first))
        for _ in range(max(1, n // pause)):
            state = integrate(tops, state, T / n, pause, scheme)
            largest = np.maximum(largest, np.abs(energy(tops, state) - first))
        errors.append(np.median(largest))
    curves[name] = np.array(errors)

# %%
# A panel for each scheme, in front of all others.

rows = -(-len(names) // 5)
figure, grid = plt.subplots(rows, 5, figsize=(11.0, 2.1 * rows), sharex=True, sharey=True, layout="constrained")
for axes in grid.flat[len(names) :]:
    axes.set_axis_off()
for axes, name in zip(grid.flat, names, strict=False):
    for other in names:
        axes.loglog(evaluations, curves[other], color="0.85", lw=0.8)
    axes.loglog(evaluations, curves[name], "o-", color="#0072B2", lw=2.0, ms=4)
    scheme = rb.SCHEMES[name]
    orders = scheme.generalised or (scheme.order,)
    axes.set_title(f"{name}, order {', '.join(map(str, orders))}", fontsize=10)
    axes.grid(True, alpha=0.25)
    axes.set_ylim(1e-14, 1e1)
    axes.set_xticks([5, 10, 20, 40, 80], ["5", "10", "20", "40", "80"])
    axes.xaxis.set_minor_locator(mpl.ticker.NullLocator())
figure.supxlabel("torque evaluations a unit of time")
figure.supylabel("largest error of the energy (reduced units, median of 20 tops)")
figure.suptitle("All schemes on heavy tops with epsilon = T0 = 1 over 20 units of time; grey: all others")
plt.show()
