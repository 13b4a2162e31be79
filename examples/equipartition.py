"""
Equipartition
=============

Do translation and rotation of 64 rigid water molecules have the same temperature? This example compares OpenMM's
``LangevinMiddleIntegrator`` with ``ExactRigidBodyLangevinIntegrator`` at several intervals between force evaluations.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import openmm
from openmm.unit import femtoseconds, kelvin, picosecond

import openmm_exactrb as rb

topology, system, positions = rb.rigid_water(64, model="spce")
integrator = rb.ExactRigidBodyLangevinIntegrator(
    298 * kelvin, 5 / picosecond, forceInterval=4 * femtoseconds, scheme="W2_3m"
)
context = openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"))

integrator.setRandomNumberSeed(1)
context.setPositions(positions)
openmm.LocalEnergyMinimizer.minimize(context, 50)
integrator.setVelocitiesToTemperature(298 * kelvin, 1)
integrator.step(500)
start = context.getState(positions=True, velocities=True)
translation, rotation = integrator.temperatures()
print(f"after 6 ps: translation {translation._value:.0f} K, rotation {rotation._value:.0f} K")

# %%
# The temperature of so few molecules fluctuates by some 20 K. The mean difference of the two temperatures over 40 ps
# has an error of about 3 K. OpenMM's integrator has velocities of atoms. Their kinetic energy is that of the centres of
# mass, which is translation, and the rest, which is rotation, since the molecules are rigid.

R = 0.00831446  # kJ/mol/K
MASSES = np.array([system.getParticleMass(i)._value for i in range(3)])


def temperatures_of_atoms(context):
    """Return T_tr and T_rot in K of the velocities that a Context reports."""
    v = context.getState(velocities=True).getVelocities(asNumpy=True)._value.reshape(-1, 3, 3)
    kinetic = 0.5 * np.einsum("a,nai->", MASSES, v**2)
    centres = np.einsum("a,nai->ni", MASSES, v) / MASSES.sum()
    translational = 0.5 * MASSES.sum() * (centres**2).sum()
    return 2.0 * np.array([translational, kinetic - translational]) / (3 * len(v) * R)


def difference(integrator, picoseconds=40.0):
    """Return the mean of T_rot - T_tr over a run, and its error from ten blocks."""
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("CPU"))
    context.setState(start)
    integrator.setRandomNumberSeed(1)
    h, ours = integrator.getStepSize()._value, isinstance(integrator, rb.ExactRigidBodyLangevinIntegrator)
    integrator.step(round(2.0 / h))
    series = []
    for _ in range(int(picoseconds / 0.036)):
        integrator.step(round(0.036 / h))
        pair = [T._value for T in integrator.temperatures()] if ours else temperatures_of_atoms(context)
        series.append(pair[1] - pair[0])
    blocks = np.array(series[len(series) % 10 :]).reshape(10, -1).mean(axis=1)
    return blocks.mean(), blocks.std(ddof=1) / 10**0.5


intervals = (3, 6)  # fs between two force evaluations
lines = {
    "LangevinMiddleIntegrator": lambda fs: openmm.LangevinMiddleIntegrator(298, 5, fs * femtoseconds),
    "ExactRigidBodyLangevinIntegrator, W2_3m": lambda fs: rb.ExactRigidBodyLangevinIntegrator(
        298, 5, forceInterval=fs * femtoseconds, scheme="W2_3m"
    ),
}
out = Path("out/equipartition_example")
out.mkdir(parents=True, exist_ok=True)
figure, axes = plt.subplots(figsize=(7.0, 3.8), layout="constrained")
for (name, make), colour, marker in zip(lines.items(), ("#D55E00", "#0072B2"), ("o", "D"), strict=True):
    means, errors = np.transpose([difference(make(fs)) for fs in intervals])
    axes.errorbar(intervals, means, errors, color=colour, marker=marker, capsize=3, label=name)
    print(name, ", ".join(f"{fs} fs: {a:.1f} ± {b:.1f} K" for fs, a, b in zip(intervals, means, errors, strict=True)))
axes.axhline(0.0, color="0.6", lw=0.8)
axes.set_xticks(intervals)
axes.set_xlabel("time between two force evaluations (fs)")
axes.set_ylabel("T_rot − T_tr (K)")
figure.legend(loc="outside lower center", ncols=2)
figure.savefig(out / "equipartition.png", dpi=150)

# %%
# :doc:`/explanation/measured-temperatures` has the same comparison for a periodic box, with smaller errors.
