"""Samples of soft dipoles for the tests of their potential."""

from functools import cache

import numpy as np
import openmm
from openmm import unit

import openmm_exactrb as rb
from openmm_exactrb.potentials import SoftDipoles
from starts import context_of, positions_of

PARAMETERS = {"soft_repulsion": 4.0, "dipole_coupling": 2.0}
FIELD = {"boundary": rb.ReactionField(cutoff=1.8, switch=1.0, dielectric=7.0), "density": 0.5}


def fluid(n, scheme="SRKN4_6b", **options):
    """Return the Context of a fluid and its integrator."""
    _, system, positions = rb.dipole_fluid(n, **({"seed": 5, "perturbation": 0.08} | options))
    integrator = rb.ExactRigidBodyIntegrator(0.005, scheme=scheme)
    context = context_of(system, integrator, positions)
    return context, integrator


def arrows(n, rng, edge=1.1):
    """Return centres and tips (2 n, 3) on a lattice, and the edge of its box."""
    side = next(k for k in range(1, n + 1) if k**3 >= n)
    centres = edge * np.argwhere(np.ones((side, side, side)))[:n] + 0.05 * rng.standard_normal((n, 3))
    return sites_of(centres, 0.5 * rng.standard_normal((n, 3))), side * edge


def sites_of(R, mu):
    """Return centres and tips (2 n, 3) of dipoles mu (n, 3) at R (n, 3)."""
    return np.stack([R, R + mu], axis=1).reshape(-1, 3)


def truncated(box):
    """Return a boundary whose switch is well inside the box."""
    return rb.ReactionField(cutoff=0.4 * box, switch=0.25 * box, dielectric=7.0)


def summed(sites, boundary=rb.Open(), edges=None, threads=None, wca=False, **parameters):  # noqa: B008
    """Return energy and forces (2 n, 3) of the compiled kernel."""
    edges = None if edges is None else tuple(map(float, edges))
    n = len(sites) // 2
    kernel = SoftDipoles(boundary.truncation(edges, n), boundary.images(n, edges), wca=wca)
    box = None if edges is None else np.diag(edges)
    return kernel.energy_and_forces(sites, PARAMETERS | parameters, box, threads)


def dipoles_alone(sites, edges, threads=None, coupling=1.0, **settings):
    """Return energy and forces (2 n, 3) of an Ewald sum of dipoles without spheres."""
    boundary = rb.Ewald(**({"tolerance": 1e-12} | settings))
    return summed(sites, boundary, edges, threads, soft_repulsion=0.0, dipole_coupling=coupling)


@cache
def liquid(n):
    """Return centres, dipoles and box of soft dipolar spheres at rho* = 0.8, mu*² = 4, T* = 1.35, just molten."""
    options = {"dipole": (0.0, 0.0, 2.0), "inertia": (0.3, 0.3, 0.3), "kernel": "compiled"}
    _, system, positions = rb.dipole_fluid(n, 3, boundary=rb.ReactionField(), **options)
    integrator = rb.ExactRigidBodyIntegrator(0.005, scheme="S2_2")
    context = context_of(system, integrator, positions)
    openmm.LocalEnergyMinimizer.minimize(context, 100.0, 50)
    for k in range(4):
        integrator.setVelocitiesToTemperature(1.35 * unit.kilojoule_per_mole / unit.MOLAR_GAS_CONSTANT_R, k)
        integrator.step(60)
    x = positions_of(context).reshape(n, -1, 3)[:, -2:]
    return x[:, 0], 4.0 * (x[:, 1] - x[:, 0]), (n / 0.8) ** (1.0 / 3.0)


def assert_same(one, other, tolerance=1e-13):
    """Compare energies and forces; an energy relative to what its pairs add up to."""
    (energy, forces), (energy2, forces2) = one, other
    assert abs(energy - energy2) <= tolerance * max(abs(energy), np.abs(forces).sum() / 12.0)
    np.testing.assert_allclose(forces2, forces, rtol=0.0, atol=tolerance * np.abs(forces).max())
