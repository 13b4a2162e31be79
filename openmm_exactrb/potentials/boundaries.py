"""Boundary conditions of dipoles: none, a dielectric beyond a cutoff, or all periodic images.

A switch S on the energy of pairs of nearest images ends it at the cutoff. S is proportional to the integral of
(s (1 - s))^6 from 0 to s, where s runs from 1 to 0 in r² between `switch` and `cutoff`: forces have five continuous
derivatives, as schemes of order 6 need them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np
from openmm import unit

from openmm_exactrb import checks
from openmm_exactrb.dielectric import reaction
from openmm_exactrb.potentials.ewald import splitting

Edges: TypeAlias = tuple[float, float, float]
#: Cutoff and begin of the switch in nm, and the strength of the reaction field in 1/nm³.
Truncation: TypeAlias = tuple[float, float, float]
#: Inverse width of the clouds and largest wave number in 1/nm, and the relative permittivity around all images.
Images: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class Open:
    """No box: all pairs, at any distance."""

    periodic: ClassVar[bool] = False

    def truncation(self, box: Edges | None) -> None:
        """Return that there is none, nor a box."""
        if box is not None:
            raise ValueError("a box needs periodic boundaries: add boundary=ReactionField() or boundary=Ewald()")

    def images(self, n: int, box: Edges | None) -> None:
        """Return that there are none."""


@dataclass(frozen=True, kw_only=True)
class _Periodic:
    """Common settings of periodic boundaries."""

    cutoff: float | None = None
    switch: float | None = None
    dielectric: float = np.inf

    periodic: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse what fits no box."""
        if self.cutoff is not None:
            checks.positive(self.cutoff, "cutoff", "nm")
        if self.switch is not None:
            checks.not_negative(self.switch, "switch")
            if self.cutoff is not None:
                _check_switch(self.switch, self.cutoff)
        reaction(self.dielectric)

    def distances(self, box: Edges | None) -> tuple[float, float]:
        """Return cutoff and begin of the switch (nm); a ValueError if there is no box, or they do not fit it."""
        if box is None:
            raise ValueError(f"{self} needs a periodic box: add box=(a, b, c), its edges in nm")
        cutoff = 0.5 * min(box) if self.cutoff is None else _plain(self.cutoff)
        check_cutoff(cutoff, box)
        switch = 0.75 * cutoff if self.switch is None else _plain(self.switch)
        _check_switch(switch, cutoff)
        return cutoff, switch


@dataclass(frozen=True, kw_only=True)
class ReactionField(_Periodic):
    """A periodic box of nearest images within a cutoff, and the field of a dielectric around it.

    The field is -2 (eps - 1)/(2 eps + 1) mu_i.mu_j/a³ for a pair (Barker and Watts, Mol. Phys. 26, 789 (1973)). The
    radius a³ = 3 integral S r² dr is that of a sharp sphere with the same volume as the switched one: a uniform
    polarisation then has the reaction field that `dielectric` asks for, which the fluctuation formula of
    `dielectric_constant` relies on.

    Parameters
    ----------
    cutoff, switch : float, optional
        Where the energy of a pair ends, and where its switch begins, in nm; half the shortest edge of the box, and
        three quarters of the cutoff.
    dielectric : float
        Relative permittivity around the cutoff sphere: infinity for a conductor, 1 for truncation without a field.

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    def truncation(self, box: Edges | None) -> Truncation:
        """Return cutoff, begin of the switch (nm) and strength of the reaction field (1/nm³) in a box."""
        cutoff, switch = self.distances(box)
        return cutoff, switch, reaction(self.dielectric) / sharp_volume(cutoff, switch)

    def images(self, n: int, box: Edges | None) -> None:
        """Return that they are not summed."""


@dataclass(frozen=True, kw_only=True)
class Ewald(_Periodic):
    """A periodic box and the dipoles of all its images (de Leeuw, Perram and Smith, Proc. R. Soc. A 373, 27 (1980)).

    The switch acts on the spheres and on next to nothing of the dipoles. The sum has an exact gradient: whatever its
    tolerance, in a fixed box it is as smooth as the switch, and a symplectic scheme keeps its energy. Where the box
    changes, the energy jumps by up to about the tolerance. It needs the compiled kernel.

    Parameters
    ----------
    cutoff, switch : float, optional
        Where the energy of a pair ends, and where its switch begins, in nm; half the shortest edge of the box, and
        three quarters of the cutoff.
    dielectric : float
        Relative permittivity around all images: infinity for a conductor, 1 for vacuum.
    tolerance : float
        Error of the dipoles' forces and fields, as a part of their root mean square in a liquid or gas.

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        """Refuse what fits no box."""
        super().__post_init__()
        if not 1e-13 <= checks.number(self.tolerance, "tolerance") <= 1e-2:
            raise ValueError(f"tolerance must be between 1e-13 and 1e-2, not {self.tolerance!r}")

    def truncation(self, box: Edges | None) -> Truncation:
        """Return cutoff and begin of the switch (nm) in a box, and no reaction field."""
        return *self.distances(box), 0.0

    def images(self, n: int, box: Edges | None) -> Images:
        """Return width, wave number (1/nm) and dielectric of the sum over the images of n dipoles."""
        cutoff, switch = self.distances(box)
        assert box is not None
        return *splitting(n, box, cutoff, switch, self.tolerance), _plain(self.dielectric)


Boundary: TypeAlias = Open | ReactionField | Ewald

#: The default.
OPEN = Open()


def checked(boundary: Boundary) -> Boundary:
    """Return a boundary; a ValueError if it is none."""
    if not isinstance(boundary, Open | ReactionField | Ewald):
        raise ValueError(f"boundary must be one of Open(), ReactionField(...) and Ewald(...), not {boundary!r}")
    return boundary


def edges_of(box: Sequence[float]) -> Edges:
    """Return the edges of a rectangular box (nm) as floats; a ValueError if these are not three positive numbers."""
    if unit.is_quantity(box) or np.shape(box) != (3,):
        raise ValueError(f"box must be three positive edges in nm without a unit, such as (3, 3, 3), not {box!r}")
    a, b, c = (checks.positive(edge, "each edge of the box", "nm") for edge in box)
    return a, b, c


def check_cutoff(cutoff: float, edges: Sequence[float]) -> None:
    """Raise a ValueError if a cutoff has more than one nearest image in a box of these edges (nm)."""
    shortest = min(edges)
    if not cutoff <= 0.5 * shortest * (1.0 + 1e-12):
        raise ValueError(f"cutoff must be at most half the box, {0.5 * shortest:g} nm, not {cutoff}")


def _plain(value: float) -> float:
    """Return a number of Python's: formulas and pickles show which of numpy's it was."""
    return value.item() if isinstance(value, np.generic) else value


def _check_switch(switch: float, cutoff: float) -> None:
    if not switch < cutoff:
        raise ValueError(f"switch must be between 0 and the cutoff {cutoff:g}, not {switch}")


def sharp_volume(cutoff: float, switch: float) -> float:
    """Return 3 integral S(r) r² dr, the cube of the radius of a sharp sphere with the volume of the switched one."""
    x, weights = np.polynomial.legendre.leggauss(15)  # exact: a polynomial of degree 28
    r = switch + 0.5 * (cutoff - switch) * (1.0 + x)
    t = 2.0 * (cutoff**2 - r**2) / (cutoff**2 - switch**2) - 1.0
    S = 0.5 + np.polynomial.polynomial.polyval(t**2, [3003, -6006, 9009, -8580, 5005, -1638, 231]) * t / 2048.0
    return switch**3 + 1.5 * (cutoff - switch) * float(weights @ (S * r**2))
