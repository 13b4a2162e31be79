// A cluster of any graph, in global memory: numbers of one kind of all clusters stand beside each other.
#define PART(place) room[(place)*GRAPHS+graph]
#define MOST MOST_CONSTRAINTS
#define MOVE move_graph
#define ARGUMENTS , GLOBAL const int* cluster, int at, GLOBAL const double* inverse, GLOBAL const double* lengths, GLOBAL const int* ends, \
    GLOBAL double* room, LOCAL_ARG double* xs, GLOBAL double* v
#define ATOMS cluster[ATOMS_OF_CLUSTER]
#define CONSTRAINTS cluster[CONSTRAINTS_OF_CLUSTER]
#define FIRST(c) ends[2*(first+(c))]
#define SECOND(c) ends[2*(first+(c))+1]
#define LENGTH(c) lengths[ALL_ATOMS+first+(c)]
#define INVERSE(i) inverse[cluster[FIRST_ATOM]+(i)]
#define X(i, e) xs[3*(at+(i))+(e)]
#define V(i, e) v[3*(cluster[FIRST_ATOM]+(i))+(e)]
#define WORKSPACE const int first = cluster[FIRST_CONSTRAINT], graph = cluster[GRAPH];
#define R(k, c, e) PART(((k)*MOST+(c))*3+(e))
#define MULTIPLIER(k, c) PART(3*(ORDERS+2)*MOST+(k)*MOST+(c))
#define FACTOR(c, d) PART((4*ORDERS+6)*MOST+(c)*MOST+(d))
#define AFTER_FACTOR ((4*ORDERS+6+MOST)*MOST)
#define B(c) PART(AFTER_FACTOR+(c))
#define SUM(c, e) PART(AFTER_FACTOR+MOST+3*(c)+(e))
#define PUSH(c, e) PART(AFTER_FACTOR+4*MOST+3*(c)+(e))
#define SHIFT(c, e) PART(AFTER_FACTOR+7*MOST+3*(c)+(e))
#define ON_ATOM(i, e) PART(AFTER_FACTOR+10*MOST+3*(i)+(e))
