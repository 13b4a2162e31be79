// The moves of rigid bodies between two force evaluations, in one launch. OWN_MOVES contains the `case` labels of
// users' moves.

// Return in dP and dL the changes of the momenta P and L by friction and noise, or by two factors. The numbers are tau, and the
// friction factor and the amplitude of the noise, for translation and then for rotation. The last four numbers apply to bodies
// in flexible molecules.
DEVICE inline void relax(const Body* body, const fine* P, const fine* L, GLOBAL const double* numbers, GLOBAL const double* factors,
        int flexible, mm_long key, mm_long step, int number, int index, fine* dP, fine* dL) {
    if (SCALES) {
        const fine a = factors[0]-1.0, b = factors[1]-1.0;
        EACH(k, 3) {
            dP[k] = a*P[k];
            dL[k] = b*L[k];
        }
        return;
    }
    GLOBAL const double* of = numbers+(flexible ? 5 : 1);
    fine n[4];
    EACH(k, 3)
        dP[k] = dL[k] = 0;
    if (of[0] != 0.0) {
        const fine fade = of[0], amplitude = REAL(of[1])*REAL(body->constants[8]);
        normals(key, step, 16*number, index, n);
        EACH(k, 3)
            dP[k] = fade*P[k]+amplitude*n[k];
    }
    if (of[2] != 0.0 && body->inverse_inertia[2] != 0.0) {
        const fine fade = of[2], amplitude = of[3];
        normals(key, step, 16*number+1, index, n);
        EACH(k, 3)
            dL[k] = fade*L[k]+amplitude*REAL(body->constants[9+k])*n[k];
    }
}

// Exchange heat with body i, and record the momenta before and after the exchange. The kernels of `factors` sum the heat
// of common factors.
DEVICE inline void exchange(Body* body, int i, GLOBAL const double* numbers, GLOBAL const double* factors,
        int flexible, mm_long key, mm_long step, int number, int index, GLOBAL double* exchanged, GLOBAL double* heat) {
    const fine inverse_mass = body->inverse_mass;
    fine P[3], L[3], dP[3], dL[3], gain = 0;
    EACH(k, 3) {
        exchanged[k*BODIES+i] = body->P[k]; exchanged[(3+k)*BODIES+i] = body->L[k];
        P[k] = body->P[k]; L[k] = body->L[k];
    }
    relax(body, P, L, numbers, factors, flexible, key, step, number, index, dP, dL);
    EACH(k, 3) {
        body->P[k] += dP[k];
        body->L[k] += dL[k];
        gain += dP[k]*(2*P[k]+dP[k])*inverse_mass+dL[k]*(2*L[k]+dL[k])*REAL(body->inverse_inertia[k]);
        exchanged[(6+k)*BODIES+i] = body->P[k]; exchanged[(9+k)*BODIES+i] = body->L[k];
    }
    if (HEAT >= 0 && !SCALES)
        heat[i] += REAL(0.5)*gain;
}

// Compute the force on a body, and the torque in its body frame, from the forces on its particles. If these belong to a
// displaced body, the move in row `first` caused the displacement.
DEVICE inline void take_forces(Body* body, Place at, int i, GLOBAL const component* force, GLOBAL const int4* places, GLOBAL const int* atoms,
        GLOBAL const double* sites, GLOBAL double* here, GLOBAL const double* numbers, GLOBAL const int* first, int what, SHARED_ARG shared) {
    fine Q[9], arm[3] = {0, 0, 0};
    of_lane sums[6] = {0, 0, 0, 0, 0, 0};
    number place[4];
    EACH(k, 4)
        place[k] = body->q[k];
    if (GRADIENTS && what & IS_DISPLACED) {
        fine F[3], T[3];
        EACH(k, 3) {
            F[k] = here[k*BODIES+i]; T[k] = here[(3+k)*BODIES+i];
        }
        displaced(body, numbers[first[2]+1], F, T, arm, place);
    }
    quick_attitude(place, Q);
    FOR_SITES {
        GLOBAL const double* of_site = sites+3*(at.site+s*at.site_stride);
        const fine site[3] = {REAL(of_site[0]), REAL(of_site[1]), REAL(of_site[2])};
        fine f[3], r[3];
        read_force(force, places[atoms[at.atom+s*at.atom_stride]].x, f);
        TURN_SITE(Q, site, r)
        EACH(k, 3) {
            r[k] += arm[k];
            sums[k] += f[k];
        }
        ADD_CROSS((sums+3), r, f)
    }
    sum_over_lanes(sums, 6, shared);
    if (GRADIENTS && what & IS_DISPLACED)
        quick_attitude(body->q, Q);
    EACH(k, 3)
        body->F[k] = sums[k];
    TURN_BACK(Q, body->inverse_inertia, (sums+3), body->T)
}

// Perform a move that is not a drift on body i; `row` is its row in the table of moves.
DEVICE inline void move_body(Body* body, int i, GLOBAL const int* row, GLOBAL const int* index, GLOBAL double* last, GLOBAL double* differences,
        GLOBAL double* here, GLOBAL double* exchanged, GLOBAL double* heat, GLOBAL const double* numbers, GLOBAL const double* factors, mm_long step,
        double key, double turns) {
    const int op = row[0], number = row[1] & 0xffff, late = row[1]>>16;
    GLOBAL const double* values = numbers+row[2];
    const fine tau = values[0];
    switch (op) {
    case KICK:
    case DISPLACED_KICK:
        EACH(k, 3) {
            body->P[k] += tau*body->F[k];
            body->L[k] += tau*body->T[k];
        }
        if (KEEPS_DIFFERENCES && op == DISPLACED_KICK) {
            const int slot = (((mm_long) turns)*DIFFERENCES_PER_STEP+number)%DIFFERENCES;
            EACH(k, 3) {
                differences[(6*slot+k)*BODIES+i] = body->F[k]-here[k*BODIES+i];
                differences[(6*slot+3+k)*BODIES+i] = body->T[k]-here[(3+k)*BODIES+i];
            }
        }
        break;
    case EXCHANGE:
        exchange(body, i, values, factors, index[BODIES+i], (mm_long) key, step+late, number, index[i], exchanged, heat);
        break;
    case REMEMBER: {
        const int slot = (((mm_long) turns)*PER_STEP+number)%MEMORY;
        EACH(k, 3) {
            last[(6*slot+k)*BODIES+i] = body->F[k];
            last[(6*slot+3+k)*BODIES+i] = body->T[k];
        }
        break;
    }
    case LAST_KICK:
        for (int w = 0; w < row[3]; w++) {
            GLOBAL const double* from = last;
            int slot = (((mm_long) turns)*PER_STEP-1-w+MEMORY)%MEMORY;
            if (KEEPS_DIFFERENCES && w >= number) {
                from = differences;
                slot = (((mm_long) turns)*DIFFERENCES_PER_STEP-1-(w-number)+DIFFERENCES)%DIFFERENCES;
            }
            EACH(k, 3) {
                body->P[k] += values[w]*from[(6*slot+k)*BODIES+i];
                body->L[k] += values[w]*from[(6*slot+3+k)*BODIES+i];
            }
        }
        break;
    case DISPLACE:
        EACH(k, 3) {
            here[k*BODIES+i] = body->F[k];
            here[(3+k)*BODIES+i] = body->T[k];
        }
        break;
    OWN_MOVES
    }
}

// Write the positions and velocities of the particles of a body. For force-gradient kicks, they are those of the body
// displaced by e F/M and rotated by e T/I.
DEVICE inline void show_body(const Body* body, Place at, double e, CONTEXT, GLOBAL const int* atoms, GLOBAL const double* sites, int what) {
    double Q[9], centre[3];
    number place[4];
    EACH(k, 3)
        centre[k] = body->R[k];
    EACH(k, 4)
        place[k] = body->q[k];
    if (GRADIENTS && e != 0.0) {
        fine arm[3];
        displaced(body, e, body->F, body->T, arm, place);
        EACH(k, 3)
            centre[k] += arm[k];
    }
    attitude(place, Q);
    if (what & MOVES_PARTICLES)
        FOR_SITES {
            GLOBAL const double* site = sites+3*(at.site+s*at.site_stride);
            double r[3];
            TURN_SITE(Q, site, r)
            write_position(posq, posqCorrection, places[atoms[at.atom+s*at.atom_stride]], box, centre[0]+r[0], centre[1]+r[1], centre[2]+r[2]);
        }
    if (what & SHOWS_VELOCITIES) {
        double w[3], u[3];
        EACH(k, 3)
            w[k] = body->L[k]*body->inverse_inertia[k];
        TURN_SITE(Q, w, u)
        FOR_SITES {
            GLOBAL const double* site = sites+3*(at.site+s*at.site_stride);
            const int slot = places[atoms[at.atom+s*at.atom_stride]].x;
            double r[3], v[3] = {body->P[0]*body->inverse_mass, body->P[1]*body->inverse_mass, body->P[2]*body->inverse_mass};
            TURN_SITE(Q, site, r)
            ADD_CROSS(v, u, r)
            velm[slot] = make_mixed4((mixed) v[0], (mixed) v[1], (mixed) v[2], velm[slot].w);
        }
    }
}

#ifndef PROCESSOR
// Advance a body by t, or on processors several bodies (source/rigid.cpp).
DEVICE inline void drift(double t, Body* body, int n) {
    const double rate = t*body->inverse_mass;
    EACH(k, 3)
        body->R[k] += rate*body->P[k];
    rotate(t, body->constants, body->q, body->L);
}
#endif

#define SEGMENT_PARAMETERS CONTEXT, GLOBAL const component* force, TABLES, STATE, GLOBAL const int* index, GLOBAL double* last, \
    GLOBAL double* differences, GLOBAL double* here, GLOBAL double* exchanged, GLOBAL double* heat, GLOBAL const int* moves, \
    GLOBAL const double* numbers, GLOBAL const double* factors, int first, int count, int what, mm_long step, double key, \
    double turns
#define SEGMENT_ARGUMENTS posq, posqCorrection, velm, places, box, force, kind, kinds, atoms, sites, masses, constants, R_, P_, \
    q_, L_, index, last, differences, here, exchanged, heat, moves, numbers, factors, first, count, what, step, key, turns

// Perform the moves of n bodies from body i on.
DEVICE inline void segment_of_bodies(int i, int n, SHARED_ARG shared, SEGMENT_PARAMETERS) {
    Body some[AT_ONCE];
    double e = 0.0;
    EACH(l, n) {
        const Place at = place_of(i+l, kind, kinds);
        load_body(&some[l], i+l, R_, P_, q_, L_, constants+CONSTANTS*at.constants);
        if (what & HAS_FORCES)
            take_forces(&some[l], at, i+l, force, places, atoms, sites, here, numbers, moves+ROW*first, what, shared);
    }
    for (int row = first; row < first+count; row++) {
        if (moves[ROW*row] == DISPLACE)
            e = numbers[moves[ROW*row+2]];
        if (LANE_ID == 0 && moves[ROW*row] == DRIFT)
            drift(numbers[moves[ROW*row+2]], some, n);
        else if (LANE_ID == 0)
            EACH(l, n)
                move_body(&some[l], i+l, moves+ROW*row, index, last, differences, here, exchanged, heat, numbers, factors, step, key, turns);
    }
    EACH(l, n) {
        if (LANE_ID == 0)
            store_body(&some[l], i+l, R_, P_, q_, L_, what);
#if LANES > 1
        // The other threads of the body read the new state from global memory.
        SYNC_THREADS
        load_state(&some[l], i+l, R_, P_, q_, L_);
#endif
        if (what & (MOVES_PARTICLES | SHOWS_VELOCITIES))
            show_body(&some[l], place_of(i+l, kind, kinds), e, posq, posqCorrection, velm, places, box, atoms, sites, what);
    }
}

KERNEL void segment(SEGMENT_PARAMETERS) {
    SHARED
    FOR_SEVERAL_BODIES(i, n)
        segment_of_bodies(i, n, shared, SEGMENT_ARGUMENTS);
}
