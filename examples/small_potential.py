"""
Where the potential is small
============================

If the torques are weak, a body turns nearly freely, and the exact flow does nearly all of the work. Schemes for this
case make the error of the first order in the potential very small: they need a free flow that is exact.

Heavy tops whose potential is a thousandth of their kinetic energy, over 50 units of time: the median over 20 tops of
the largest relative energy error.
"""

import matplotlib.pyplot as plt
import numpy as np

import openmm_exactrb as rb
from openmm_exactrb.problems import HeavyTop, energy, integrate

evaluations = np.array([2, 4, 8, 16])
tops, start = HeavyTop.random(np.random.default_rng(2), epsilon=1e-3, T0=1.0, n=20)
before = energy(tops, start)


def error(scheme, per_time):
    """Return the largest error of the energy along a run, with so many evaluations of the torques per unit of time."""
    h, state, largest = scheme.stages / per_time, start, np.zeros(len(before))
    for _ in range(max(1, round(50.0 / h))):
        state = integrate(tops, state, h, 1, scheme)
        largest = np.maximum(largest, np.abs(energy(tops, state) / before - 1.0))
    return np.median(largest)


# %%
# The first three schemes are for any potential, the others for small ones; ``V2_C17`` is Verlet between Wisdom's
# corrector and its inverse.

names = ("V2", "SRKN4_6b", "SRKN6_14a", "SABA_4", "ABA_8_6_4", "ABA_10_6_4", "V2_C17")
curves = {name: [error(rb.SCHEMES[name], n) for n in evaluations] for name in names}
print(f"{'evaluations per unit of time':<28}" + "".join(f"{n:>10}" for n in evaluations))
for name, errors in curves.items():
    print(f"{name:<28}" + "".join(f"{value:>10.1e}" for value in errors))

# %%
# The same as a picture. The colours are those of Okabe and Ito, which colour-blind readers tell apart.

figure, axes = plt.subplots(figsize=(7.0, 4.6), layout="constrained")
colours = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#0072B2", "#D55E00")
for (name, errors), colour, marker in zip(curves.items(), colours, "os^vDP*", strict=True):
    axes.loglog(evaluations, errors, marker=marker, color=colour, label=name)
axes.set_xticks(evaluations, map(str, evaluations))
axes.minorticks_off()
axes.set_xlabel("torque evaluations per unit of time")
axes.set_ylabel("relative energy error")
axes.set_title("Heavy tops, potential 1/1000 of the kinetic energy")
axes.grid(True, alpha=0.3)
axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
plt.show()
