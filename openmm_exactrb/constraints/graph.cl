// Free motion of a cluster with any constraint graph, by the series of openmm_exactrb.constraints.geodesics and the
// sparse Cholesky factor of openmm_exactrb.constraints.elimination. One thread moves a cluster. All clusters with the same
// graph share its tables. On devices, the workspace of a cluster is in global memory, in which the values of one quantity
// for all clusters with the same graph are contiguous.

// The atoms of a cluster, its graph (openmm_exactrb.constraints.elimination.Graph), and its workspace.
typedef struct {
    int atoms, constraints, entries, stride;
    GLOBAL const int *ends, *rows, *columns, *starts, *left, *right;
    GLOBAL const double *inverse, *lengths, *weights;
    GLOBAL double* room;
} Graph;

#define EACH_CONSTRAINT for (int c = 0; c < g->constraints; c++)
#define EACH_ATOM for (int i = 0; i < g->atoms; i++)
#define FIRST(c) g->ends[2*(c)]
#define SECOND(c) g->ends[2*(c)+1]
#define DIAGONAL(c) (g->rows[(c)+1]-1)

// Quantities in the workspace: the series of the vector of each constraint and of its multiplier, the entries of the
// factor, the right-hand side of a linear system, vectors for each constraint, and a sum for each atom.
#define PART(place) g->room[(place)*g->stride]
#define R(k, c, e) PART(3*((k)*g->constraints+(c))+(e))
#define MULTIPLIER(k, c) PART((3*(GRAPH_ORDERS+2)+(k))*g->constraints+(c))
#define B(c) PART((4*GRAPH_ORDERS+6)*g->constraints+(c))
#define VECTOR(which, c, e) PART((4*GRAPH_ORDERS+7+3*(which))*g->constraints+3*(c)+(e))
#define FACTOR(e) PART((4*GRAPH_ORDERS+16)*g->constraints+(e))
#define ON_ATOM(i, e) PART((4*GRAPH_ORDERS+16)*g->constraints+g->entries+3*(i)+(e))
enum { FORCE, PUSH, SHIFT };

#define PRODUCT(c, d) (R(0, c, 0)*R(0, d, 0)+R(0, c, 1)*R(0, d, 1)+R(0, c, 2)*R(0, d, 2))
#define RELATIVE(c, e) (g->inverse[FIRST(c)]*ON_ATOM(FIRST(c), e)-g->inverse[SECOND(c)]*ON_ATOM(SECOND(c), e))
#define LARGER(a, b) ((b) > (a) ? (b) : (a))
#define X(i, e) xs[3*(at+(i))+(e)]
#define V(i, e) v[3*(first+(i))+(e)]

DEVICE inline Graph graph_of(GLOBAL const int* cluster, GLOBAL const int* graphs, GLOBAL const double* inverse, GLOBAL const double* lengths,
        GLOBAL double* room) {
    GLOBAL const int* head = graphs+cluster[GRAPH];
    Graph g;
    g.atoms = cluster[ATOMS_OF_CLUSTER];
    g.constraints = head[CONSTRAINTS];
    g.entries = head[ENTRIES];
    g.stride = head[STRIDE];
    g.ends = head+GRAPH_HEAD;
    g.rows = g.ends+2*g.constraints;
    g.columns = g.rows+g.constraints+1;
    g.starts = g.columns+g.entries;
    g.left = g.starts+g.entries+1;
    g.right = g.left+head[PRODUCTS];
    g.inverse = inverse+cluster[FIRST_ATOM];
    g.lengths = lengths+head[FIRST_LENGTH];
    g.weights = g.lengths+g.constraints;
    g.room = WORKSPACE(room, cluster[ROOM], (4*GRAPH_ORDERS+16)*g.constraints+g.entries+3*g.atoms);
    return g;
}

// Compute the Cholesky factor of the matrix of the constraints, with inverted diagonal entries.
DEVICE inline void factorise(const Graph* g) {
    EACH_CONSTRAINT for (int e = g->rows[c]; e <= DIAGONAL(c); e++) {
        const int d = g->columns[e];
        double entry = g->weights[e]*PRODUCT(c, d);
        for (int k = g->starts[e]; k < g->starts[e+1]; k++)
            entry -= FACTOR(g->left[k])*FACTOR(g->right[k]);
        FACTOR(e) = d == c ? 1.0/sqrt(entry) : entry*FACTOR(DIAGONAL(d));
    }
}

// Solve the linear system with the triangular factor for the right-hand side B, in place.
DEVICE inline void solve_triangle(const Graph* g) {
    EACH_CONSTRAINT {
        double b = B(c);
        for (int e = g->rows[c]; e < DIAGONAL(c); e++)
            b -= FACTOR(e)*B(g->columns[e]);
        B(c) = b*FACTOR(DIAGONAL(c));
    }
}

// Solve the linear system for the right-hand side B, in place.
DEVICE inline void solve(const Graph* g) {
    solve_triangle(g);
    for (int c = g->constraints-1; c >= 0; c--) {
        const double b = B(c)*FACTOR(DIAGONAL(c));
        B(c) = b;
        for (int e = g->rows[c]; e < DIAGONAL(c); e++)
            B(g->columns[e]) -= FACTOR(e)*b;
    }
}

// Return the kinetic energy of velocities along the constraints, which a projection removes. `v` begins with the first atom.
DEVICE inline double along_graph(const Graph* g, GLOBAL const double* v) {
    double energy = 0.0;
    EACH_CONSTRAINT {
        double b = 0.0;
        EACH_AXIS b -= R(0, c, e)*(v[3*FIRST(c)+e]-v[3*SECOND(c)+e]);
        B(c) = b;
    }
    solve_triangle(g);
    EACH_CONSTRAINT energy += 0.5*B(c)*B(c);
    return energy;
}

// Compute the signed sum of a vector over the constraints of each atom.
DEVICE inline void gather(const Graph* g, int which) {
    EACH_ATOM EACH_AXIS ON_ATOM(i, e) = 0.0;
    EACH_CONSTRAINT EACH_AXIS {
        ON_ATOM(FIRST(c), e) += VECTOR(which, c, e);
        ON_ATOM(SECOND(c), e) -= VECTOR(which, c, e);
    }
}

// Correct the changes of the momenta, in ON_ATOM, so that rounding does not change the kinetic energy; see
// openmm_exactrb.constraints.geodesics. `v` begins with the first atom.
DEVICE inline void keep_energy_of_graph(const Graph* g, GLOBAL const number* v) {
    double mass = 0.0, centre[3] = {0.0, 0.0, 0.0}, gained = 0.0, energy = 0.0;
    EACH_ATOM {
        mass += 1.0/g->inverse[i];
        EACH_AXIS centre[e] += v[3*i+e]/g->inverse[i];
    }
    EACH_AXIS centre[e] /= mass;
    EACH_ATOM EACH_AXIS {
        const double before = v[3*i+e]-centre[e], after = before+g->inverse[i]*ON_ATOM(i, e);
        gained += ON_ATOM(i, e)*(before+after);
        energy += after*after/g->inverse[i];
    }
    const double excess = energy > 0.0 ? 0.5*gained/energy : 0.0;
    EACH_ATOM EACH_AXIS ON_ATOM(i, e) -= excess*((v[3*i+e]-centre[e])/g->inverse[i]+ON_ATOM(i, e));
}

// Advance a cluster by t (ps). For t = 0, only project the velocities, which removes components along constraints. The
// first atom has the index `at` in the block. If a heat exchange at these positions `relaxes` velocities, its heat is
// corrected for the constraints.
DEVICE inline void move_graph(double t, GLOBAL const int* cluster, int at, GLOBAL const int* graphs, GLOBAL const double* inverse,
        GLOBAL const double* lengths, GLOBAL double* room, bool relaxes, GLOBAL const double* before, GLOBAL const double* after, GLOBAL double* heat,
        LOCAL_ARG number* xs, GLOBAL number* v) {
    const Graph own = graph_of(cluster, graphs, inverse, lengths, room), *g = &own;
    const int first = cluster[FIRST_ATOM];
    double part = 1.0, remaining = 1.0;
    while (remaining > 0.0) {
        double rest[3];
        EACH_CONSTRAINT EACH_AXIS R(0, c, e) = apart(X(FIRST(c), e), X(SECOND(c), e), rest+e);
        factorise(g);
        if (relaxes)
            heat[first] -= along_graph(g, after+3*first)-along_graph(g, before+3*first);
        relaxes = false;
        EACH_CONSTRAINT {
            double b = 0.0;
            EACH_AXIS b -= R(0, c, e)*(V(FIRST(c), e)-V(SECOND(c), e));
            B(c) = b;
        }
        solve(g);
        EACH_CONSTRAINT EACH_AXIS {
            V(FIRST(c), e) += g->inverse[FIRST(c)]*B(c)*R(0, c, e);
            V(SECOND(c), e) -= g->inverse[SECOND(c)]*B(c)*R(0, c, e);
        }
        if (t == 0.0)
            return;

        // Correct the rounding errors of the lengths, then compute the series.
        const double time = part*t;
        double bound = 0.0;
        EACH_CONSTRAINT {
            double r[3];
            EACH_AXIS r[e] = apart(X(FIRST(c), e), X(SECOND(c), e), rest+e);
            B(c) = half_defect(g->lengths[c], r, rest);
        }
        solve(g);
        EACH_CONSTRAINT EACH_AXIS {
            VECTOR(SHIFT, c, e) = B(c)*R(0, c, e);
            VECTOR(PUSH, c, e) = 0.0;
            R(1, c, e) = time*(V(FIRST(c), e)-V(SECOND(c), e));
            bound = LARGER(bound, SETTLED*fabs(R(1, c, e)));
        }
        int small = 0;
        for (int k = 0; k < GRAPH_ORDERS && small < 2; k++) {
            const double order = (k+1)*(k+2), over_order = 1.0/order, of_push = 1.0/(time*(k+1));
            EACH_CONSTRAINT {
                double q = 0.0;
                for (int j = 1; j < (k+3)/2; j++)
                    EACH_AXIS q += R(j, c, e)*R(k+2-j, c, e);
                if (k%2 == 0)
                    EACH_AXIS q += 0.5*R(k/2+1, c, e)*R(k/2+1, c, e);
                B(c) = -order*q;
                double force[3] = {0.0, 0.0, 0.0};
                for (int j = 0; j < k; j++)
                    EACH_AXIS force[e] += MULTIPLIER(j, c)*R(k-j, c, e);
                EACH_AXIS VECTOR(FORCE, c, e) = force[e];
            }
            gather(g, FORCE);
            EACH_CONSTRAINT B(c) -= R(0, c, 0)*RELATIVE(c, 0)+R(0, c, 1)*RELATIVE(c, 1)+R(0, c, 2)*RELATIVE(c, 2);
            solve(g);
            EACH_CONSTRAINT {
                MULTIPLIER(k, c) = B(c);
                EACH_AXIS VECTOR(FORCE, c, e) += B(c)*R(0, c, e);
            }
            gather(g, FORCE);
            double largest = 0.0;
            EACH_CONSTRAINT EACH_AXIS {
                R(k+2, c, e) = RELATIVE(c, e)*over_order;
                largest = LARGER(largest, (k+2)*fabs(R(k+2, c, e)));
                VECTOR(PUSH, c, e) += VECTOR(FORCE, c, e)*of_push;
                VECTOR(SHIFT, c, e) += VECTOR(FORCE, c, e)*over_order;
            }
            small = largest <= bound ? small+1 : 0;
        }
        if (small == 2) {
            gather(g, SHIFT);
            EACH_ATOM EACH_AXIS X(i, e) += time*V(i, e)+g->inverse[i]*ON_ATOM(i, e);
            gather(g, PUSH);
            if (LOW_PARTS)
                keep_energy_of_graph(g, v+3*first);
            EACH_ATOM EACH_AXIS V(i, e) += g->inverse[i]*ON_ATOM(i, e);
            remaining -= part;
        }
        else if (part > SHORTEST)
            part *= 0.5;
        else { // the divergence check detects these values
            EACH_ATOM EACH_AXIS X(i, e) = V(i, e) = NOT_A_NUMBER;
            return;
        }
    }
}

#undef EACH_CONSTRAINT
#undef EACH_ATOM
#undef FIRST
#undef SECOND
#undef DIAGONAL
#undef PART
#undef R
#undef MULTIPLIER
#undef B
#undef VECTOR
#undef FACTOR
#undef ON_ATOM
#undef PRODUCT
#undef RELATIVE
#undef LARGER
#undef X
#undef V
