"""The names that the program, the gather forces and what loads them share. They are the format of XML and checkpoints.

Every particle carries a replica of its body, so that nothing is looked up across particles.
"""

from __future__ import annotations

#: Per-DOF variables: the state of the body. Centre, momentum, angular momentum in the body, attitude (vector part, and
#: the scalar part three times), the place of the particle about the centre, and what x differs by from centre + place:
#: vectors of the lattice by which OpenMM wrapped the molecule, and what a barostat moved it.
STATE = ("R", "P", "L", "q", "w", "d", "image")
#: Constants of a body: the particle's place in its principal axes; (b, rho, sigma) of the rotor; 1/I3, 1/M and
#: 1/number of particles; the axes about which it can turn; 1 where there is no other particle, else 0.
CONSTANTS = ("s", "abc", "inverse", "axes", "alone")
#: Force and torque in space, as long as they are known.
FORCES = ("F", "N")
#: For what is soon forgotten.
TEMPORARY = ("a", "g", "y", "c", "p", "u", "n", "tv", "tw")

_PREFIX = "exactrb_"
#: 1 once bodies are loaded: before that, steps make positions nan.
LOADED = f"{_PREFIX}loaded"
#: 1 where a System has virtual sites; a barostat; something that changes velocities.
SITES, BAROSTAT, PUSHED = (f"{_PREFIX}{name}" for name in ("sites", "barostat", "pushed"))
#: Rotations that a drift is made of.
TURNS = f"{_PREFIX}turns"
#: Whether a step of a processed scheme prepares the state and finishes it.
ENTER, LEAVE = f"{_PREFIX}enter", f"{_PREFIX}leave"
#: Whether the forces of the present places are known.
KNOWN = f"{_PREFIX}known"
#: Whether the step is to measure how fast bodies turn, and the answer.
ASKED, FASTEST = f"{_PREFIX}asked", f"{_PREFIX}fastest"
#: The place in the word, counted in rotations and in stages; the times of kick and drift there; whether forces are
#: needed; particles that a barostat moved.
INDEX, STAGE, KICK_TIME, TIME = (f"{_PREFIX}{name}" for name in ("index", "stage", "kick_time", "time"))
NEEDED, MOVED = f"{_PREFIX}needed", f"{_PREFIX}moved"
#: The word: tables of the parts of kicks and of drifts.
KICKS, DRIFTS = f"{_PREFIX}kicks", f"{_PREFIX}drifts"
#: The force group that they have to themselves.
GROUP = 31
#: The bits of all other groups.
OTHERS = ~(1 << GROUP) & 0xFFFFFFFF
#: b norm(L) of the fastest body comes from a sum of powers, which is never below it.
POWER = 64
