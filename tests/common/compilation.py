"""What is compiled before the tests begin: else each worker would compile the loops over dipoles by itself."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np


def of_library():
    """Compile the library, unless it is there or there is no compiler."""
    from openmm_exactrb.library import functions

    functions.available()


def of_dipoles():
    """Compile the sums over soft dipoles: with spheres and with cut off ones, for all boundaries."""
    import openmm_exactrb as rb
    from soft_dipoles import arrows, summed

    x, box = arrows(64, np.random.default_rng(1))
    around = [
        (rb.Open(), None),
        (rb.ReactionField(), box),
        (rb.ReactionField(cutoff=0.3 * box), box),
        (rb.Ewald(method="direct", tolerance=1e-2), box),
        (rb.Ewald(method="mesh", tolerance=1e-2, cutoff=0.3 * box), box),
    ]
    for boundary, edge in around:
        for spheres in ({}, {"soft_attraction": 3.0, "wca": True}):
            summed(x, boundary, edge and 3 * [edge], **spheres)


def of_ellipsoids():
    """Compile the sum over ellipsoids."""
    import openmm

    import openmm_exactrb as rb
    from starts import context_of

    _, system, positions = rb.ellipsoids(36, cutoff=2.4)
    context_of(system, openmm.VerletIntegrator(0.001), positions).getState(energy=True, forces=True)


def at_once():
    """Compile in two processes."""
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for done in [pool.submit(of_dipoles), pool.submit(of_library), pool.submit(of_ellipsoids)]:
            done.result()
