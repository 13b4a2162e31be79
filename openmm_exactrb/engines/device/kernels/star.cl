// A star of SIZE atoms, the first of which is held to all others, in private memory. Each time that this is read it is
// about stars of one more.
#if !defined(SIZE)
#define SIZE 2
#elif SIZE == 2
#undef SIZE
#define SIZE 3
#elif SIZE == 3
#undef SIZE
#define SIZE 4
#else
#undef SIZE
#define SIZE 5
#endif
#define PASTED(name, n) name##n
#define NAMED(name, n) PASTED(name, n)
#define MOVE NAMED(move_star_, SIZE)
#define ARGUMENTS , double (*x)[3], double (*v)[3], const double* w, const double* length
#define ATOMS SIZE
#define CONSTRAINTS (SIZE-1)
#define FIRST(c) 0
#define SECOND(c) ((c)+1)
#define LENGTH(c) length[(c)+1]
#define INVERSE(i) w[i]
#define X(i, e) x[i][e]
#define V(i, e) v[i][e]
#define WORKSPACE double r[ORDERS+2][SIZE-1][3], multiplier[ORDERS][SIZE-1], factor[SIZE-1][SIZE-1], b[SIZE-1]; \
    double sum[SIZE-1][3], push[SIZE-1][3], shift[SIZE-1][3], on_atom[SIZE][3];
#define R(k, c, e) r[k][c][e]
#define MULTIPLIER(k, c) multiplier[k][c]
#define FACTOR(c, d) factor[c][d]
#define B(c) b[c]
#define SUM(c, e) sum[c][e]
#define PUSH(c, e) push[c][e]
#define SHIFT(c, e) shift[c][e]
#define ON_ATOM(i, e) on_atom[i][e]
