"""Numbers in programs are read alike in every locale, also where the decimal point is a comma."""

import os
import shutil
import subprocess
import sys

import pytest

pytestmark = pytest.mark.library

RUN = """
import locale, sys
import numpy as np
import openmm
import openmm_exactrb as rb
from openmm_exactrb.thermostats import NoseHooverChain
locale.setlocale(locale.LC_ALL, sys.argv[1])
print(locale.localeconv()["decimal_point"])
_, system, positions = rb.rigid_water(2)
for _ in range(3):
    system.addParticle(12.0)
bonds = openmm.CustomBondForce("k*(r-0.153)^2*exp(-0.5*r)")
bonds.addPerBondParameter("k")
bonds.addBond(6, 7, [1e5])
bonds.addBond(7, 8, [1e5])
system.addForce(bonds)
for force in system.getForces():
    if isinstance(force, openmm.NonbondedForce):
        for _ in range(3):
            force.addParticle(0.0, 0.3, 0.0)
thermostat = NoseHooverChain(300.0, 10.0)
integrator = rb.ExactRigidBodyIntegrator(0.004, thermostat=thermostat, fast="bonded", engine="native")
context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
chain = [[1.0, 0.0, 0.0], [1.15, 0.0, 0.0], [1.2, 0.14, 0.0]]
context.setPositions(np.concatenate([positions.value_in_unit(openmm.unit.nanometer), chain]))
context.setVelocitiesToTemperature(300.0, 1)
integrator.step(10)
print(context.getState(positions=True).getPositions(asNumpy=True)._value.tobytes().hex())
"""


def test_a_comma_as_decimal_point_changes_no_bit(tmp_path):
    if shutil.which("localedef") is None:
        pytest.skip("needs the command localedef")
    made = ("localedef", "-i", "de_DE", "-f", "UTF-8", str(tmp_path / "de_DE.UTF-8"))
    if subprocess.run(made, capture_output=True, check=False).returncode > 1:  # 1 means warnings
        pytest.skip("needs the sources of the locale de_DE")
    found = []
    for name in ("C", "de_DE.UTF-8"):
        command = sys.executable, "-c", RUN, name
        environment = os.environ | {"LOCPATH": str(tmp_path)}
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        found.append(run.stdout.split())
    (point, there), (comma, here) = found
    assert (point, comma) == (".", ",")
    assert there == here
