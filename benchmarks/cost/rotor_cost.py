"""What the exact rotor costs beside scipy's elliptic functions, which any exact flow has to evaluate in some form.

Ratios within one run, since absolute times depend on the machine. Raw data go to out/benchmarks/rotor_cost.csv. A row
whose last column is not "all" is of steps beyond the reach of its rotor: that part of the bodies has an answer.
"""

from __future__ import annotations

import time
import warnings

import numpy as np
from scipy.special import ellipj, elliprj

import openmm_exactrb as rb
from benchmarks.common.clocks import least
from benchmarks.common.records import OUT, write
from openmm_exactrb.mathematics import quaternions
from openmm_exactrb.rotors import rotor


def best_time(function):
    return least(function, 0.05, time.perf_counter)


def main():
    warnings.simplefilter("ignore", rb.NotConvergedWarning)  # a column tells it
    rng = np.random.default_rng(0)
    rows = []
    print("     N  h omega            method  call (ms)  us/body  /(ellipj + elliprj)  flow alone  answers")
    for n in (1, 125, 1000, 10000):
        u, k2 = rng.uniform(0.05, 0.15, n), rng.uniform(0.0, 1.0, n)
        x, y, p = 1.0 - 0.01 * rng.random(n), 1.0 - 0.005 * rng.random(n), 1.0 + 0.01 * rng.random(n)
        one = np.ones(n)
        reference = best_time(lambda: ellipj(u, k2)) + best_time(lambda: elliprj(x, y, one, p))  # noqa: B023
        inertia = np.array([1.0, 1.88, 2.88])
        q, m = quaternions.random(rng, n), rng.standard_normal((n, 3))
        columns = np.ascontiguousarray(q.T), np.ascontiguousarray(m.T)
        for rate in (0.1, 1.0, 10.0):
            t = rate / np.linalg.norm(m / inertia, axis=1)
            for method in rb.ROTORS:
                flow = rotor(method, inertia)
                call = best_time(lambda: rb.free_rotor(inertia, q, m, t, method=method))  # noqa: B023
                alone = best_time(lambda: flow(*columns, t))  # noqa: B023
                answers = np.isfinite(flow(*columns, t)[1]).all(axis=0).mean()
                rows.append((n, rate, method, call, alone, reference, answers))
                print(
                    f"{n:>6}{rate:>9g}{method:>18}{1e3 * call:>11.3f}{1e6 * call / n:>9.2f}{call / reference:>21.2f}"
                    f"{1e3 * alone:>9.3f} ms{'all' if answers == 1.0 else f'{100 * answers:.0f} %':>9}"
                )
    write(
        OUT / "rotor_cost.csv", ("N", "h_omega", "method", "call_s", "flow_s", "ellipj_plus_elliprj_s", "answers"), rows
    )


if __name__ == "__main__":
    main()
