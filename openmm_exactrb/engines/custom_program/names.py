"""The names that the program, the gather forces and what loads them share. They are the format of XML and checkpoints.

Every particle carries a copy of its body, so that nothing is looked up across particles.
"""

from __future__ import annotations

from openmm_exactrb.context import variables

#: Per-DOF variables: the state of the body. Centre, momentum, angular momentum in the body, attitude (vector part, and
#: the scalar part three times), the place of the particle about the centre, and what x differs by from centre + place:
#: vectors of the lattice by which OpenMM wrapped the molecule, and what a barostat moved it.
STATE = ("R", "P", "L", "q", "w", "d", "image")
#: Constants of a body: the particle's place in its principal axes; (b, rho, sigma) of the rotor; 1/I3, 1/M and
#: 1/number of particles; (1 where it can turn about its first axis, 1 where there is no other particle, see `SPAN`).
CONSTANTS = ("s", "abc", "inverse", "shape")
#: Force and torque in space, as long as they are known.
FORCES = ("F", "N")
#: The turn of the loop, and the first and the last one of a step; the last number of "shape" is one over the rotations
#: that a drift is made of. What the device knows of itself it need not be sent.
SPAN = "at"
#: Where OpenMM's constraints close drifts: the time of one whose end is in x alone; and 1 where they hold the particle.
PENDING, CLUSTERED = "tau", "clustered"
#: For what is soon forgotten; velocities are one more, until they are shown.
TEMPORARY = ("a", "g", "y", "c", "p", "n")
#: Where forces are taken at displaced places: the attitude that is not, and how far the centre is displaced.
DISPLACED = ("sq", "sw", "move")
#: The inner state of a processed scheme while the output is shown: R, P, L, q, w and d; and how far x is then from
#: R + d + image, until a row has placed it.
INNER, LAG = ("iR", "iP", "iL", "iq", "iw", "id"), "lag"
#: Of a thermostat: (friction, that of rotation, kT), the states of the generators of random numbers, and 1 in molecules
#: of more than one body, if these have frictions of their own.
THERMOSTAT, STREAMS, FLEXIBLE = "thermostat", ("r1", "r2", "r3", "r4"), "flexible"

_PREFIX = "exactrb_"
#: How the names of the forces begin that are remembered, see `last`.
LAST_FORCES = "last_"
#: `HELD` once bodies are loaded: before that, steps make positions nan. It is the first variable, as that of
#: `openmm_exactrb.context.variables` is: a checkpoint of the other engine has a value there that this one never writes.
LOADED, HELD = f"{_PREFIX}loaded", variables.FROM_DEVICE
#: 1 where a System has virtual sites; a barostat; what removes the motion of the centre of mass, 2 for a thermostat.
SITES, BAROSTAT, PUSHED = (f"{_PREFIX}{name}" for name in ("sites", "barostat", "pushed"))
#: Rotations that a drift is made of, and one over them; the first and the last turn of the loop in a step; 1 where the
#: device does not know these numbers yet, or those of a thermostat.
TURNS, PACE, FIRST, LAST, CHANGED = (f"{_PREFIX}{name}" for name in ("turns", "pace", "first", "last", "changed"))
#: kT (kJ/mol) of a thermostat, the seed that its generators have, and 1 once `FLEXIBLE` is loaded.
KT, SEEDED, FLAGGED = (f"{_PREFIX}{name}" for name in ("kT", "seeded", "flagged"))
#: The frictions (1/ps) of translation and of rotation.
FRICTIONS = f"{_PREFIX}friction", f"{_PREFIX}rotational_friction"
#: The same in molecules of more than one body.
FLEXIBLE_FRICTIONS = f"{_PREFIX}flexible_friction", f"{_PREFIX}flexible_rotational_friction"
#: Whether the forces of the present places are known, and how often they were evaluated.
KNOWN, EVALUATED = f"{_PREFIX}known", f"{_PREFIX}evaluated"
#: 1 where a pass begins with keeping the inner state, or with returning to it.
KEEP, RETURN = f"{_PREFIX}keep", f"{_PREFIX}return"
#: Whether the step is to measure how fast bodies turn, and the answer.
ASKED, FASTEST = f"{_PREFIX}asked", f"{_PREFIX}fastest"
#: The turn of the loop and its row in the table; whether forces are needed; whether places are displaced behind this
#: turn, and were behind the last one; particles that a barostat moved.
INDEX, ROW, NEEDED, SHIFTED, WAS, MOVED = (
    f"{_PREFIX}{name}" for name in ("index", "row", "needed", "shifted", "was", "moved")
)
#: Rotations that were made of a drift of rigid bodies.
TURN = f"{_PREFIX}turn"
#: Three tables whose sum is the table of rows, since devices keep tables in single precision.
TABLES = tuple(f"{_PREFIX}rows{i}" for i in range(3))
#: The force group that the sums over bodies have to themselves, unless forces of the System are in it.
GROUP = 31
#: b norm(L) of the fastest body comes from a sum of powers, which is never below it.
POWER = 64
#: Variables of OpenMM's own in a program.
OPENMM = ("x", "v", "f", "m", "dt", *(f"f{group}" for group in range(32)))


def last(k: int) -> tuple[str, str]:
    """Return the names of the k-th force and torque, in the body, that are remembered."""
    return f"{LAST_FORCES}F{k}", f"{LAST_FORCES}N{k}"


def has(name: str) -> bool:
    """Return whether the program of some scheme has a variable of this name."""
    of_step = (*STATE, *CONSTANTS, *FORCES, SPAN, *TEMPORARY, *DISPLACED, PENDING, CLUSTERED)
    vectors = (*of_step, *INNER, LAG, THERMOSTAT, *STREAMS, FLEXIBLE)
    return name in vectors or name.startswith((_PREFIX, LAST_FORCES))
