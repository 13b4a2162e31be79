"""Bonded forces of every form that kernels know, along the chain of N particles from `first` on."""

import numpy as np
import openmm

from openmm_exactrb.multiple_time_steps.bonded import BONDED_FORCES, Bonded, interacting_exceptions
from openmm_exactrb.multiple_time_steps.excerpt_forces import terms_of

RNG = np.random.default_rng(5)
#: The state of the generator at the start of every test (tests/conftest.py).
START = RNG.bit_generator.state
N = 140  # more terms than two blocks of the kernel have


def bonds(first=0):
    force = openmm.HarmonicBondForce()
    for i in range(first, first + N - 1):
        force.addBond(i, i + 1, *RNG.uniform((0.1, 1e4), (0.2, 4e5)))
    return force


def angles(first=0):
    force = openmm.HarmonicAngleForce()
    for i in range(first, first + N - 2):
        force.addAngle(i, i + 1, i + 2, *RNG.uniform((0.5, 100.0), (np.pi, 800.0)))
    return force


def periodic_torsions(first=0):
    force = openmm.PeriodicTorsionForce()
    for i in range(first, first + N - 3):
        for n in RNG.permutation(6)[:3]:
            force.addTorsion(i, i + 1, i + 2, i + 3, int(n) + 1, RNG.uniform(-4.0, 4.0), RNG.uniform(-20.0, 20.0))
    force.addTorsion(first + 3, first + 2, first + 1, first, 2, np.pi, 4.0)
    return force


def polynomial_torsions(first=0):
    force = openmm.RBTorsionForce()
    for i in range(first, first + N - 3):
        force.addTorsion(i, i + 1, i + 2, i + 3, *RNG.uniform(-20.0, 20.0, 6))
    return force


def pairs(first=0):
    force = openmm.NonbondedForce()
    for i in range(first, first + N - 3):
        force.addException(i, i + 3, *RNG.uniform((-0.5, 0.2, 0.0), (0.5, 0.4, 2.0)))
    return interacting_exceptions(force)[0].made()


def lennard_jones_pairs(first=0):
    force = openmm.CustomBondForce("4*epsilon*((sigma/r)^12-(sigma/r)^6)")
    force.addPerBondParameter("epsilon")
    force.addPerBondParameter("sigma")
    for i in range(first, first + N - 3):
        force.addBond(i, i + 3, RNG.uniform((0.0, 0.2), (2.0, 0.4)))
    return force


def harmonic_torsions(first=0, pi=f"{np.pi}"):
    force = openmm.CustomTorsionForce(f"k*min(dtheta, 2*pi-dtheta)^2; dtheta = abs(theta-theta0); pi = {pi}")
    force.addPerTorsionParameter("k")
    force.addPerTorsionParameter("theta0")
    for i in range(first, first + N - 3):
        force.addTorsion(i, i + 1, i + 2, i + 3, RNG.uniform((1.0, -3.0), (200.0, 3.0)))
    return force


def harmonic_torsions_of_files(first=0):
    """As OpenMM's CharmmPsfFile makes them."""
    return harmonic_torsions(first, "3.141593;")


def torsions_on_a_line(first=0):
    """As charmm36.xml has them."""
    force = openmm.CustomTorsionForce("k*(theta-theta0)^2")
    force.addPerTorsionParameter("theta0")
    force.addPerTorsionParameter("k")
    for i in range(first, first + N - 3):
        force.addTorsion(i, i + 1, i + 2, i + 3, RNG.uniform((-3.0, 1.0), (3.0, 200.0)))
    return force


def maps(first=0):
    force = openmm.CMAPTorsionForce()
    for size in (24, 5):
        force.addMap(size, RNG.uniform(-10.0, 10.0, size * size))
    for i in range(first, first + N - 4):
        force.addTorsion(i % 2, i, i + 1, i + 2, i + 3, i + 1, i + 2, i + 3, i + 4)
    return force


def terms_in(system, groups=-1):
    """Return the terms of the bonded forces of a System, None where it has others."""
    return terms_of([Bonded.of(force) for force in system.getForces() if isinstance(force, BONDED_FORCES)], groups)


def system_of(*forces, n=N):
    system = openmm.System()
    for _ in range(n):
        system.addParticle(1.0)
    for force in forces:
        system.addForce(force)
    return system


FORMS = (
    *(bonds, angles, periodic_torsions, polynomial_torsions),
    *(pairs, lennard_jones_pairs, harmonic_torsions, harmonic_torsions_of_files, torsions_on_a_line, maps),
)


def tether(i, j):
    """Return a bonded force that no kernel has, because it is periodic."""
    force = openmm.CustomBondForce("pull*(r-0.3)^4")
    force.addGlobalParameter("pull", 1e3)
    force.addBond(i, j, [])
    force.setUsesPeriodicBoundaryConditions(True)
    force.setName("tether")
    return force
