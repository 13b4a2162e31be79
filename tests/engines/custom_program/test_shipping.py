"""A run that is written as XML goes on in plain OpenMM."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import openmm
import pytest
from devices import REFERENCE, context_of, gpu_platform, shown, stepped

import openmm_exactrb as rb
from peptides import in_water


def written(context, folder):
    """Write System, integrator and State of a Context."""
    state = context.getState(positions=True, velocities=True, parameters=True, integratorParameters=True)
    parts = {"system": context.getSystem(), "integrator": context.getIntegrator(), "state": state}
    for name, part in parts.items():
        (folder / f"{name}.xml").write_text(openmm.XmlSerializer.serialize(part))


def continued(folder, platform, precision, steps):
    """Go on in a process without the package, and return positions and velocities."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    program = Path(__file__).parent / "plain_openmm.py"
    subprocess.run(
        [sys.executable, "-I", program, folder, platform, precision, str(steps)],
        cwd=folder,
        env=environment,
        check=True,
    )
    return np.load(folder / "plain.npy")


@pytest.mark.parametrize("scheme", ["S2_2", "V2_C17"])
def test_the_same_steps_in_plain_openmm(scheme, tmp_path):
    _, system, positions = rb.rigid_water(4)
    context = context_of(system, positions, "device", scheme=scheme)
    context.getIntegrator().step(3)
    written(context, tmp_path)
    before = shown(context)
    after = stepped(context, 4)
    assert np.abs(after - before).max() > 1e-4
    there = continued(tmp_path, "Reference", "-", 4)
    if rb.SCHEMES[scheme].processor:  # in plain OpenMM each step enters and leaves the inner coordinates
        np.testing.assert_allclose(there, after, rtol=0.0, atol=1e-12)
    else:
        np.testing.assert_array_equal(there, after)


def test_a_peptide_with_inner_steps_in_plain_openmm(tmp_path):
    """Its bonded forces have a force group of their own there, which acts within the drifts alone."""
    _, system, positions = in_water()
    context = context_of(system, positions, "device", scheme="S2_3", h=0.003, fast="bonded")
    context.getIntegrator().step(3)
    written(context, tmp_path)
    before = shown(context)
    after = stepped(context, 4)
    assert np.abs(after - before).max() > 1e-4
    np.testing.assert_array_equal(continued(tmp_path, "Reference", "-", 4), after)


@pytest.mark.opencl
def test_plain_openmm_on_a_device(tmp_path):
    _, system, positions = rb.rigid_water(27)
    platform = gpu_platform()
    context = context_of(system, positions, "device", platform=platform, precision="double", scheme="S2_2")
    context.getIntegrator().step(3)
    written(context, tmp_path)
    there, here = continued(tmp_path, platform.getName(), "double", 5), stepped(context, 5)
    np.testing.assert_array_equal(there, here)


@pytest.mark.opencl
def test_dipoles_with_a_cutoff_in_plain_openmm(tmp_path):
    """In a box, where a new Context wraps molecules and sorts them again, which rounds otherwise."""
    _, system, positions = rb.dipole_fluid(64, kernel="openmm", boundary=rb.ReactionField(cutoff=1.5), density=0.4)
    platform = gpu_platform()
    context = context_of(system, positions, "device", platform=platform, precision="double", scheme="S2_2")
    context.getIntegrator().step(3)
    written(context, tmp_path)
    there, here = continued(tmp_path, platform.getName(), "double", 5), stepped(context, 5)
    np.testing.assert_allclose(there[0], here[0], rtol=0.0, atol=1e-7)  # virtual sites: OpenMM's constraints


def test_a_program_without_bodies_is_loud():
    _, system, positions = rb.rigid_water(2)
    text = openmm.XmlSerializer.serialize(rb.ExactRigidBodyIntegrator(0.001, engine="device"))
    context = openmm.Context(system, openmm.XmlSerializer.deserialize(text), REFERENCE)
    context.setPositions(positions)
    context.getIntegrator().step(1)
    assert not np.isfinite(shown(context)[0]).any()
