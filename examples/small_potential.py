"""
Where the potential is small
============================

If the torques are weak, a body rotates almost freely, and the exact flow describes most of the motion. Schemes for this
case have very small error terms of first order in the potential, and require an exact free flow.

This example measures the median over 20 heavy tops of the largest relative energy error over 50 units of time, for a
potential energy that is 1/1000 of the kinetic energy.
"""

import matplotlib.pyplot as plt
import numpy as np

import openmm_exactrb as rb
from openmm_exactrb.mathematics.quaternions import rotation_matrix

evaluations = np.array([2, 4, 8, 16])
epsilon, n, rng = 1e-3, 20, np.random.default_rng(2)
middle = rng.uniform(1.0, 3.0, n)
inertia = np.stack([np.ones(n), middle, middle + rng.uniform(0.0, 1.0, n)], axis=1)
vertical = rng.standard_normal((n, 3))
vertical /= np.linalg.norm(vertical, axis=1, keepdims=True)
q0 = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
m0 = np.sqrt(2.0 * inertia * rng.dirichlet(np.ones(3), n))  # with kinetic energy 1


def seen(q):
    """Return the vertical (n, 3) in the frames of the bodies."""
    return np.einsum("nij,ni->nj", rotation_matrix(q), vertical)


def energy(q, m):
    """Return the total energies (n,) of the tops."""
    return 0.5 * (m * m / inertia).sum(axis=1) + epsilon * seen(q)[:, 2]


def run(q, m, scheme, h, steps):
    """Return orientations and momenta after the processor, some steps of a scheme, and the postprocessor."""
    for substep, part in scheme.processor + steps * scheme.sequence + scheme.postprocessor:
        if substep.kicks:
            u = seen(q)
            m = m + part * h * epsilon * np.stack([u[:, 1], -u[:, 0], np.zeros(n)], axis=1)
        else:
            q, m = rb.free_rotor(inertia, q, m, part * h)
    return q, m


def error(scheme, per_time):
    """Return the median over tops of the largest relative energy error, for a number of torque evaluations per time."""
    h, q, m, before, largest = scheme.stages / per_time, q0, m0, energy(q0, m0), np.zeros(n)
    for _ in range(20):
        q, m = run(q, m, scheme, h, max(1, round(2.5 / h)))
        largest = np.maximum(largest, np.abs(energy(q, m) / before - 1.0))
    return np.median(largest)


# %%
# The first three schemes are for any potential, and the other four for small potentials; ``V2_C17`` is Verlet between
# Wisdom's corrector and its inverse.

names = ("V2", "SRKN4_6b", "SRKN6_14a", "SABA_4", "ABA_8_6_4", "ABA_10_6_4", "V2_C17")
curves = {name: [error(rb.SCHEMES[name], n) for n in evaluations] for name in names}
print(f"{'evaluations per unit of time':<28}" + "".join(f"{n:>10}" for n in evaluations))
for name, errors in curves.items():
    print(f"{name:<28}" + "".join(f"{value:>10.1e}" for value in errors))

# %%
# The picture shows the same errors, in the colours of Okabe and Ito, which colour-blind readers can distinguish.

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
