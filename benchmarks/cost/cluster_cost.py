"""What the free flow of a constrained cluster costs, by its graph and by the length of the step.

Stars come in blocks of one kind, as in a protein with constrained hydrogens, and a larger graph alone or in blocks.
Times are those of the thread, the shortest of several series, at velocities of 300 K. Orders are not shown: a block
takes as many as its fastest cluster needs, and is halved beyond 30. Raw data go to out/benchmarks/cluster_cost.csv.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.common.clocks import least
from benchmarks.common.records import OUT, write
from benchmarks.constraints import clusters as constrained_clusters
from openmm_exactrb.mechanics.clusters import sorted_into_kinds

#: Clusters of a kind, and how many of them there are.
ROWS = [("XH", 1024), ("XH2", 1024), ("XH3", 1024), ("XH4", 1024), ("ring", 256), ("peptide", 256), ("peptide", 1)]
#: Steps in fs.
STEPS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def best_time(function):
    return least(function, 0.03, time.thread_time)


def copies_of(name, copies):
    """Return clusters of one kind with velocities at 300 K."""
    masses, pairs, x = constrained_clusters.CLUSTERS[name]
    lengths = constrained_clusters.lengths_of(pairs, x)
    clusters = sorted_into_kinds([constrained_clusters.group_of(masses, pairs, lengths, copies)])
    v = constrained_clusters.velocities(np.tile(masses, copies), np.random.default_rng(1))
    return clusters, constrained_clusters.on_constraints(clusters, np.tile(x, (copies, 1)), v)


def main():
    rows = []
    print("microseconds a cluster and drift, on one core")
    print(f"{'kind':>9}{'clusters':>9}{'projection':>12}" + "".join(f"{h:>8g} fs" for h in STEPS))
    for name, copies in ROWS:
        clusters, state = copies_of(name, copies)
        projection = best_time(lambda: clusters.tangent(state)) / copies * 1e6  # noqa: B023
        drifts = [best_time(lambda: clusters.drift(state, 1e-3 * h)) / copies * 1e6 for h in STEPS]  # noqa: B023
        print(f"{name:>9}{copies:>9}{projection:>12.3f}" + "".join(f"{t:>11.3f}" for t in drifts))
        rows += [(name, copies, h, t) for h, t in zip(STEPS, drifts, strict=True)]
    write(OUT / "cluster_cost.csv", ("kind", "clusters", "step_fs", "microseconds"), rows)


if __name__ == "__main__":
    main()
