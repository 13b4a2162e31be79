"""What sets the energy error below which no integrator gets: forces that are not the gradient of the energy."""

from __future__ import annotations

from collections.abc import Iterator

import openmm

from openmm_exactrb.mechanics.bodies import Kind, RigidBodies

#: Of ``ewaldErrorTolerance``: a looser one shows with the best schemes.
TIGHT = 1e-5
_WATER = 18.015  # amu
#: kJ/mol over the square root of the number of molecules: the standard deviation of the total energy of 216 TIP3P over
#: 30 ps with OpenMM's defaults, no switch and a tolerance of 5e-4, by W4_4 with 2 fs per force evaluation on the CPU
#: platform.
WATER_BY_DEFAULT = 0.064


def causes(system: openmm.System) -> Iterator[str]:
    """Yield the settings of a System that put a floor under the energy error of every integrator, with the remedy."""
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


def of_water(system: openmm.System, molecules: int) -> float | None:
    """Return the floor to expect of rigid water in kJ/mol over 30 ps, where it was measured: with OpenMM's defaults."""
    for force in system.getForces():
        if isinstance(force, openmm.NonbondedForce) and force.getNonbondedMethod() == force.PME:
            loose = force.getEwaldErrorTolerance() >= 5e-4 and not any(_chosen(force))
            if molecules and loose and not force.getUseSwitchingFunction():
                return float(WATER_BY_DEFAULT * molecules**0.5)
    return None


def limits(system: openmm.System, bodies: RigidBodies) -> Iterator[str]:
    """Yield what limits the energy error of every integrator, a sentence each."""
    yield from (f"limits the energy error of any integrator: {cause}" for cause in causes(system))
    if level := of_water(system, sum(len(kind.particles) for kind in bodies.kinds if is_water(kind))):
        yield (
            f"expect a standard deviation of the total energy of about {level:.1g} kJ/mol over 30 ps or more with any "
            "integrator: that of TIP3P with these settings, scaled by the square root of the number of molecules"
        )


def is_water(kind: Kind) -> bool:
    """Return whether bodies have the mass of water."""
    return len(kind.masses) == 3 and abs(kind.mass - _WATER) < 0.1


def _chosen(force: openmm.NonbondedForce) -> tuple[float, ...]:
    """Return the parameters of PME if a user set them himself, which the tolerance does not touch, or zeros."""
    alpha, *grid = force.getPMEParameters()
    return (alpha._value if hasattr(alpha, "_value") else alpha, *grid)
