// Free motion of a cluster along the geodesics of its constraints, as openmm_exactrb.kernels.compiled.clusters has it,
// where the series is derived. This text is read once for each way that clusters are stored, which is told by macros:
// MOVE the name of the function, ARGUMENTS what it takes besides, CONSTRAINTS and ATOMS how many there are, FIRST(c) and
// SECOND(c) the atoms of a constraint, LENGTH(c) in nm, INVERSE(i) inverse masses, X(i, e) and V(i, e) places and
// velocities, which change, and WORKSPACE, R(k, c, e), MULTIPLIER(k, c), FACTOR(c, d), SUM(c, e), PUSH(c, e),
// SHIFT(c, e), B(c) and ON_ATOM(i, e) the room to work in.

#define EACH_CONSTRAINT for (int c = 0; c < CONSTRAINTS; c++)
#define EACH_ATOM for (int i = 0; i < ATOMS; i++)
#define EACH_AXIS for (int e = 0; e < 3; e++)
#define PRODUCT(c, d) (R(0, c, 0)*R(0, d, 0)+R(0, c, 1)*R(0, d, 1)+R(0, c, 2)*R(0, d, 2))
#define COUPLING(c, d) ((FIRST(c) == FIRST(d) ? INVERSE(FIRST(c)) : 0.0)+(SECOND(c) == SECOND(d) ? INVERSE(SECOND(c)) : 0.0) \
    -(FIRST(c) == SECOND(d) ? INVERSE(FIRST(c)) : 0.0)-(SECOND(c) == FIRST(d) ? INVERSE(SECOND(c)) : 0.0))

// Solve for B with the factor of the matrix.
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

// Sum vectors of constraints over those of each atom, with their signs.
#define GATHER(VECTOR) \
    EACH_ATOM EACH_AXIS ON_ATOM(i, e) = 0.0; \
    EACH_CONSTRAINT EACH_AXIS { ON_ATOM(FIRST(c), e) += VECTOR(c, e); ON_ATOM(SECOND(c), e) -= VECTOR(c, e); }
#define RELATIVE(c, e) (INVERSE(FIRST(c))*ON_ATOM(FIRST(c), e)-INVERSE(SECOND(c))*ON_ATOM(SECOND(c), e))

// Advance a cluster by t (ps); for t = 0 velocities lose their parts along the constraints, and that is all.
DEVICE inline void MOVE(double t ARGUMENTS) {
    WORKSPACE
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

        // Bring lengths back by what rounding has changed, then follow the series.
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
        else { // the divergence check sees it
            EACH_ATOM EACH_AXIS X(i, e) = V(i, e) = NOT_A_NUMBER;
            return;
        }
    }
}

#undef PASTED
#undef NAMED
#undef PART
#undef MOST
#undef MOVE
#undef ARGUMENTS
#undef ATOMS
#undef CONSTRAINTS
#undef FIRST
#undef SECOND
#undef LENGTH
#undef INVERSE
#undef X
#undef V
#undef WORKSPACE
#undef R
#undef MULTIPLIER
#undef FACTOR
#undef AFTER_FACTOR
#undef B
#undef SUM
#undef PUSH
#undef SHIFT
#undef ON_ATOM
#undef EACH_CONSTRAINT
#undef EACH_ATOM
#undef EACH_AXIS
#undef PRODUCT
#undef COUPLING
#undef SOLVE
#undef GATHER
#undef RELATIVE
