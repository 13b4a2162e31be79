"""Integrators of scripts that are not replaced, and times that are not kept."""

import io
from functools import partial

import openmm
from openmm import app
from test_replace_integrators import FS, silent
from test_same_time import Every, in_water, kept

import openmm_exactrb as rb
from places import REFERENCE
from refusals import assert_refused, refused


def replaced(make):
    with silent():
        make()


def light_particles():
    """In steps of the script that are far shorter than the interval."""
    system = openmm.System()
    system.addParticle(1.0)
    with silent(interval=20 * FS):
        openmm.Context(system, openmm.LangevinMiddleIntegrator(300, 1, 0.01), REFERENCE)
        openmm.Context(system, openmm.LangevinMiddleIntegrator(300, 1, 0.001), REFERENCE)


def reported(make):
    with kept(4 * FS):
        simulation = in_water(1 * FS)
        simulation.reporters.append(make(6))
        simulation.step(24)


def in_a_compound():
    _, system, _ = rb.rigid_water(1)
    compound = openmm.CompoundIntegrator()
    with kept(4 * FS):
        compound.addIntegrator(openmm.VerletIntegrator(0.002))
        openmm.Context(system, compound, REFERENCE)


def without_a_ratio():
    with kept(4 * FS):
        in_water(2.71828 * FS)


@refused(
    # Arguments that OpenMM refuses, and so does what stands in its place.
    *(
        (call, ".", (TypeError, ValueError, IndexError))
        for make in [
            lambda: openmm.LangevinMiddleIntegrator(300, 1),
            lambda: openmm.LangevinMiddleIntegrator(300, 1, 0.002, 4),
            lambda: openmm.VerletIntegrator(0.001, steps=3),
            lambda: openmm.VerletIntegrator("2 fs"),
            lambda: openmm.LangevinIntegrator(300 * FS, 1, 0.002),
        ]
        for call in (make, partial(replaced, make))
    ),
    (light_particles, "needs heavy hydrogens"),
    *(
        (partial(reported, make), "cannot be divided")
        for make in (Every, lambda n: app.StateDataReporter(io.StringIO(), n, step=True))
    ),
    (in_a_compound, "the steps of a CompoundIntegrator cannot be divided"),
    (without_a_ratio, r"cannot keep the time of steps of 2\.71828 fs"),
)
def test_a_sentence_says_what_is_wrong(call, sentence, error):
    assert_refused(call, sentence, error)
