// Free motion of stars, clusters whose first atom is constrained to all others, by the series of
// openmm_exactrb.constraints.geodesics. A team of threads moves a star. Each thread has one constraint with its
// outer atom, and a copy of the first atom. On OpenCL, where threads cannot exchange numbers without a barrier, a team
// is a single thread. A single atom is a star without constraints.
//
// Let r_c be the vector from the outer atom c to the first atom, w_c the inverse mass of atom c, and w that of the
// first atom. The matrix of the constraints is A = D + w R R^T, where R has the rows r_c, and D_c = w_c r_c.r_c. The
// solution of A x = b is
//
//     x_c = (b_c - w r_c.g)/D_c,   g = sum_c x_c r_c = (1 + w K)^-1 sum_c r_c b_c/D_c,   K = sum_c r_c r_c^T/D_c,
//
// so that the threads of a team exchange only sums and maxima. The threads use shuffles. All threads of a warp must
// therefore execute the same instructions until the last star of the warp is complete. On processors, REALS are vectors
// with a number of each of several stars (source/stars.h).
//
// If increments are in single precision, a motion ends with a projection of positions and velocities onto the constraints,
// whose residuals are in double precision, and with a correction of the kinetic energy. Otherwise the rounding of masses and
// of lengths, which is the same in every step, would change the energy in one direction.

#if defined(__OPENCL_VERSION__) || defined(PROCESSOR)
#define TEAM 1
#define ANY(yes) (yes)
#define OF_OTHER(number, distance) (number)
#elif defined(USE_HIP)
#define TEAM RAYS
#define ANY(yes) __any(yes)
#define OF_OTHER(number, distance) __shfl_xor(number, distance)
#else
#define TEAM RAYS
#define ANY(yes) __any_sync(0xffffffff, yes)
#define OF_OTHER(number, distance) __shfl_xor_sync(0xffffffff, number, distance)
#endif
#ifndef PROCESSOR
#define REALS fine
#define NUMBERS number
#define INDICES int
#define SEVERAL false
#define ZERO REAL(0.0)
#define IF_HELD(c, number, other) (holds[c] ? (number) : (other))
#define NUMBER_AT(array, first, outer) (array)[(first)+(outer)]
#define VECTOR_AT(array, first, outer, e) (array)[3*((first)+(outer))+(e)]
#define PUT_AT(array, first, outer, e, number) VECTOR_AT(array, first, outer, e) = number
#define TAKE_FROM(array, first, number) (array)[first] -= number

// Whether a series has not ended yet, as a factor and as a condition; and the number of its last successive small orders.
// The series ends after two of them.
DEVICE inline fine is_large(fine small) {
    return small < 2 ? 1 : 0;
}

DEVICE inline bool still_large(fine small) {
    return small < 2;
}

DEVICE inline fine small_orders(fine small, fine largest, fine bound) {
    return small >= 2 ? small : largest <= bound ? small+1 : 0;
}

// Return a/b, or 0 for b = 0.
DEVICE inline fine part_of(fine a, fine b) {
    return b > 0 ? a/b : 0;
}

#endif

#define HELD (RAYS/TEAM) // constraints of a thread
#define EACH_CONSTRAINT EACH(c, HELD)
#define EACH_AXIS EACH(e, 3)
// A series ends when two successive terms are below this fraction of its first term.
#define ENDING REAL(SINGLE ? 1e-8 : SETTLED)
#define EACH_DISTANCE for (int distance = 1; distance < TEAM; distance *= 2)
// Loops are unrolled if the arrays then fit into registers.
#if TEAM > 1
#define EACH_ORDER EACH(k, ORDERS)
#define EACH_BEFORE(j, n) EACH(j, n)
#else
#define EACH_ORDER for (int k = 0; k < ORDERS; k++)
#define EACH_BEFORE(j, n) for (int j = 0; j < n; j++)
#endif
#define ALONG(u, v, c) ((u)[0][c]*(v)[0][c]+(u)[1][c]*(v)[1][c]+(u)[2][c]*(v)[2][c])
#define ALONG_ALL(u, g, c) ((u)[0][c]*(g)[0]+(u)[1][c]*(g)[1]+(u)[2][c]*(g)[2])

// Sum each component over the constraints of a star; `team_max` returns the largest of non-negative numbers.
DEVICE inline void team_sum(const REALS (*of_constraint)[HELD], REALS* s, int components) {
    for (int e = 0; e < components; e++) {
        s[e] = ZERO;
        EACH_CONSTRAINT
            s[e] += of_constraint[e][c];
        EACH_DISTANCE
            s[e] += OF_OTHER(s[e], distance);
    }
}

DEVICE inline REALS team_max(REALS x) {
    EACH_DISTANCE
        x = fmax(x, OF_OTHER(x, distance));
    return x;
}

// Multiply by a symmetric matrix; `invert` computes the inverse of 1 + w K.
DEVICE inline void multiply(const REALS* K, const REALS* s, REALS* g) {
    g[0] = K[0]*s[0]+K[1]*s[1]+K[2]*s[2];
    g[1] = K[1]*s[0]+K[3]*s[1]+K[4]*s[2];
    g[2] = K[2]*s[0]+K[4]*s[1]+K[5]*s[2];
}

DEVICE inline void invert(REALS w, const REALS* K, REALS* inverse) {
    const REALS a = 1+w*K[0], b = w*K[1], c = w*K[2], d = 1+w*K[3], e = w*K[4], f = 1+w*K[5];
    const REALS of_a = d*f-e*e, of_b = c*e-b*f, of_c = b*e-c*d, over = 1/(a*of_a+b*of_b+c*of_c);
    inverse[0] = over*of_a;
    inverse[1] = over*of_b;
    inverse[2] = over*of_c;
    inverse[3] = over*(a*f-c*c);
    inverse[4] = over*(b*c-a*e);
    inverse[5] = over*(a*d-b*b);
}

// Return the kinetic energy of velocities along the constraints of a star, which a projection removes: b.x/2 for A x = b.
// The first constraint of the thread is `lane`.
DEVICE inline REALS along_star(GLOBAL const double* v, INDICES first, int lane, const bool* holds, REALS w0, const REALS (*r)[HELD], const REALS* over,
        const REALS* inverse) {
    REALS told[4][HELD], s[4], g[3];
    EACH_CONSTRAINT {
        REALS b = ZERO;
        EACH_AXIS
            b -= IF_HELD(c, r[e][c]*(REALS) (VECTOR_AT(v, first, 0, e)-VECTOR_AT(v, first, lane+c+1, e)), REAL(0.0));
        EACH_AXIS
            told[e][c] = over[c]*b*r[e][c];
        told[3][c] = over[c]*b*b;
    }
    team_sum(told, s, 4);
    multiply(inverse, s, g);
    return REAL(0.5)*(s[3]-w0*(s[0]*g[0]+s[1]*g[1]+s[2]*g[2]));
}

// Correct the changes of the momenta of a star, push0 and minus `push`, so that rounding does not change the kinetic
// energy; see openmm_exactrb.constraints.geodesics.
DEVICE inline void keep_energy_of_star(REALS w0, const NUMBERS* V0, REALS* push0, const REALS* w, const NUMBERS (*V)[HELD], REALS (*push)[HELD],
        const bool* holds) {
    REALS told[4][HELD], s[4], centre[3];
    EACH_CONSTRAINT {
        told[3][c] = IF_HELD(c, 1.0/w[c], 0.0);
        EACH_AXIS
            told[e][c] = told[3][c]*V[e][c];
    }
    team_sum(told, s, 4);
    EACH_AXIS
        centre[e] = (s[e]+V0[e]/w0)/(s[3]+1.0/w0);
    EACH_CONSTRAINT {
        const REALS m = told[3][c];
        told[0][c] = told[1][c] = ZERO;
        EACH_AXIS {
            const REALS before = V[e][c]-centre[e], after = before-w[c]*push[e][c];
            told[0][c] -= push[e][c]*(before+after);
            told[1][c] += m*after*after;
        }
    }
    team_sum(told, s, 2);
    EACH_AXIS {
        const REALS before = V0[e]-centre[e], after = before+w0*push0[e];
        s[0] += push0[e]*(before+after);
        s[1] += after*after/w0;
    }
    const REALS excess = 0.5*part_of(s[0], s[1]);
    EACH_AXIS {
        push0[e] -= excess*((V0[e]-centre[e])/w0+push0[e]);
        EACH_CONSTRAINT
            push[e][c] -= excess*(push[e][c]-IF_HELD(c, (V[e][c]-centre[e])/w[c], 0.0));
    }
}

// Find the changes of velocities, `change0` and minus `change`, that project them onto the constraints of a star. Further results are
// the vectors of constraints and their rates, 1/D_c, half the differences of squared lengths, K, the inverse of 1 + w K, and sums
// for `shift_back`. Unless it is `exact`, the precision is that of increments, and lengths are not compared.
DEVICE inline void project(bool exact, const bool* holds, REALS w0, const REALS* w, const DOUBLES* length, const NUMBERS* X0, const NUMBERS (*X)[HELD],
        const NUMBERS* V0, const NUMBERS (*V)[HELD], REALS (*r)[HELD], REALS (*rates)[HELD], REALS* over, REALS* away, REALS* K, REALS* inverse, REALS* s,
        REALS* change0, REALS (*change)[HELD]) {
    REALS b[HELD], told[6][HELD], g[3];
    EACH_CONSTRAINT {
        DOUBLES between[3], rest[3], along = ZERO;
        EACH_AXIS {
            const DOUBLES rate = V0[e]-V[e][c];
            between[e] = apart(X0[e], X[e][c], rest+e);
            r[e][c] = between[e];
            rates[e][c] = rate;
            if (exact)
                along -= between[e]*rate;
        }
        over[c] = IF_HELD(c, 1/(w[c]*ALONG(r, r, c)), REAL(0.0));
        away[c] = IF_HELD(c, exact ? (REALS) half_defect(length[c], between, rest) : ZERO, ZERO);
        b[c] = exact ? (REALS) along : -ALONG(r, rates, c);
        told[0][c] = over[c]*r[0][c]*r[0][c];
        told[1][c] = over[c]*r[0][c]*r[1][c];
        told[2][c] = over[c]*r[0][c]*r[2][c];
        told[3][c] = over[c]*r[1][c]*r[1][c];
        told[4][c] = over[c]*r[1][c]*r[2][c];
        told[5][c] = over[c]*r[2][c]*r[2][c];
    }
    team_sum(told, K, 6);
    invert(w0, K, inverse);
    EACH_CONSTRAINT
        EACH_AXIS {
            told[e][c] = over[c]*b[c]*r[e][c];
            told[3+e][c] = over[c]*away[c]*r[e][c];
        }
    team_sum(told, s, 6);
    multiply(inverse, s, g);
    EACH_AXIS
        change0[e] = w0*g[e];
    EACH_CONSTRAINT {
        b[c] = over[c]*(b[c]-w0*ALONG_ALL(r, g, c));
        EACH_AXIS
            change[e][c] = w[c]*b[c]*r[e][c];
    }
}

// Return twice the kinetic energy of a star.
DEVICE inline DOUBLES energy_of_star(REALS w0, const REALS* w, const NUMBERS* V0, const NUMBERS (*V)[HELD], const bool* holds) {
    DOUBLES sum = ZERO;
    EACH_CONSTRAINT {
        const DOUBLES v0 = V[0][c], v1 = V[1][c], v2 = V[2][c];
        sum += IF_HELD(c, 1/w[c], REAL(0.0))*(v0*v0+v1*v1+v2*v2);
    }
    EACH_DISTANCE
        sum += OF_OTHER(sum, distance);
    const DOUBLES v0 = V0[0], v1 = V0[1], v2 = V0[2];
    return sum+(1/w0)*(v0*v0+v1*v1+v2*v2);
}

// Add to the changes of velocities those that change twice the kinetic energy of a star by `lost`: a common factor of all velocities
// relative to the centre.
DEVICE inline void restore_energy_of_star(REALS lost, REALS w0, const REALS* w, const NUMBERS* V0, const NUMBERS (*V)[HELD], const bool* holds,
        REALS* change0, REALS (*change)[HELD]) {
    REALS told[4][HELD], s[4], v0[3], v[3][HELD];
    EACH_CONSTRAINT {
        told[3][c] = IF_HELD(c, 1/w[c], REAL(0.0));
        EACH_AXIS {
            v[e][c] = V[e][c];
            told[e][c] = told[3][c]*v[e][c];
        }
    }
    team_sum(told, s, 4);
    const REALS m0 = 1/w0, over = 1/(s[3]+m0);
    EACH_AXIS {
        v0[e] = V0[e];
        const REALS centre = (s[e]+m0*v0[e])*over;
        v0[e] -= centre;
        EACH_CONSTRAINT
            v[e][c] -= centre;
    }
    EACH_CONSTRAINT
        told[0][c] = told[3][c]*ALONG(v, v, c);
    team_sum(told, s, 1);
    const REALS factor = REAL(0.5)*part_of(lost, s[0]+m0*(v0[0]*v0[0]+v0[1]*v0[1]+v0[2]*v0[2]));
    EACH_AXIS {
        change0[e] += factor*v0[e];
        EACH_CONSTRAINT
            change[e][c] -= factor*v[e][c];
    }
}

// Compute the displacements w0 `shift0` of the first atom and -w_c `shift` of the other atoms that correct the lengths.
DEVICE inline void shift_back(REALS w0, const REALS (*r)[HELD], const REALS* over, const REALS* away, const REALS* inverse, const REALS* s,
        REALS* shift0, REALS (*shift)[HELD]) {
    multiply(inverse, s+3, shift0);
    EACH_CONSTRAINT {
        const REALS back = over[c]*(away[c]-w0*ALONG_ALL(r, shift0, c));
        EACH_AXIS
            shift[e][c] = back*r[e][c];
    }
}

// Advance a star by t (ps). For t = 0, only project the velocities, which removes components along constraints. The first of
// its `atoms` has the index `first`, and `at` in the block. A thread without a star is `idle`, but participates in shuffles.
// If a heat exchange at these positions `relaxes` velocities, its heat is corrected for the constraints. Several stars are not
// advanced if the series of one of them does not end; the function then returns false.
DEVICE inline bool move_star(bool idle, fine t, INDICES first, INDICES at, int atoms, GLOBAL const double* inverse_masses, GLOBAL const double* lengths,
        bool relaxes, GLOBAL const double* before, GLOBAL const double* after, GLOBAL double* heat, LOCAL_ARG number* xs, GLOBAL number* v) {
    const bool moves = !idle;
    if (!ANY(moves))
        return true;
    const int lane = HELD*(LOCAL_ID%TEAM);
    const bool corrects = moves && relaxes && lane == 0;
    const REALS w0 = NUMBER_AT(inverse_masses, first, 0);
    NUMBERS X0[3], V0[3], X[3][HELD], V[3][HELD];
    REALS w[HELD], along = ZERO;
    DOUBLES length[HELD], energy = ZERO;
    fine part = 1, remaining = moves ? 1 : 0;
    bool holds[HELD];
    EACH_AXIS {
        X0[e] = VECTOR_AT(xs, at, 0, e);
        V0[e] = VECTOR_AT(v, first, 0, e);
    }
    EACH_CONSTRAINT {
        const int outer = lane+c+1;
        holds[c] = moves && outer < atoms;
        w[c] = IF_HELD(c, NUMBER_AT(inverse_masses, first, outer), 0.0);
        length[c] = IF_HELD(c, NUMBER_AT(lengths, first, outer), 0.0);
        EACH_AXIS {
            X[e][c] = IF_HELD(c, VECTOR_AT(xs, at, outer, e), X0[e]);
            V[e][c] = IF_HELD(c, VECTOR_AT(v, first, outer, e), V0[e]);
        }
    }
    while (ANY(remaining > 0)) {
        REALS r[ORDERS+2][3][HELD], rates[3][HELD], change0[3], change[3][HELD], multiplier[ORDERS][HELD], over[HELD], b[HELD], away[HELD], told[6][HELD], K[6], inverse[6], s[6], g[3];
        project(!SINGLE, holds, w0, w, length, X0, X, V0, V, r[0], rates, over, away, K, inverse, s, change0, change);
        if (remaining > 0)
            EACH_AXIS {
                V0[e] += change0[e];
                EACH_CONSTRAINT
                    V[e][c] -= change[e][c];
            }
        if (relaxes)
            along = along_star(after, first, lane, holds, w0, r[0], over, inverse)-along_star(before, first, lane, holds, w0, r[0], over, inverse);
        relaxes = false;
        if (t == 0)
            break;
        if (SINGLE && remaining == 1)
            energy = energy_of_star(w0, w, V0, V, holds);

        // Correct the rounding errors of the lengths, then compute the series. For the first atom, sums run over all
        // constraints.
        const fine time = part*t, over_time = 1/time;
        const double span = time;
        REALS shift0[3], push0[3], shift[3][HELD], push[3][HELD], G[3], S[3][HELD], bound = ZERO, small = bound;
        shift_back(w0, r[0], over, away, inverse, s, shift0, shift);
        EACH_AXIS
            push0[e] = ZERO;
        EACH_CONSTRAINT {
            EACH_AXIS {
                push[e][c] = ZERO;
                r[1][e][c] = IF_HELD(c, time*(SINGLE ? rates[e][c]+change0[e]+change[e][c] : (REALS) (V0[e]-V[e][c])), REAL(0.0));
                bound = fmax(bound, ENDING*fabs(r[1][e][c]));
            }
        }
        bound = team_max(bound);
        EACH_ORDER {
            if (!ANY(remaining > 0 && still_large(small)))
                break;
            const fine order = (k+1)*(k+2), over_order = 1/order;
            const REALS of_push = is_large(small)*(over_time*(REAL(1.0)/(k+1))), of_shift = is_large(small)*over_order;
            EACH_CONSTRAINT {
                REALS q = ZERO;
                EACH_BEFORE(j, (k+1)/2)
                    q += ALONG(r[j+1], r[k+1-j], c);
                if (k%2 == 0)
                    q += REAL(0.5)*ALONG(r[k/2+1], r[k/2+1], c);
                EACH_AXIS {
                    S[e][c] = ZERO;
                    EACH_BEFORE(j, k)
                        S[e][c] += multiplier[j][c]*r[k-j][e][c];
                }
                b[c] = -order*q-w[c]*ALONG(r[0], S, c);
                EACH_AXIS {
                    told[e][c] = IF_HELD(c, S[e][c], REAL(0.0));
                    told[3+e][c] = over[c]*b[c]*r[0][e][c];
                }
            }
            team_sum(told, s, 6);
            multiply(K, s, G);
            EACH_AXIS {
                s[3+e] -= w0*G[e];
                G[e] = s[e];
            }
            multiply(inverse, s+3, g);
            REALS largest = ZERO;
            EACH_CONSTRAINT {
                multiplier[k][c] = over[c]*(b[c]-w0*(ALONG_ALL(r[0], G, c)+ALONG_ALL(r[0], g, c)));
                EACH_AXIS {
                    S[e][c] += multiplier[k][c]*r[0][e][c];
                    r[k+2][e][c] = IF_HELD(c, (w0*(G[e]+g[e])+w[c]*S[e][c])*over_order, REAL(0.0));
                    largest = fmax(largest, (k+2)*fabs(r[k+2][e][c]));
                    push[e][c] += S[e][c]*of_push;
                    shift[e][c] += S[e][c]*of_shift;
                }
            }
            EACH_AXIS {
                push0[e] += (G[e]+g[e])*of_push;
                shift0[e] += (G[e]+g[e])*of_shift;
            }
            small = small_orders(small, team_max(largest), bound);
        }
        if (remaining > 0 && !still_large(small)) {
            if (LOW_PARTS)
                keep_energy_of_star(w0, V0, push0, w, V, push, holds);
            EACH_AXIS {
                X0[e] += span*V0[e]+w0*shift0[e];
                V0[e] += w0*push0[e];
                EACH_CONSTRAINT {
                    X[e][c] += span*V[e][c]-w[c]*shift[e][c];
                    V[e][c] -= w[c]*push[e][c];
                }
            }
            remaining -= part;
        }
        else if (SEVERAL)
            return false;
        else if (part > REAL(SHORTEST))
            part *= REAL(0.5);
        else if (remaining > 0) { // the divergence check detects these values
            EACH_AXIS {
                X0[e] = V0[e] = NOT_A_NUMBER+ZERO;
                EACH_CONSTRAINT
                    X[e][c] = V[e][c] = NOT_A_NUMBER+ZERO;
            }
            remaining = 0;
        }
    }
    if (SINGLE) {
        REALS r[3][HELD], rates[3][HELD], change0[3], change[3][HELD], over[HELD], away[HELD], K[6], inverse[6], s[6], shift0[3], shift[3][HELD];
        project(true, holds, w0, w, length, X0, X, V0, V, r, rates, over, away, K, inverse, s, change0, change);
        if (t != 0)  // the changes of a projection are too small to change the energy
            restore_energy_of_star(energy-energy_of_star(w0, w, V0, V, holds), w0, w, V0, V, holds, change0, change);
        shift_back(w0, r, over, away, inverse, s, shift0, shift);
        if (moves)
            EACH_AXIS {
                V0[e] += change0[e];
                EACH_CONSTRAINT
                    V[e][c] -= change[e][c];
            }
        if (moves && t != 0)
            EACH_AXIS {
                X0[e] += w0*shift0[e];
                EACH_CONSTRAINT
                    X[e][c] -= w[c]*shift[e][c];
            }
    }
    if (corrects)
        TAKE_FROM(heat, first, along);
    EACH_AXIS {
        if (moves && lane == 0) {
            PUT_AT(xs, at, 0, e, X0[e]);
            PUT_AT(v, first, 0, e, V0[e]);
        }
        EACH_CONSTRAINT
            if (holds[c]) {
                PUT_AT(xs, at, lane+c+1, e, X[e][c]);
                PUT_AT(v, first, lane+c+1, e, V[e][c]);
            }
    }
    return true;
}

#undef EACH_CONSTRAINT
