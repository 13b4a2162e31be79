"""A droplet that is run in many ways, and what all of them must leave."""

import mdtraj
import numpy as np
import openmm
from openmm import app

import openmm_exactrb as rb
from places import errors_of
from starts import droplet_of

#: Of the droplet in another process: reports do not fall on the chunks of ten steps.
STEPS, INTERVAL = 1400, 7


def command(steps=STEPS):
    """Return the script and the options of a run of the droplet, up to a multiple of the interval of its reports."""
    length = "--duration", 0.005 * steps, "--frames", steps // INTERVAL
    return "dipole_fluid.py", "-n", 4, "--scheme", "V2", "--step", 0.005, *length


#: The droplet for longer than any test lasts, so that its process is never over before it is killed.
ENDLESS = command(INTERVAL * 10**6)


def beyond(folder):
    """Return a number of steps beyond all that a run of the droplet in another process has written."""
    return INTERVAL * ((folder / "energies.csv").read_bytes().count(b"\n") + 20)


def droplet(n=4, scheme="V2", h=0.005, trap=0.5, rotor="exact", platform="Reference", groups=None):
    """Return a Simulation of some dipoles."""
    integrator = rb.ExactRigidBodyIntegrator(h, scheme=scheme, rotor=rotor)
    if groups is not None:
        integrator.setIntegrationForceGroups(groups)
    return droplet_of(integrator, n, trap, openmm.Platform.getPlatform(platform))


def make(folder, interval=7, **options):
    """Return a run with a trajectory and a table."""
    run = rb.Run(folder, **options)
    run.add_reporter(app.DCDReporter, "trajectory.dcd", interval)
    run.add_reporter(rb.EnergyReporter, "energies.csv", interval)
    return run


def go_on(folder):
    """Bring a run of 60 steps to its end, and compare it with the one beside it that nothing disturbed."""
    make(folder, resume=True).advance(droplet(), 60)
    same_bytes(folder, folder.parent / "whole")


def same_bytes(folder, other):
    """Compare all that a run leaves, but for the dates that OpenMM writes."""
    names = ("energies.csv", "trajectory.dcd", "topology.pdb")
    pairs = [[(place / name).read_bytes() for place in (folder, other)] for name in names]
    assert pairs[0][0] == pairs[0][1]
    dcd = [content[:180] + content[260:] for content in pairs[1]]
    assert dcd[0] == dcd[1]
    pdb = [content.partition(b"\n")[2] for content in pairs[2]]
    assert pdb[0] == pdb[1]


def check_joined(folder, whole, end=STEPS):
    """No frame and no line is lost or doubled, and every bit is that of the uninterrupted run."""
    same_bytes(folder, whole)
    steps = np.loadtxt(folder / "energies.csv", delimiter=",", skiprows=1)[:, 0]
    np.testing.assert_array_equal(steps, np.arange(0, end + 1, INTERVAL))
    trajectory = mdtraj.load(str(folder / "trajectory.dcd"), top=str(folder / "topology.pdb"))
    assert len(trajectory) == len(steps)
    assert not list(folder.glob("*.part"))


def one_line(errors):
    """Check that errors are one line, beside the progress that a slow machine has time to show."""
    lines = [line for line in errors_of(errors).splitlines() if line and not line.endswith("step/s]")]
    assert len(lines) == 1, errors
    assert "Traceback" not in errors
    assert "Exception ignored" not in errors
    return errors
