// Free motion of a cluster with any constraint graph, by the series of openmm_exactrb.kernels.compiled.clusters. One
// thread moves a cluster, with a workspace in global memory in which the values of one quantity for all clusters are
// contiguous.

#define PART(place) room[(place)*GRAPHS+graph]
#define MOST MOST_CONSTRAINTS
#define ATOMS cluster[ATOMS_OF_CLUSTER]
#define CONSTRAINTS cluster[CONSTRAINTS_OF_CLUSTER]
#define FIRST(c) ends[2*(first+(c))]
#define SECOND(c) ends[2*(first+(c))+1]
#define LENGTH(c) lengths[ALL_ATOMS+first+(c)]
#define INVERSE(i) inverse[cluster[FIRST_ATOM]+(i)]
#define X(i, e) xs[3*(at+(i))+(e)]
#define V(i, e) v[3*(cluster[FIRST_ATOM]+(i))+(e)]
#define R(k, c, e) PART(((k)*MOST+(c))*3+(e))
#define MULTIPLIER(k, c) PART(3*(ORDERS+2)*MOST+(k)*MOST+(c))
#define FACTOR(c, d) PART((4*ORDERS+6)*MOST+(c)*MOST+(d))
#define AFTER_FACTOR ((4*ORDERS+6+MOST)*MOST)
#define B(c) PART(AFTER_FACTOR+(c))
#define SUM(c, e) PART(AFTER_FACTOR+MOST+3*(c)+(e))
#define PUSH(c, e) PART(AFTER_FACTOR+4*MOST+3*(c)+(e))
#define SHIFT(c, e) PART(AFTER_FACTOR+7*MOST+3*(c)+(e))
#define ON_ATOM(i, e) PART(AFTER_FACTOR+10*MOST+3*(i)+(e))

#define EACH_CONSTRAINT for (int c = 0; c < CONSTRAINTS; c++)
#define EACH_ATOM for (int i = 0; i < ATOMS; i++)
#define PRODUCT(c, d) (R(0, c, 0)*R(0, d, 0)+R(0, c, 1)*R(0, d, 1)+R(0, c, 2)*R(0, d, 2))
#define COUPLING(c, d) ((FIRST(c) == FIRST(d) ? INVERSE(FIRST(c)) : 0.0)+(SECOND(c) == SECOND(d) ? INVERSE(SECOND(c)) : 0.0) \
    -(FIRST(c) == SECOND(d) ? INVERSE(FIRST(c)) : 0.0)-(SECOND(c) == FIRST(d) ? INVERSE(SECOND(c)) : 0.0))

// Solve the linear system for the right-hand side B, in place, with the Cholesky factor of the matrix.
#define SOLVE \
    EACH_CONSTRAINT { \
        for (int d = 0; d < c; d++) \
            B(c) -= FACTOR(c, d)*B(d); \
        B(c) *= FACTOR(c, c); \
    } \
    for (int c = CONSTRAINTS-1; c >= 0; c--) { \
        B(c) *= FACTOR(c, c); \
        for (int d = 0; d < c; d++) \
            B(d) -= FACTOR(c, d)*B(c); \
    }

// Compute the signed sum of a vector over the constraints of each atom.
#define GATHER(VECTOR) \
    EACH_ATOM EACH_AXIS ON_ATOM(i, e) = 0.0; \
    EACH_CONSTRAINT EACH_AXIS { ON_ATOM(FIRST(c), e) += VECTOR(c, e); ON_ATOM(SECOND(c), e) -= VECTOR(c, e); }
#define RELATIVE(c, e) (INVERSE(FIRST(c))*ON_ATOM(FIRST(c), e)-INVERSE(SECOND(c))*ON_ATOM(SECOND(c), e))

// Advance a cluster by t (ps). For t = 0, only project the velocities, which removes components along constraints.
DEVICE inline void move_graph(double t, GLOBAL const int* cluster, int at, GLOBAL const double* inverse, GLOBAL const double* lengths,
        GLOBAL const int* ends, GLOBAL double* room, LOCAL_ARG number* xs, GLOBAL number* v) {
    const int first = cluster[FIRST_CONSTRAINT], graph = cluster[GRAPH];
    double part = 1.0, remaining = 1.0;
    while (remaining > 0.0) {
        EACH_CONSTRAINT EACH_AXIS R(0, c, e) = X(FIRST(c), e)-X(SECOND(c), e);
        EACH_CONSTRAINT for (int d = 0; d <= c; d++) {
            double entry = COUPLING(c, d)*PRODUCT(c, d);
            for (int k = 0; k < d; k++)
                entry -= FACTOR(c, k)*FACTOR(d, k);
            FACTOR(c, d) = d == c ? 1.0/sqrt(entry) : entry*FACTOR(d, d);
        }
        EACH_CONSTRAINT {
            B(c) = 0.0;
            EACH_AXIS B(c) -= R(0, c, e)*(V(FIRST(c), e)-V(SECOND(c), e));
        }
        SOLVE
        EACH_CONSTRAINT EACH_AXIS {
            V(FIRST(c), e) += INVERSE(FIRST(c))*B(c)*R(0, c, e);
            V(SECOND(c), e) -= INVERSE(SECOND(c))*B(c)*R(0, c, e);
        }
        if (t == 0.0)
            return;

        // Correct the rounding errors of the lengths, then compute the series.
        const double time = part*t;
        double bound = 0.0;
        EACH_CONSTRAINT B(c) = 0.5*(LENGTH(c)*LENGTH(c)-PRODUCT(c, c));
        SOLVE
        EACH_CONSTRAINT EACH_AXIS {
            SHIFT(c, e) = B(c)*R(0, c, e);
            PUSH(c, e) = 0.0;
            R(1, c, e) = time*(V(FIRST(c), e)-V(SECOND(c), e));
            bound = fmax(bound, SETTLED*fabs(R(1, c, e)));
        }
        int small = 0;
        for (int k = 0; k < ORDERS && small < 2; k++) {
            const double order = (k+1)*(k+2);
            EACH_CONSTRAINT {
                double q = 0.0;
                for (int j = 1; j < (k+3)/2; j++)
                    EACH_AXIS q += R(j, c, e)*R(k+2-j, c, e);
                if (k%2 == 0)
                    EACH_AXIS q += 0.5*R(k/2+1, c, e)*R(k/2+1, c, e);
                B(c) = -order*q;
                EACH_AXIS SUM(c, e) = 0.0;
                for (int j = 0; j < k; j++)
                    EACH_AXIS SUM(c, e) += MULTIPLIER(j, c)*R(k-j, c, e);
            }
            GATHER(SUM)
            EACH_CONSTRAINT EACH_AXIS B(c) -= R(0, c, e)*RELATIVE(c, e);
            SOLVE
            EACH_CONSTRAINT {
                MULTIPLIER(k, c) = B(c);
                EACH_AXIS SUM(c, e) += B(c)*R(0, c, e);
            }
            GATHER(SUM)
            double largest = 0.0;
            EACH_CONSTRAINT EACH_AXIS {
                R(k+2, c, e) = RELATIVE(c, e)/order;
                largest = fmax(largest, (k+2)*fabs(R(k+2, c, e)));
                PUSH(c, e) += SUM(c, e)/(time*(k+1));
                SHIFT(c, e) += SUM(c, e)/order;
            }
            small = largest <= bound ? small+1 : 0;
        }
        if (small == 2) {
            GATHER(SHIFT)
            EACH_ATOM EACH_AXIS X(i, e) += time*V(i, e)+INVERSE(i)*ON_ATOM(i, e);
            GATHER(PUSH)
            EACH_ATOM EACH_AXIS V(i, e) += INVERSE(i)*ON_ATOM(i, e);
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
