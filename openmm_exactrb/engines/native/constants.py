"""Bits and kinds in the arguments of kernels; names in capitals are also macros of the kernel texts."""

#: The properties of a segment of rigid bodies.
HAS_FORCES, MOVES_PARTICLES, SHOWS_VELOCITIES, IS_DISPLACED = 1, 2, 4, 8
#: The actions of a launch for flexible molecules in addition to its moves.
MOVES_ATOMS, PLACES_ATOMS, PROJECTS, SHOWS_ATOMS = 1, 2, 4, 8
#: The kinds of the steps that compute the derivative of a custom energy.
COORDINATE, NUMBER_OF_TERM, PARAMETER, CONSTANT, FIRST_OPERATION = range(5)
