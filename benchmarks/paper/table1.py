"""Table 1 and figure 2: error and cost of one step of h = 5 by the two exact methods, 100 random momenta.

It tells what exactness costs and whether it is reached in one long step. The reference is a Taylor series in double-double
precision where the paper took ode45 at its tolerance.
"""

import sys
import time

import common
import matplotlib.pyplot as plt
import numpy as np
from reference import taylor

from openmm_exactrb.rotors import rotor

NAME = "table1"
TITLE = "Table 1 and figure 2: one step of h = 5"
METHODS = ("rotation", "quaternion_a", "exact")
H = 5.0
PAPER = {"rotation": 7.0865e-13, "quaternion_a": 3.3383e-13}


def call_time(flow, q, m, repeats=7):
    """Return the shortest time of a call in seconds."""
    flow(q, m, H)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        flow(q, m, H)
        times.append(time.perf_counter() - start)
    return min(times)


def compute(quick):
    n = 20 if quick else 100
    inertia, m = common.random_bodies(np.random.default_rng(5), n)
    reference, _ = taylor(inertia, m, H)
    data = {}
    for method in METHODS:
        q, _ = rotor(method, inertia.T)(common.unit_attitudes(n), m, H)
        alone = []
        for body in range(n):
            flow = rotor(method, inertia[:, body])
            alone.append(call_time(flow, common.unit_attitudes(1), np.ascontiguousarray(m[:, body : body + 1])))
        many = np.tile(m, 10), common.unit_attitudes(10 * n)
        data[method] = {
            "errors": common.attitude_errors(q, reference),
            "seconds_a_call_of_one": alone,
            "seconds_a_body_of_many": call_time(rotor(method, np.tile(inertia, 10).T), many[1], many[0]) / (10 * n),
        }
    return data


def draw(data):
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(7.0, 5.0), sharex=True, layout="constrained")
    for k, method in enumerate(METHODS):
        style = {"color": common.COLOURS[k], "marker": common.MARKERS[k], "ms": 4, "ls": "", "label": method}
        top.plot(1e3 * np.array(data[method]["seconds_a_call_of_one"]), **style)
        bottom.semilogy(np.maximum(data[method]["errors"], 1e-17), **style)
    top.set_ylabel("time of a call (ms)")
    bottom.set_ylabel("error of the attitude")
    bottom.set_xlabel("run")
    top.legend(fontsize=8)
    for axis in (top, bottom):
        axis.grid(True, alpha=0.3)
    yield "figure02", figure


def table(data):
    lines = []
    for method in METHODS:
        errors, alone = np.array(data[method]["errors"]), np.array(data[method]["seconds_a_call_of_one"])
        lines.append(
            (
                method,
                f"{np.median(errors):.1e}",
                f"{errors.std():.1e}",
                f"{errors.max():.1e}",
                f"{1e6 * np.median(alone):.0f}",
                f"{1e6 * data[method]['seconds_a_body_of_many']:.2f}",
            )
        )
    return common.markdown(
        ("method", "median error", "σ", "largest", "µs a call of one body", "µs a body of 1000"), lines
    )


def claims(data):
    medians = {method: float(np.median(data[method]["errors"])) for method in METHODS}
    yield common.Claim(
        "Median errors of one step are 7.1e-13 (rotation) and 3.3e-13 (quaternion).",
        ", ".join(f"{method} {error:.1e}" for method, error in medians.items())
        + ": smaller than printed, which most likely is the error of the paper's reference.",
        all(medians[method] <= printed for method, printed in PAPER.items()),
    )
    cost = [data[method]["seconds_a_body_of_many"] for method in METHODS[:2]]
    yield common.Claim(
        "Accuracy and cost of the two exact methods are very comparable.",
        f"ratio of the errors {medians['rotation'] / medians['quaternion_a']:.2f}, of the costs {cost[0] / cost[1]:.2f}.",
        0.5 < cost[0] / cost[1] < 2.0 and 0.2 < medians["rotation"] / medians["quaternion_a"] < 5.0,
    )


if __name__ == "__main__":
    common.main(sys.modules[__name__])
