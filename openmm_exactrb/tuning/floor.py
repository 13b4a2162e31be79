"""Settings that limit the energy error of every integrator, because the energy or the force jumps at the cutoff."""

from __future__ import annotations

from collections.abc import Iterator

import openmm

#: Recommended ``ewaldErrorTolerance``: a larger tolerance limits the energy error of the best schemes.
TIGHT = 1e-5


def causes(system: openmm.System) -> Iterator[str]:
    """Yield the settings of a System that cause an energy error with every integrator, each with a remedy."""
    for force in system.getForces():
        if not isinstance(force, (openmm.NonbondedForce, openmm.CustomNonbondedForce)):
            continue
        name, method = type(force).__name__, force.getNonbondedMethod()
        if method == force.NoCutoff:
            continue
        lennard_jones = not isinstance(force, openmm.NonbondedForce) or method != force.LJPME
        if lennard_jones and not force.getUseSwitchingFunction():
            yield f"{name} has a cutoff without a switch: set switchDistance"
        if isinstance(force, openmm.NonbondedForce):
            tolerance = force.getEwaldErrorTolerance()
            if method in (force.PME, force.Ewald, force.LJPME) and tolerance > TIGHT and not any(_chosen(force)):
                yield f"{name} has an ewaldErrorTolerance of {tolerance:g}: use {TIGHT:g}"
            elif method in (force.CutoffPeriodic, force.CutoffNonPeriodic):
                yield f"{name} truncates charges with a jump of the force: use PME"


def _chosen(force: openmm.NonbondedForce) -> tuple[float, ...]:
    """Return the PME parameters that the user set, which override the tolerance, or zeros."""
    alpha, *grid = force.getPMEParameters()
    return (alpha._value if hasattr(alpha, "_value") else alpha, *grid)
