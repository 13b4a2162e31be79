"""What noise and baths cost a body: they come with every step, and should be lost beside the forces.

Times of one thread, the best of several series. A draw of a body is six normals, three for each of translation and
rotation. Raw data go to out/benchmarks/noise_cost.csv.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from openmm_exactrb.compensated import exactly
from openmm_exactrb.kernels.compiled import bath as bath_compiled
from openmm_exactrb.kernels.compiled import noise as noise_compiled
from openmm_exactrb.kernels.plain import bath as bath_plain
from openmm_exactrb.kernels.plain import noise as noise_plain
from openmm_exactrb.motion.bath import langevin
from openmm_exactrb.motion.draws import Draws, Instant
from openmm_exactrb.motion.rescaling import rescaling

OUT = Path("out/benchmarks")
MOMENTS = np.array([[0.00614541], [0.01155054], [0.01769595]])


def best_time(function, repeats=9, duration=0.05):
    """Return the shortest mean time of a call in seconds, over several series."""
    function()
    start = time.perf_counter()
    function()
    calls = max(1, int(duration / (time.perf_counter() - start)))
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(calls):
            function()
        times.append((time.perf_counter() - start) / calls)
    return min(times)


def tasks(kernels, relax, n):
    """Yield the name and the call of what is timed."""
    P, m, out, at = exactly(np.ones((3, n))), exactly(np.ones((3, n))), np.empty((3, n)), Instant(1, 2, 3)
    bath = langevin(np.ones(n), np.tile(MOMENTS, n), 2.5, 1.0, 1.0, relax)
    rescale = rescaling(np.ones(n), np.tile(MOMENTS, n), 2.5, 1.0, (3 * n, 3 * n), Draws(kernels))

    def draw():
        for stream in (0, 1):
            kernels.normals(1, 2, stream, 0, n, out)

    yield "six normals", draw
    yield "Langevin bath", lambda: bath(P, m, 0.004, at)
    yield "rescaling", lambda: rescale(P, m, 0.004, at)


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    rows = []
    print("     N   kernels           task  call (us)  us/body")
    for n in (216, 1000, 10_000, 100_000):
        for name, *kernels in (
            ("numpy", noise_plain, bath_plain.relax),
            ("compiled", noise_compiled, bath_compiled.relax),
        ):
            for task, call in tasks(*kernels, n):
                seconds = best_time(call)
                rows.append((n, name, task, seconds))
                print(f"{n:>6}{name:>10}{task:>15}{1e6 * seconds:>11.1f}{1e6 * seconds / n:>9.4f}")
    with (OUT / "noise_cost.csv").open("w") as file:
        file.write("N,kernels,task,call_s\n")
        file.writelines(",".join(map(str, row)) + "\n" for row in rows)


if __name__ == "__main__":
    main()
