"""The boxes in which the energies of dipoles that are defined by formulas are valid."""

from __future__ import annotations

import numpy as np
import openmm

from openmm_exactrb.openmm_access import arrays
from openmm_exactrb.support.types import Array

#: The name of the forces of dipoles.
NAME = "SoftDipoleForce"
#: The Context parameters with the shortest valid edge, and with the edges (nm) for which a formula of bonds is written.
SHORTEST, WRITTEN_FOR = "shortest_edge", ("box_x", "box_y", "box_z")
#: The smallest and the largest edge of the box, in units of the edge for which a formula of bonds is written.
EDGES = 0.62, 2.1
#: Edges of a box are compared with the shortest edge to within this relative tolerance.
ROUNDOFF = 1e-6


class DipoleBoxes:
    """The dipoles of a System that are defined by formulas in a periodic box.

    A force with a bond for each pair measures the box, and its energy is nan in other boxes than `check` accepts. A
    CustomHbondForce is silently wrong in a box that is too small.
    """

    def __init__(self, system: openmm.System) -> None:
        found = [force for force in system.getForces() if force.getName() == NAME]
        kinds = openmm.CustomHbondForce, openmm.CustomCompoundBondForce
        self._pairs, self._bonds = (
            any(isinstance(force, kind) and force.usesPeriodicBoundaryConditions() for force in found) for kind in kinds
        )

    @property
    def any(self) -> bool:
        """Whether the System has such dipoles."""
        return self._pairs or self._bonds

    def check(self, context: openmm.Context, *, barostats: bool = False) -> None:
        """Raise ValueError if the dipoles have no valid energy in the present box of a Context, or with barostats."""
        if not self.any:
            return
        if self._pairs and barostats:
            raise ValueError(
                "a barostat changes the box, but dipoles with kernel='openmm' can adapt only while the box is wide "
                "enough: create the dipoles with kernel='compiled', or remove the barostat from the System"
            )
        state = context.getState(parameters=True)
        box, parameters = np.reshape(arrays.box(state), (3, 3)), state.getParameters()
        edges = box.diagonal()
        if edges.min() < parameters[SHORTEST] * (1.0 - ROUNDOFF):
            raise ValueError(
                f"dipoles with these cutoffs need a box with edges of at least {parameters[SHORTEST]:g} nm, not "
                f"{edges.min():g} nm: use a larger box, or create the dipoles with shorter cutoffs"
            )
        if self._bonds:
            _check_measurable(box, np.array([parameters[name] for name in WRITTEN_FOR]))


def _check_measurable(box: Array, written_for: Array) -> None:
    """Raise ValueError if a formula of bonds cannot measure a box (3, 3)."""
    if np.count_nonzero(box) != 3:
        raise ValueError("dipoles with kernel='bonds' need a rectangular box: set orthogonal box vectors")
    ratio = box.diagonal() / written_for
    if not (EDGES[0] <= ratio.min() and ratio.max() <= EDGES[1]):
        raise ValueError(
            f"dipoles with kernel='bonds' need a box with edges from {EDGES[0]} to {EDGES[1]} times the Context "
            f"parameters box_x, box_y and box_z, not {ratio[np.argmax(abs(np.log(ratio)))]:.3g} times: set these "
            "parameters to the edges of the box (nm) with context.setParameter"
        )
