"""Flows of the free rigid body by name.

To add a flow, write a file with a function ``rotor(inertia) -> flow`` and add an entry to `ROTORS`, or pass a `Rotor`
to an integrator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from openmm_exactrb.mathematics.compensated import exactly
from openmm_exactrb.rotors import euler, exact, mclachlan_reich, moser_veselov, quaternion, rotation
from openmm_exactrb.rotors.flow import Rotation, fitting
from openmm_exactrb.support import checks
from openmm_exactrb.support.types import Array

#: Between these bounds, a moment and its reciprocal are normal floating-point numbers.
SMALLEST_MOMENT, LARGEST_MOMENT = 1e-307, 1e307
#: The largest ratio of the moments of a body; with a larger ratio, the smallest moment is lost to rounding.
WIDEST = 1e15


@dataclass(frozen=True)
class Rotor:
    """A method that advances free rigid bodies.

    Attributes
    ----------
    name : str
    order : int or None
        Order in the step size, or None if the method is exact.
    factory : callable
        factory(inertia) -> flow, with component-first inertia (3, 1) or (3, N).
    reference : str
        Publication that describes the method.
    keeps_energy : bool
        Whether the kinetic energy is conserved to roundoff; if not, it is conserved to the order of the flow.
    largest_angle : float
        Largest h norm(m)/min(I), with the step size h, up to which the flow has a result for every body.
    sums : bool
        Whether the flow also accepts the double-doubles of `openmm_exactrb.mathematics.compensated`.
    """

    name: str
    order: int | None
    factory: Callable[[Array], Rotation]
    reference: str
    keeps_energy: bool = True
    largest_angle: float = math.inf
    sums: bool = False

    def __repr__(self) -> str:
        """Return the name, the order and the reference."""
        order = "exact" if self.order is None else f"order {self.order}"
        return f"Rotor({self.name!r}, {order}, {self.reference})"


_HAIRER_VILMART = "Hairer and Vilmart (2006), doi:10.1088/0305-4470/39/42/006"
_PAPER = "Celledoni, Fassò, Säfström and Zanna, doi:10.1137/070704393"
_GAUSS = tuple(
    Rotor(f"{name}_gauss{2 * p}", 2 * p, partial(factory, third_kind=euler.gauss(p)), f"{_PAPER}, equation (39)")
    for name, factory in (("rotation", rotation.rotor), ("quaternion", quaternion.kosenko))
    for p in (3, 4, 5)
)

#: All flows by name.
ROTORS: Mapping[str, Rotor] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            Rotor("exact", None, exact.fastest, _PAPER, sums=True),
            Rotor("exact_numpy", None, exact.in_numpy, _PAPER, sums=True),
            Rotor("rotation", None, rotation.rotor, f"{_PAPER}, section 2.2"),
            Rotor("quaternion_a", None, quaternion.kosenko, f"{_PAPER}, equation (38)"),
            Rotor("quaternion_b", None, quaternion.moving_frame, f"{_PAPER}, section 2.4 (b)"),
            Rotor("quaternion_c", None, quaternion.van_zon_schofield, f"{_PAPER}, section 2.4 (c)"),
            *_GAUSS,
            *(Rotor(f"dmv{n}", n, moser_veselov.rotor(n), _HAIRER_VILMART, largest_angle=1.0) for n in (6, 8, 10)),
            Rotor(
                "mclachlan_reich",
                2,
                mclachlan_reich.rotor,
                "Dullweber, Leimkuhler and McLachlan (1997), doi:10.1063/1.474310",
                keeps_energy=False,
            ),
        )
    }
)


def look_up(rotor: str | Rotor) -> Rotor:
    """Return the rotor with this name, or a `Rotor` unchanged; raise ValueError if the name is unknown."""
    if isinstance(rotor, Rotor):
        return rotor
    if not isinstance(rotor, str) or rotor not in ROTORS:
        raise ValueError(f"the rotor {rotor!r} is unknown: choose one of {', '.join(ROTORS)}, or pass a Rotor")
    return ROTORS[rotor]


def rotor(method: str | Rotor, inertia: ArrayLike) -> Rotation:
    """Return the flow of free bodies with principal moments (3,) or (N, 3), for a key of `ROTORS` or a `Rotor`.

    A ValueError is raised if the rotor is unknown, or if moments have another shape, are not real, positive and finite,
    are below ``SMALLEST_MOMENT`` or above ``LARGEST_MOMENT``, or have a ratio above ``WIDEST``. Moments that violate I1
    + I2 >= I3, which holds for every mass distribution, are accepted, because the equations do not require this
    inequality.
    """
    entry, columns = look_up(method), _columns(inertia)
    return fitting(columns, entry.factory(columns), entry.sums)


def _columns(inertia: ArrayLike) -> Array:
    """Return moments as columns (3, 1) or (3, N); raise ValueError if they are invalid."""
    moments = checks.array(inertia, "inertia")
    if moments.ndim not in (1, 2) or moments.shape[-1] != 3:
        raise ValueError(f"inertia must have the shape (3,) or (N, 3), not {moments.shape}")
    if not (np.isfinite(moments).all() and (moments > 0.0).all()):
        raise ValueError("inertia must be positive and finite: pass the three principal moments of each body")
    least, largest = moments.min(axis=-1), moments.max(axis=-1)
    if (least < np.maximum(SMALLEST_MOMENT, largest / WIDEST)).any() or (largest > LARGEST_MOMENT).any():
        raise ValueError(
            f"inertia must lie between {SMALLEST_MOMENT:g} and {LARGEST_MOMENT:g}, and the moments of one body "
            f"within a factor of {WIDEST:g}: use other units, give light particles more mass, or treat the body as "
            "linear"
        )
    return np.ascontiguousarray(np.atleast_2d(moments).T)


def rotor_of_sums(method: str | Rotor, inertia: ArrayLike, checked: bool = True) -> Rotation:
    """Return the flow of free bodies whose orientations (2, 4, N) and momenta (2, 3, N) are double-doubles.

    Parameters and errors are those of `rotor`. The results of a rotor without ``Rotor.sums`` are rounded to float64.
    With ``checked=False`` shapes are not checked at each call, and compiled code writes past the ends of arrays with
    wrong shapes.
    """
    entry, columns = look_up(method), _columns(inertia)
    flow = fitting(columns, entry.factory(columns), entry.sums) if checked else entry.factory(columns)
    if entry.sums:
        return flow

    def rounding(q: Array, m: Array, t: Array | float) -> tuple[Array, Array]:
        q1, m1 = flow(q[0], m[0], t)
        return exactly(q1), exactly(m1)

    return rounding
