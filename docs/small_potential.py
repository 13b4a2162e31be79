"""Compare schemes where the potential is small beside the kinetic energy."""

import numpy as np

import openmm_exactrb as rb
from openmm_exactrb.problems import HeavyTop, energy, integrate

NAMES = ("V2", "SRKN4_6b", "SRKN6_14a", "SABA_4", "ABA_8_6_4", "ABA_10_6_4", "V2_C17")
EVALUATIONS = (2, 4, 8)

tops, start = HeavyTop.random(np.random.default_rng(2), epsilon=1e-3, T0=1.0, n=20)
before = energy(tops, start)
print(f"{'evaluations a unit of time':<28}" + "".join(f"{n:>10}" for n in EVALUATIONS))
for name in NAMES:
    scheme, cells = rb.SCHEMES[name], []
    for evaluations in EVALUATIONS:
        h, state, largest = scheme.stages / evaluations, start, np.zeros(len(before))
        for _ in range(max(1, round(50.0 / h))):
            state = integrate(tops, state, h, 1, scheme)
            largest = np.maximum(largest, np.abs(energy(tops, state) / before - 1.0))
        cells.append(np.median(largest))
    print(f"{name:<28}" + "".join(f"{cell:>10.1e}" for cell in cells))
