"""The numbers of moves; names in capitals are also macros of the kernel texts."""

#: Free motion.
DRIFT = 0
#: A change of momenta by the present forces.
KICK = 1
#: A heat exchange with the numbers of the thermostat.
EXCHANGE = 2
#: A change of momenta by a weighted sum of stored forces.
LAST_KICK = 3
#: Storage of the present forces as the most recent forces.
REMEMBER = 4
#: A displacement of particles, not of bodies, by the present forces; the number is e of `GradientKick`.
DISPLACE = 5
#: A change of momenta by the forces on displaced particles; the numbers are tau and e.
DISPLACED_KICK = 6
#: A change of momenta of bodies with inner steps by the present fast forces.
FAST_KICK = 7
