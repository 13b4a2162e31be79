"""Soft dipoles as formulas for OpenMM: a bond for each pair, or donors and acceptors within a cutoff.

The formula of a bond needs the vector between two nearest images, but OpenMM's formulas contain neither the box nor a
periodic vector. They contain the distance of the nearest images of two points. Along an axis, a point at a, with a
between half an edge and an edge, is at a distance of edge - a from the image of the origin. The formula measures the
edges of the present box in this way, by means of two such points for each edge. A third distance, which depends on all
edges, shows whether the measurement holds. It fails in triclinic boxes and in boxes that are much smaller or larger
than the box for which the formula was written.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence

import openmm

from openmm_exactrb.context.dipole_boxes import EDGES, ROUNDOFF, SHORTEST, WRITTEN_FOR
from openmm_exactrb.potentials.boundaries import Truncation
from openmm_exactrb.potentials.spheres import SphereCutoff

# Two points along an axis, in units of an edge of the box for which a formula is written, measure edges from _NEAR to
# 2 _NEAR and from _FAR to 2 _FAR. The second point is used if the image of the origin nearest to the first one is
# farther away than _CHANGE times the first one, and results are used only in the range of `EDGES`.
_NEAR, _FAR, _CHANGE = 0.6, 1.08, 0.9
# A point at this part of the edges is nearest to the opposite corner. Its distance to this corner confirms the edges to
# within _SAME times the diagonal.
_PART, _SAME = 0.51, 1e-5


def soft_dipole_bonds(
    arrows: Sequence[tuple[int, int]],
    parameters: Mapping[str, float],
    truncation: Truncation | None,
    spheres: SphereCutoff | None,
    *,
    wca: bool,
) -> openmm.CustomCompoundBondForce:
    """Return the potential of `soft_dipole_force` as a force with a bond for each pair.

    With a truncation of the dipoles (cutoff and switch in nm, strength of the reaction field in 1/nm³) and of the
    spheres, the Context parameters include the shortest edge, and the edges of the box for which the formula is
    written. The energy is nan in a box for which `DipoleBoxes` raises an error. In OpenMM, a formula with products of
    coordinates, one reciprocal and one square root is three times as fast as the same energy in terms of `distance` or
    powers of r.
    """
    energy = _energy(_core(attracts="soft_attraction" in parameters, wca=wca), truncation, spheres)
    if truncation is None or spheres is None:
        images = "r2 = x*x + y*y + z*z; x = x1 - x3; y = y1 - y3; z = z1 - z3;"
    else:
        energy, images = f"known*E; E = {energy}", f"r2 = r*r; r = distance(p1, p3); {_nearest_images()}"
    force = openmm.CustomCompoundBondForce(
        4,
        f"{energy}"
        "uv = ux*vx + uy*vy + uz*vz; ur = ux*x + uy*y + uz*z; vr = vx*x + vy*y + vz*z;"
        "i3 = i*sqrt(i); i = 1/r2;"
        f"{images}"
        "ux = x2 - x1; uy = y2 - y1; uz = z2 - z1;"
        "vx = x4 - x3; vy = y4 - y3; vz = z4 - z3",
    )
    for (centre1, tip1), (centre2, tip2) in itertools.combinations(arrows, 2):
        force.addBond([centre1, tip1, centre2, tip2], [])
    for name, value in parameters.items():
        force.addGlobalParameter(name, value)
    return force


def soft_dipole_hbonds(
    arrows: Sequence[tuple[int, int]],
    parameters: Mapping[str, float],
    truncation: Truncation,
    spheres: SphereCutoff,
    *,
    wca: bool,
) -> openmm.CustomHbondForce:
    """Return the potential of `soft_dipole_force` with each arrow as donor and acceptor, without a list of pairs.

    Each pair is evaluated twice, with half its energy. OpenMM provides distances between nearest images of donors and
    acceptors, from which the products of u, v and r follow by the law of cosines.
    """
    force = openmm.CustomHbondForce(
        f"0.5*E; E = {_energy(_core(attracts='soft_attraction' in parameters, wca=wca), truncation, spheres)}"
        "uv = 0.5*(p2 + q2 - r2 - t2); ur = 0.5*(q2 - r2 - distance(d1, d2)^2);"
        "vr = 0.5*(r2 + distance(a1, a2)^2 - p2);"
        "q2 = distance(d2, a1)^2; p2 = distance(d1, a2)^2; t2 = distance(d2, a2)^2;"
        "i3 = i/r; i = 1/r2; r2 = r*r; r = distance(d1, a1)",
    )
    add_hbonds(force, arrows, parameters, max(truncation[0], spheres.cutoff))
    return force


def soft_rod_energy(
    truncation: Truncation, spheres: SphereCutoff, coupling: float, length: float, *, attracts: bool, wca: bool
) -> str:
    """Return the energy of two dipolar spheres minus the Coulomb energy of their rods; donors are (centre, plus).

    u and v are the vectors of the rods. The minus ends are computed from the length of the rods, because PoCL crashes
    with three particles per donor. The nearest images of centres and of ends can differ only beyond the cutoff of the
    dipoles.
    """
    rods = "- dipole_coupling*((uv + 2*vr)/(pp*pm*(pp + pm)) + (uv - 2*vr)/(mm*mp*(mm + mp)))"
    return (
        f"0.5*E; E = {_energy(_core(attracts=attracts, wca=wca), truncation, spheres, rods)}"
        f"dipole_coupling = {coupling!r};"
        "pp = sqrt(A + ur - vr - 0.5*uv); mm = sqrt(A - ur + vr - 0.5*uv);"
        "pm = sqrt(A + ur + vr + 0.5*uv); mp = sqrt(A - ur - vr + 0.5*uv); A = r2 + 2*h2;"
        f"uv = 2*(p2 + q2 - r2 - t2); ur = q2 - r2 - h2; vr = r2 + h2 - p2; h2 = {0.25 * length**2!r};"
        "q2 = distance(d2, a1)^2; p2 = distance(d1, a2)^2; t2 = distance(d2, a2)^2;"
        "i3 = i/r; i = 1/r2; r2 = r*r; r = distance(d1, a1)"
    )


def add_hbonds(
    force: openmm.CustomHbondForce,
    pairs: Iterable[tuple[int, int]],
    parameters: Mapping[str, float],
    cutoff: float,
) -> None:
    """Add each pair as a donor and as an acceptor that do not interact; the cutoff (nm) is for first particles."""
    for name, value in parameters.items():
        force.addGlobalParameter(name, value)
    for i, (first, second) in enumerate(pairs):
        force.addDonor(first, second, -1)
        force.addAcceptor(first, second, -1)
        force.addExclusion(i, i)
    force.setNonbondedMethod(force.CutoffPeriodic)
    force.setCutoffDistance(cutoff)


def _core(*, attracts: bool, wca: bool) -> str:
    """Return the formula of the energy of two spheres, in which i is 1/r²."""
    core = "soft_repulsion*i^6 - soft_attraction*i^3" if attracts else "soft_repulsion*i^6"
    if wca:
        core = f"step(2*soft_repulsion*i^3 - soft_attraction)*({core} + soft_attraction^2/(4*soft_repulsion))"
    return core


def _energy(core: str, truncation: Truncation | None, spheres: SphereCutoff | None, more: str = "") -> str:
    """Return the formula of the energy of a pair: spheres, dipoles and `more`, each times a switch if truncated."""
    if truncation is None or spheres is None:
        return f"{core} + dipole_coupling*i3*(uv - 3*i*ur*vr);"
    cutoff, switch, reaction = truncation
    shift = f" - ({_core(attracts='soft_attraction' in core, wca=False)})" if spheres.shifted else ""
    shift = shift.replace("i^6", repr(spheres.cutoff**-12)).replace("i^3", repr(spheres.cutoff**-6))
    return (
        f"T*({core}{shift}) + S*(dipole_coupling*((i3 - {reaction!r})*uv - 3*i*i3*ur*vr){more});"
        f"{_switch('S', cutoff, switch)}{_switch('T', spheres.cutoff, spheres.switch)}"
    )


def _switch(S: str, cutoff: float, switch: float) -> str:
    """Return the formula of a switch S as a function of r²."""
    u = f"u{S}"
    return (
        f"{S} = 0.5 + t{S}*(3003 - 6006*{u} + 9009*{u}^2 - 8580*{u}^3 + 5005*{u}^4 - 1638*{u}^5 + 231*{u}^6)/2048;"
        f"u{S} = t{S}*t{S}; t{S} = 2*s{S} - 1;"
        f"s{S} = min(1, max(0, ({cutoff**2!r} - r2)/{cutoff**2 - switch**2!r}));"
    )


def _nearest_images() -> str:
    """Return the formula of the vector from the second centre to the nearest image of the first.

    The formula also defines `known`, which is 1, or nan if the edges of the present box are not known.
    """
    axes = ("x", "y", "z")
    vector = "".join(f"{x} = d{x} - edge_{x}*floor(d{x}/edge_{x} + 0.5); d{x} = {x}1 - {x}3;" for x in axes)
    edges = [f"edge_{x}" for x in axes]
    in_range = [
        f"step({x} - {EDGES[0]}*{a})*step({EDGES[1]}*{a} - {x})*step({x} - {1.0 - ROUNDOFF!r}*{SHORTEST})"
        for x, a in zip(edges, WRITTEN_FOR, strict=True)
    ]
    corner = ",".join(f"{_PART}*{x}" for x in edges)
    return (
        f"{vector}known = sqrt(2*same*{'*'.join(in_range)} - 1);"
        f"same = step({_SAME}*diagonal - abs(pointdistance({corner},0,0,0) - {1.0 - _PART}*diagonal));"
        f"diagonal = sqrt({' + '.join(f'{x}*{x}' for x in edges)});{''.join(map(_edge, axes))}"
    )


def _edge(x: str) -> str:
    """Return the formula of an edge of the present box."""

    def to_image(a: str) -> str:
        return f"pointdistance({','.join(a if axis == x else '0' for axis in 'xyz')},0,0,0)"

    return (
        f"edge_{x} = select(step(from_near_{x} - {_CHANGE}*near_{x}), far_{x} + {to_image(f'far_{x}')},"
        f"near_{x} + from_near_{x}); from_near_{x} = {to_image(f'near_{x}')};"
        f"near_{x} = {_NEAR}*box_{x}; far_{x} = {_FAR}*box_{x};"
    )
