"""Functions of jobs, which worker processes import by name."""

import contextlib
import functools
import os
import time
from pathlib import Path

import numpy as np

import openmm_exactrb as rb
from peptides import in_water
from starts import context_of

SHORT = {"build": rb.dipole_fluid, "n": 8, "step": 0.02, "duration": 0.2, "temperature": 10.0}


def energies(build, *, step, duration, scheme="SRKN4_6b", temperature=None, seed=0, **arguments):
    """Return the total energies of a run on Reference."""
    _, system, positions = build(**arguments)
    integrator = rb.ExactRigidBodyIntegrator(step, scheme=scheme, engine="host")
    _context = context_of(system, integrator, positions)
    if temperature is not None:
        integrator.setVelocitiesToTemperature(temperature, seed)
    totals = []
    for _ in range(round(duration / step)):
        integrator.step(1)
        totals.append(integrator.totalEnergy()._value)
    return {"energies": totals}


def flexible():
    """Build alanine dipeptide with two molecules of water."""
    return in_water(waters=2)


def held_up(folder, seed, **arguments):
    """Run energies; the first time that it comes to seed 3, wait to be killed."""
    note = Path(folder) / str(seed)
    first = not note.exists()
    with note.open("a") as file:
        file.write(f"{os.getpid()}\n")
    if seed == 3 and first:
        time.sleep(300.0)
    return energies(seed=seed, **arguments)


def deadly():
    os._exit(1)


def square(x):
    return x * x


class Multiple:
    def __init__(self, factor):
        self.factor = factor

    def of(self, x):
        return self.factor * x

    @classmethod
    def named(cls, x):
        return f"{cls.__name__} {x}"

    @staticmethod
    def twice(x):
        return 2 * x


class Other(Multiple):
    pass


@functools.wraps(square)
def disguised(x):
    return -x * x


def counted(folder, name):
    with (Path(folder) / name).open("a") as file:
        file.write("called\n")
    if name == "bad":
        raise ArithmeticError(f"{name} cannot be")
    return {"array": np.arange(3) / 7.0, "tuple": (1, 2.0, None), "nan": np.float64("nan"), "name": name}


def unkeepable():
    return {"object": object()}


def gated(folder, x):
    """Return x at once in the first three jobs that come; in others, wait until a file opens the gate."""
    for place in "123":
        with contextlib.suppress(FileExistsError):
            (Path(folder) / place).touch(exist_ok=False)
            return x
    while not (Path(folder) / "open").exists():
        time.sleep(0.02)
    return x
