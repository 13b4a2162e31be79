"""Boundary conditions of dipoles: none, a dielectric beyond a cutoff, or all periodic images.

A switch S takes the energy of a pair of nearest images to zero at the cutoff. The spheres have a separate switch; see
`openmm_exactrb.potentials.spheres`. S is proportional to the integral of (t (1 - t))^6 over t from 0 to s, where s
falls linearly in r² from 1 at `switch` to 0 at `cutoff`. Forces then have five continuous derivatives, which schemes of
order 6 require.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, TypeAlias

import numpy as np
from openmm import unit

from openmm_exactrb.potentials import ewald
from openmm_exactrb.potentials.dielectric import reaction
from openmm_exactrb.potentials.switching import sharp_volume
from openmm_exactrb.support import checks
from openmm_exactrb.support.messages import shown

_log = logging.getLogger("openmm_exactrb")

Edges: TypeAlias = ewald.Edges
#: Cutoff and start of the switch in nm, and the strength of the reaction field in 1/nm³.
Truncation: TypeAlias = tuple[float, float, float]
#: Inverse width of the Gaussians (1/nm); the largest wave number (1/nm), or the spacings of a mesh (nm) and the order
#: of its splines; and the relative permittivity around all images.
Images: TypeAlias = tuple[float, float, float] | tuple[float, Edges, int, float]


@dataclass(frozen=True)
class Open:
    """No periodic box: all pairs interact at any distance."""

    periodic: ClassVar[bool] = False

    def truncation(self, box: Edges | None, n: int = 1) -> None:
        """Return None, because there is no cutoff; raise ValueError if there is a box."""
        if box is not None:
            raise ValueError(
                "box= needs a periodic boundary: add boundary=ReactionField() or boundary=Ewald(), or omit box="
            )

    def images(self, n: int, box: Edges | None) -> None:
        """Return None, because there are no images."""


@dataclass(frozen=True, kw_only=True)
class _Periodic:
    """Common settings of periodic boundaries."""

    cutoff: float | None = None
    switch: float | None = None
    dielectric: float = np.inf

    periodic: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Raise ValueError for settings that are invalid in every box."""
        if self.cutoff is not None:
            checks.positive(self.cutoff, "cutoff", "nm")
        if self.switch is not None:
            checks.not_negative(self.switch, "switch")
            if self.cutoff is not None:
                _check_switch(self.switch, self.cutoff)
        reaction(self.dielectric)

    def distances(self, box: Edges | None) -> tuple[float, float]:
        """Return the cutoff and the start of the switch (nm); raise ValueError if the box is missing or too small."""
        if box is None:
            raise ValueError(f"{self} needs a periodic box: add box=(a, b, c), with edges in nm")
        cutoff = 0.5 * min(box) if self.cutoff is None else _plain(self.cutoff)
        check_cutoff(cutoff, box)
        switch = 0.75 * cutoff if self.switch is None else _plain(self.switch)
        _check_switch(switch, cutoff)
        return cutoff, switch


@dataclass(frozen=True, kw_only=True)
class ReactionField(_Periodic):
    """A periodic box with nearest images within a cutoff, and the reaction field of a dielectric beyond it.

    The reaction field adds the energy -2 (eps - 1)/(2 eps + 1) mu_i.mu_j/a³ to that of each pair (Barker and Watts,
    Mol. Phys. 26, 789 (1973)). With the switching function S, a³ = 3 integral S r² dr, so that a sphere of radius a has
    the volume of the switched cutoff sphere. A uniform polarisation then produces the reaction field of `dielectric`,
    as the fluctuation formula of `dielectric_constant` requires.

    Parameters
    ----------
    cutoff, switch : float, optional
        Cutoff of the energy of a pair and start of its switch, in nm; by default half the shortest edge of the box and
        three quarters of the cutoff.
    dielectric : float
        Relative permittivity around the cutoff sphere: infinity for a conductor, 1 for truncation without a field.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    def truncation(self, box: Edges | None, n: int = 1) -> Truncation:
        """Return the cutoff and the start of the switch (nm), and the strength of the reaction field (1/nm³)."""
        cutoff, switch = self.distances(box)
        return cutoff, switch, reaction(self.dielectric) / sharp_volume(cutoff, switch)

    def images(self, n: int, box: Edges | None) -> None:
        """Return None, because images are not summed."""


@dataclass(frozen=True, kw_only=True)
class Ewald(_Periodic):
    """A periodic box with interactions between all images (de Leeuw, Perram and Smith, Proc. R. Soc. A 373, 27 (1980)).

    The sum in reciprocal space is direct, or uses a mesh (smooth particle mesh Ewald). Omitted parameters are chosen
    such that the sum is fast and meets the tolerance; ``getParameters`` returns them. The spheres of `dipole_fluid`
    have a separate cutoff. Forces are the exact gradient of the energy. In a fixed box the energy is therefore smooth
    for any tolerance, and a symplectic scheme conserves the energy. If the box changes, the energy jumps by at most
    about the tolerance. An Ewald sum needs the compiled kernel, or ``kernel="openmm"`` of `dipole_fluid`.

    Parameters
    ----------
    cutoff, switch : float, optional
        Cutoff of the energy of a pair and start of its switch, in nm. The default cutoff is the fastest one for a mesh,
        and half the shortest edge of the box for the direct sum; the switch begins at three quarters of the cutoff.
    dielectric : float
        Relative permittivity around all images: infinity for a conductor, 1 for vacuum.
    tolerance : float
        Error of forces, fields and torques, relative to their root mean square in a liquid or gas.
    method : {"auto", "direct", "mesh"}
        Method of the sum in reciprocal space; "auto" selects the faster method.
    mesh : int or (3,) int, optional
        Numbers of mesh points along the edges, with prime factors up to 5. Implies "mesh".
    order : int, optional
        Even order of the B-splines, from 4 to 16, by default 8 or 10. Forces have order - 4 continuous derivatives.
        Implies "mesh".

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    tolerance: float = 1e-4
    method: str = "auto"
    mesh: int | tuple[int, int, int] | None = None
    order: int | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for settings that are invalid in every box."""
        super().__post_init__()
        if not 1e-13 <= checks.number(self.tolerance, "tolerance") <= 1e-2:
            raise ValueError(f"tolerance must be between 1e-13 and 1e-2, not {self.tolerance!r}")
        if self.method not in ("auto", "direct", "mesh"):
            raise ValueError(f"the method {self.method!r} is unknown: choose one of auto, direct, mesh")
        if self.method == "direct" and not (self.mesh is None and self.order is None):
            raise ValueError("the direct sum has no mesh: omit mesh= and order=, or use method='mesh'")
        if self.order is not None and (checks.whole(self.order, "order") % 2 or not 4 <= self.order <= 16):
            raise ValueError(f"order must be an even number from 4 to 16, not {self.order!r}")
        if self.mesh is not None:
            import scipy.fft  # slow to import

            for points in np.ravel(self.mesh):
                fast = scipy.fft.next_fast_len(checks.whole(points, "each number of points of the mesh"), real=True)
                if fast != points:
                    raise ValueError(
                        f"a mesh of {points} points along an edge has a slow Fourier transform: use {fast} points"
                    )
            if np.shape(self.mesh) not in ((), (3,)):
                raise ValueError(
                    f"mesh must be one number of points or three numbers, one for each edge, not {shown(self.mesh)}"
                )
            points = tuple(map(int, np.ravel(self.mesh)))  # lists and arrays have no hash
            object.__setattr__(self, "mesh", points if len(points) == 3 else points[0])
            if min(np.ravel(self.mesh)) < (self.order or 10) + ewald.LANES:
                raise ValueError(
                    f"mesh must have at least order + {ewald.LANES} = {(self.order or 10) + ewald.LANES} points along "
                    f"each edge, not {self.mesh!r}"
                )

    def getParameters(self, n: int, box: Sequence[float]) -> ewald.EwaldParameters:
        """Return the parameters of the sum over n dipoles in a box with given edges (nm).

        Raises
        ------
        ValueError
            If the box is too small for the cutoff, or the given parameters cannot meet the tolerance.
        """
        return _parameters(self, checks.whole(n, "n"), edges_of(box))

    def truncation(self, box: Edges | None, n: int = 1) -> Truncation:
        """Return the cutoff and the start of the switch (nm) for n dipoles in a box, and 0 for the reaction field."""
        self.distances(box)
        assert box is not None
        chosen = self.getParameters(n, box)
        return chosen.cutoff, chosen.switch, 0.0

    def images(self, n: int, box: Edges | None) -> Images:
        """Return the parameters of the sum over the images of n dipoles."""
        assert box is not None
        chosen, dielectric = self.getParameters(n, box), _plain(self.dielectric)
        if chosen.method == "direct":
            return chosen.alpha, chosen.k_max, dielectric
        x, y, z = (edge / points for edge, points in zip(box, chosen.points, strict=True))
        return chosen.alpha, (x, y, z), chosen.order, dielectric


@lru_cache
def _parameters(boundary: Ewald, n: int, edges: Edges) -> ewald.EwaldParameters:
    """Return the parameters of the fastest sum that has the settings of a boundary."""
    cutoff, switch = boundary.distances(edges)
    by_mesh = boundary.method == "mesh" or not (boundary.mesh is None and boundary.order is None)
    if by_mesh and boundary.tolerance < ewald.LEAST_TOLERANCE:
        raise ValueError(
            f"a mesh needs a tolerance of at least {ewald.LEAST_TOLERANCE:g}, not {boundary.tolerance:g}: use a larger "
            "tolerance, or method='direct' without mesh= and order="
        )
    choices = [] if by_mesh else [ewald.direct(n, edges, cutoff, switch, boundary.tolerance)]
    if by_mesh or (boundary.method == "auto" and boundary.tolerance >= ewald.LEAST_TOLERANCE):
        given = None if boundary.cutoff is None else cutoff
        points = None if boundary.mesh is None else tuple(int(m) for m in np.broadcast_to(boundary.mesh, 3))
        begin = None if boundary.switch is None else switch
        choices += ewald.meshes(n, edges, boundary.tolerance, given, begin, boundary.order, points)
    if not choices:
        raise ValueError(
            f"no mesh of up to {ewald.MOST_POINTS} points along an edge meets a tolerance of {boundary.tolerance:g} "
            f"for {n} dipole{'s' * (n != 1)} with the given parameters: use a larger tolerance, a longer "
            "cutoff, a higher order, or method='direct'"
        )
    # At similar costs the direct sum is preferred, because it has no mesh error.
    weights = {"direct": 0.8, "mesh": 1.0}
    chosen = min(choices, key=lambda choice: weights[choice.method] * ewald.cost(n, edges, choice))
    if chosen.error > boundary.tolerance:
        raise ValueError(
            f"a mesh of {chosen.points} points with splines of order {chosen.order} and a cutoff of {chosen.cutoff:g} "
            f"nm has an error of {chosen.error:.2g}, above the tolerance of {boundary.tolerance:g}: use more points, "
            "a longer cutoff or a larger tolerance"
        )
    _log.info("Ewald sum of %d dipoles: %s", n, chosen)
    return chosen


Boundary: TypeAlias = Open | ReactionField | Ewald

#: The default boundary.
OPEN = Open()


def checked(boundary: Boundary) -> Boundary:
    """Return the argument if it is a boundary; raise ValueError for anything else."""
    if not isinstance(boundary, Open | ReactionField | Ewald):
        raise ValueError(f"boundary must be one of Open(), ReactionField(...) and Ewald(...), not {shown(boundary)}")
    return boundary


def edges_of(box: Sequence[float]) -> Edges:
    """Return the edges of a rectangular box (nm) as floats; raise ValueError unless they are three positive numbers."""
    if unit.is_quantity(box) or np.shape(box) != (3,):
        raise ValueError(f"box must be three positive edges in nm without a unit, such as (3, 3, 3), not {shown(box)}")
    a, b, c = (checks.positive(edge, "each edge of the box", "nm") for edge in box)
    return a, b, c


def check_cutoff(cutoff: float, edges: Sequence[float], name: str = "cutoff") -> None:
    """Raise ValueError if a cutoff is longer than half the shortest edge of a box (lengths in nm)."""
    half = 0.5 * min(edges)
    if not cutoff <= half * (1.0 + 1e-12):
        raise ValueError(
            f"{name} must be at most half the shortest edge of the box, {half:g} nm, not {cutoff:g} nm: use a larger "
            "box or a shorter cutoff, and leave room if a barostat may shrink the box"
        )


def _plain(value: float) -> float:
    """Return a Python number, because formulas and pickles would show the type of a numpy number."""
    return value.item() if isinstance(value, np.generic) else value


def _check_switch(switch: float, cutoff: float) -> None:
    if not switch < cutoff:
        raise ValueError(f"switch must be below the cutoff of {cutoff:g} nm, not {switch:g} nm")
