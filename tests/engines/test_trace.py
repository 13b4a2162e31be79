"""How many files of the package, and calls beside the substeps, a step of a running simulation passes."""

import sys
from pathlib import Path

import pytest

import openmm_exactrb as rb
from peptides import peptide
from starts import context_of

PACKAGE = str(Path(rb.__file__).parent)


def trace_of(system, positions, integrator):
    """Return the files that the sixth step enters, and the number of calls outside its substeps."""
    _context = context_of(system, integrator, positions)
    integrator.setVelocitiesToTemperature(100.0, 1)  # from rest, energies would be compared
    integrator.setRandomNumberSeed(1)
    integrator.step(5)
    files, within, outside = set(), 0, 0

    def noticed(frame, event, arg):
        nonlocal within, outside
        if not frame.f_code.co_filename.startswith(PACKAGE):
            return
        in_substeps = frame.f_code.co_name == "through"
        if event == "call":
            within += in_substeps
            outside += not within
            files.add(frame.f_code.co_filename)
        elif event == "return":
            within -= in_substeps

    sys.setprofile(noticed)
    try:
        integrator.step(1)
    finally:
        sys.setprofile(None)
    return files, outside


@pytest.mark.parametrize(
    ("make", "most"),
    [
        (lambda **options: rb.ExactRigidBodyIntegrator(0.0005, "S2_2", **options), 21),
        (lambda **options: rb.ExactRigidBodyIntegrator(0.0005, **options), 24),
        (lambda **options: rb.ExactRigidBodyLangevinIntegrator(100.0, 1.0, 0.0005, "S2_2", **options), 25),
    ],
    ids=["S2_2", "default", "Langevin"],
)
def test_a_step_of_water_passes_few_files(make, most):
    _, system, positions = rb.rigid_water(2)
    files, outside = trace_of(system, positions, make(engine="host"))
    assert len(files) <= most, sorted(files)
    assert outside <= 150


@pytest.mark.parametrize(
    ("make", "most"),
    [
        (lambda **options: rb.ExactRigidBodyIntegrator(0.0005, "S2_2", fast=None, **options), 21),
        (lambda **options: rb.ExactRigidBodyLangevinIntegrator(100.0, 1.0, 0.0005, "S2_2", fast=None, **options), 25),
        (lambda **options: rb.ExactRigidBodyIntegrator(0.0005, "S2_2", fast="bonded", **options), 28),
    ],
    ids=["plain", "Langevin", "nested"],
)
def test_a_step_of_a_peptide_passes_few_files(make, most):
    _, system, positions = peptide()
    files, outside = trace_of(system, positions, make(engine="host"))
    assert len(files) <= most, sorted(files)
    assert outside <= 180  # inner steps take Python 25 more
