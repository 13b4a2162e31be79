// Columns of the tables of flexible molecules, and what their numbers are: `fine` is float or double.
typedef FINE fine;
#define FIXED_POINT 4294967296.0
#define LARGEST_FORCE 1e9f
#define NOT_A_NUMBER (0.0/0.0)

// Moves, as openmm_exactrb.moves has them, and the columns of their table.
enum { DRIFT = 0, KICK = 1, EXCHANGE = 2, LAST_KICK = 3, REMEMBER = 4, FAST_KICK = 7 };
enum { OP, NUMBER_OF_MOVE, FIRST_NUMBER, NUMBERS_OF_MOVE, MOVE_ROW };
// Of a heat exchange: where friction and noise of translation are, of ordinary bodies and of those in flexible molecules.
enum { FADE = 1, FADE_OF_FLEXIBLE = 5 };
// What a launch does besides, as bits.
enum { MOVES_ATOMS = 1, PLACES_ATOMS = 2, PROJECTS = 4, SHOWS_VELOCITIES = 8 };

enum { FIRST_CLUSTER, CLUSTERS, FIRST_PLACE, PLACES, OWN, FIRST_TERMS, BLOCK_ROW = FIRST_TERMS+12 };
enum { FIRST_ATOM, ATOMS_OF_CLUSTER, GRAPH, FIRST_CONSTRAINT, CONSTRAINTS_OF_CLUSTER, CLUSTER_ROW };
