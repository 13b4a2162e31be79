"""The model of examples/rigid_domains.py: its energy from the published formulas, its start, and its exclusions."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import openmm
import pytest

import openmm_exactrb as rb
from places import REFERENCE

MODEL = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[2] / "examples" / "rigid_domains.py")))


def energies(x):
    """Return the energies of bonds, contacts and charges (kJ/mol) as Tesei and Lindorff-Larsen write them."""
    n = len(x)
    size, stickiness, charge = np.array([MODEL.RESIDUES[residue][1:] for residue in MODEL.SEQUENCE]).T[[1, 0, 2]]
    i, j = np.triu_indices(n, 2)
    r = np.linalg.norm(x[i] - x[j], axis=1)
    sigma, strength = 0.5 * (size[i] + size[j]), 0.5 * (stickiness[i] + stickiness[j])

    def lennard_jones(distance):
        return 4.0 * 0.8368 * ((sigma / distance) ** 12 - (sigma / distance) ** 6)

    shift = strength * lennard_jones(2.0)
    inner = lennard_jones(r) + 0.8368 * (1.0 - strength)
    contacts = np.where(r <= 2.0 ** (1.0 / 6.0) * sigma, inner, strength * lennard_jones(r)) - shift
    permittivity, kT = 80.44, 8.31446261815324e-3 * 293.0
    bjerrum = 138.935458 / (permittivity * kT)
    debye = 1.0 / np.sqrt(8.0 * np.pi * bjerrum * 0.602214 * 0.15)
    screened = kT * bjerrum * charge[i] * charge[j] * (np.exp(-r / debye) / r - np.exp(-4.0 / debye) / 4.0)
    bonds = 0.5 * 8033.0 * (np.linalg.norm(np.diff(x, axis=0), axis=1) - 0.38) ** 2
    return bonds.sum(), contacts[r <= 2.0].sum(), screened[r <= 4.0].sum()


def test_its_energy_is_that_of_the_published_formulas():
    system = MODEL.calvados2(MODEL.SEQUENCE, MODEL.TEMPERATURE, MODEL.IONIC)
    context = openmm.Context(system, openmm.VerletIntegrator(0.001), REFERENCE)
    x = MODEL.start() + 0.03 * np.random.default_rng(1).standard_normal((len(MODEL.SEQUENCE), 3))
    context.setPositions(x)
    found = [context.getState(energy=True, groups={group}).getPotentialEnergy()._value for group in range(3)]
    np.testing.assert_allclose(found[:2], energies(x)[:2], rtol=1e-9)
    assert found[2] == pytest.approx(energies(x)[2], rel=2e-3)  # the permittivity here has four digits


def test_its_start_is_a_chain_without_overlaps():
    x = MODEL.start()
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1)
    assert len(x) == 314
    assert steps.min() > 0.3  # a peptide bond in cis
    assert steps.max() < 0.4
    apart = np.linalg.norm(x[:, None] - x[None], axis=2)
    assert apart[np.triu_indices(314, 3)].min() > 0.4


def test_its_domains_keep_their_shape_and_share_no_pair():
    system = MODEL.calvados2(MODEL.SEQUENCE, MODEL.TEMPERATURE, MODEL.IONIC)
    assert rb.exclude_within(system, MODEL.DOMAINS) == (79 * 78 + 75 * 74) // 2
    integrator = rb.ExactRigidBodyIntegrator(0.01, bodies=MODEL.DOMAINS)
    context = openmm.Context(system, integrator, REFERENCE)
    context.setPositions(MODEL.start())
    integrator.step(3)
    assert integrator.degreesOfFreedom() == (3 * (160 + 2), 3 * 2)
    x, y = (
        a[MODEL.DOMAINS[1]] for a in (MODEL.start(), context.getState(positions=True).getPositions(asNumpy=True)._value)
    )
    np.testing.assert_allclose(*(np.linalg.norm(a[:, None] - a[None], axis=2) for a in (x, y)), rtol=0.0, atol=1e-13)
