// Columns of the tables of flexible molecules.

// The columns of the table of moves.
enum { OP, NUMBER_OF_MOVE, FIRST_NUMBER, NUMBERS_OF_MOVE, MOVE_ROW };
// Indices of the friction factor of translation among the numbers of a heat exchange, for isolated bodies and for
// bodies in flexible molecules. The amplitude of the noise follows each factor.
enum { FADE = 1, FADE_OF_FLEXIBLE = 5 };
// The position of an atom at the last heat exchange, its velocities before and after this exchange, and its velocity before
// successive exchanges.
enum { AT_EXCHANGE, BEFORE_EXCHANGE, AFTER_EXCHANGE, BEFORE_EXCHANGES };
#define EXCHANGED(which, atom) (exchanged+3*((which)*ALL_ATOMS+(atom)))

enum { FIRST_CLUSTER, CLUSTERS, FIRST_PLACE, PLACES, OWN, FIRST_TERMS, BLOCK_ROW = FIRST_TERMS+12 };
typedef struct { int first, last, count; } Terms; // first term of a thread, end of its block, terms of all blocks
// Columns of the table of custom forces, and of the steps that compute the derivatives of their energies: the kind of a
// step, and up to three arguments. See openmm_exactrb.engines.native.flexible.expressions.
enum { ATOMS_OF_TERM, TERMS_OF_CUSTOM, FIRST_MEMBER, FIRST_OF_NUMBERS, FIRST_STEP, STEPS, CUSTOM_ROW };
enum { STEP_ROW = 4 };
enum { FIRST_ATOM, ATOMS_OF_CLUSTER, GRAPH, ROOM, CLUSTER_ROW };
// The numbers at the start of the table of a graph; see openmm_exactrb.constraints.tables.
enum { CONSTRAINTS, ENTRIES, PRODUCTS, STRIDE, FIRST_LENGTH, GRAPH_HEAD };
