"""Forces of which OpenMM does not know all: functions of Python, forces of plugins, and inner Contexts."""

from __future__ import annotations

import openmm

from openmm_exactrb.context.dipole_boxes import NAME

#: Names of the potentials of this package, which conserve the energy and follow the periodic box.
OURS = (NAME, "GayBernePotential")


def conserve_energy(system: openmm.System) -> bool:
    """Return whether the forces of a System are known to conserve its energy.

    A PythonForce from outside this package may depend on time or have no energy. A force of a plugin, which has the
    class Force in Python, may do work.
    """
    return not any(
        type(force) is openmm.Force or (isinstance(force, openmm.PythonForce) and force.getName() not in OURS)
        for force in system.getForces()
    )


def reports_changes(system: openmm.System) -> bool:
    """Return whether OpenMM reports all changes of the forces of a System to the integrator.

    It reports no changes in the inner Context of a CustomCVForce, nor of data that the function of a PythonForce reads.
    """
    return conserve_energy(system) and not any(isinstance(force, openmm.CustomCVForce) for force in system.getForces())
