"""
Free bodies, without OpenMM
===========================

:func:`openmm_exactrb.free_rotor` computes the exact flow of free rigid bodies: any number of bodies, with any moments
of inertia in any order and any momenta, over any time, in a single call.
"""

import matplotlib.pyplot as plt
import numpy as np

import openmm_exactrb as rb
from openmm_exactrb.mathematics.quaternions import rotation_matrix

inertia = np.array([1.0, 1.88, 2.88])
q0, m0 = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.3, 0.2, 0.1])
q, m = rb.free_rotor(inertia, q0, m0, t=5.0)
print("attitude", q.round(6))
print("momentum", m.round(6))

# %%
# ``q`` is the orientation as a unit quaternion, scalar first, which maps body coordinates to space coordinates; ``m``
# is the angular momentum in the frame of the body. The angular momentum in the space frame and the kinetic energy are
# constant.

print(f"the momentum in space moved by {np.abs(rotation_matrix(q) @ m - m0).max():.1e}")
print(f"the kinetic energy changed by {abs((m * m / inertia).sum() / (m0 * m0 / inertia).sum() - 1.0):.1e} of it")

# %%
# The exact flow has no step-size error. A thousand steps of 5 lead to the same state as one step of 5000, up to the
# roundoff of a thousand steps, and a backward step reverses a forward step.

many = q0, m0
for _ in range(1000):
    many = rb.free_rotor(inertia, *many, 5.0)
once = rb.free_rotor(inertia, q0, m0, 5000.0)
back = rb.free_rotor(inertia, q, m, -5.0)
print(f"a thousand steps and one differ by {np.abs(many[1] - once[1]).max():.1e}")
print(f"a step forth and back by {np.abs(back[1] - m0).max():.1e}")

# %%
# Arrays with many rows describe many bodies, each with its own moments, momentum and time. Here, the rows describe one
# body at many times. The body initially rotates about its middle axis, and flips repeatedly.

t = np.linspace(0.0, 60.0, 601)
_, path = rb.free_rotor(inertia, q0, np.tile([1e-3, 1.0, 1e-3], (len(t), 1)), t)

figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
for axis, (colour, style) in enumerate((("#0072B2", "-"), ("#D55E00", "--"), ("#009E73", "-."))):
    axes.plot(t, path[:, axis], style, color=colour, label=f"axis {axis + 1}")
axes.set_xlabel("time (reduced units)")
axes.set_ylabel("angular momentum in the body")
axes.set_title(f"A free body with the moments {', '.join(map(str, inertia))}")
axes.legend(loc="upper right")
plt.show()

# %%
# Torques are included by a splitting, which alternates free flows and kicks. The potential of the heavy top is
# ``epsilon`` times the height of its axis, and the torque is ``epsilon (u2, -u1, 0)``, where ``u`` is the vertical in
# the frame of the body. The following code performs a thousand steps of a scheme of order 4:

epsilon, h, scheme = 0.1, 0.1, rb.SCHEMES["SRKN4_6b"]


def vertical(q):
    """Return the vertical in the frame of the body."""
    return rotation_matrix(q)[2]


def energy(q, m):
    """Return the total energy of the top."""
    return 0.5 * (m * m / inertia).sum() + epsilon * vertical(q)[2]


q, m = q0, m0
for _ in range(1000):
    for substep, part in scheme.sequence:
        if substep.kicks:
            u = vertical(q)
            m = m + part * h * epsilon * np.array([u[1], -u[0], 0.0])
        else:
            q, m = rb.free_rotor(inertia, q, m, part * h)
print(f"the energy of the top changed by {abs(energy(q, m) - energy(q0, m0)):.1e}")
