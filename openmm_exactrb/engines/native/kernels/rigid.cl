// The moves of rigid bodies between two force evaluations, in one launch. OWN_MOVES contains the `case` labels of
// users' moves.

// Apply friction and noise, or multiply momenta by two factors. The numbers are tau, and the friction factor and the
// amplitude of the noise, for translation and then for rotation. The last four numbers apply to bodies in flexible
// molecules.
DEVICE inline void relax(Body* body, GLOBAL const double* constants, GLOBAL const double* numbers, GLOBAL const double* factors,
        int flexible, mm_long key, mm_long step, int number, int index) {
    if (SCALES) {
        EACH(k, 3) {
            body->P[k] += (factors[0]-1.0)*body->P[k];
            body->L[k] += (factors[1]-1.0)*body->L[k];
        }
        return;
    }
    GLOBAL const double* of = numbers+(flexible ? 5 : 1);
    double n[4];
    if (of[0] != 0.0) {
        normals(key, step, 16*number, index, n);
        EACH(k, 3)
            body->P[k] += of[0]*body->P[k]+of[1]*constants[8]*n[k];
    }
    if (of[2] != 0.0 && body->inverse_inertia[2] != 0.0) {
        normals(key, step, 16*number+1, index, n);
        EACH(k, 3)
            body->L[k] += of[2]*body->L[k]+of[3]*constants[9+k]*n[k];
    }
}

// Exchange heat with body i, and record the momenta before and after the exchange. The kernels of `factors` sum the heat
// of common factors.
DEVICE inline void exchange(Body* body, int i, GLOBAL const double* constants, GLOBAL const double* numbers, GLOBAL const double* factors,
        int flexible, mm_long key, mm_long step, int number, int index, GLOBAL double* exchanged, GLOBAL double* heat) {
    double P[3], L[3], gain = 0.0;
    EACH(k, 3) {
        P[k] = body->P[k]; L[k] = body->L[k];
    }
    relax(body, constants, numbers, factors, flexible, key, step, number, index);
    EACH(k, 3) {
        gain += (body->P[k]-P[k])*(body->P[k]+P[k])*body->inverse_mass+(body->L[k]-L[k])*(body->L[k]+L[k])*body->inverse_inertia[k];
        exchanged[k*BODIES+i] = P[k]; exchanged[(3+k)*BODIES+i] = L[k];
        exchanged[(6+k)*BODIES+i] = body->P[k]; exchanged[(9+k)*BODIES+i] = body->L[k];
    }
    if (HEAT >= 0 && !SCALES)
        heat[i] += 0.5*gain;
}

KERNEL void segment(CONTEXT, GLOBAL const component* force, TABLES, STATE, GLOBAL const int* index, GLOBAL double* last,
        GLOBAL double* differences, GLOBAL double* here, GLOBAL double* exchanged, GLOBAL double* heat, GLOBAL const int* moves,
        GLOBAL const double* numbers, GLOBAL const double* factors, int first, int count, int what, mm_long step, double key, double turns) {
    SHARED
    FOR_BODIES {
        const Place at = place_of(i, kind, kinds);
        GLOBAL const double* own = constants+CONSTANTS*at.constants;
        Body body;
        load_body(&body, i, R_, P_, q_, L_, own);
        double Q[9], arm[3] = {0.0, 0.0, 0.0};
        number place[4];
        EACH(k, 4)
            place[k] = body.q[k];
        if (GRADIENTS && what & IS_DISPLACED) {
            double F[3], T[3];
            EACH(k, 3) {
                F[k] = here[k*BODIES+i]; T[k] = here[(3+k)*BODIES+i];
            }
            displaced(&body, numbers[moves[ROW*first+2]+1], F, T, arm, place);
        }
        if (what & HAS_FORCES) {
            double sums[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
            attitude(place, Q);
            FOR_SITES {
                double f[3], r[3];
                read_force(force, places[atoms[at.atom+s*at.atom_stride]].x, f);
                turned(Q, sites+3*(at.site+s*at.site_stride), r);
                EACH(k, 3) {
                    r[k] += arm[k];
                    sums[k] += f[k];
                }
                add_cross(sums+3, r, f);
            }
            sum_over_lanes(sums, 6, shared);
            if (GRADIENTS && what & IS_DISPLACED)
                attitude(body.q, Q);
            EACH(k, 3)
                body.F[k] = sums[k];
            in_body(Q, body.inverse_inertia, sums+3, body.T);
        }
        double e = 0.0;
        if (LANE == 0)
        for (int row = first; row < first+count; row++) {
            const int op = moves[ROW*row], number = moves[ROW*row+1] & 0xffff, late = moves[ROW*row+1]>>16;
            GLOBAL const double* values = numbers+moves[ROW*row+2];
            const double tau = values[0];
            switch (op) {
            case DRIFT:
                EACH(k, 3)
                    body.R[k] += tau*body.P[k]*body.inverse_mass;
                rotate(tau, own, body.q, body.L);
                break;
            case KICK:
            case DISPLACED_KICK:
                EACH(k, 3) {
                    body.P[k] += tau*body.F[k];
                    body.L[k] += tau*body.T[k];
                }
                if (KEEPS_DIFFERENCES && op == DISPLACED_KICK) {
                    const int slot = (((mm_long) turns)*DIFFERENCES_PER_STEP+number)%DIFFERENCES;
                    EACH(k, 3) {
                        differences[(6*slot+k)*BODIES+i] = body.F[k]-here[k*BODIES+i];
                        differences[(6*slot+3+k)*BODIES+i] = body.T[k]-here[(3+k)*BODIES+i];
                    }
                }
                break;
            case EXCHANGE:
                exchange(&body, i, own, values, factors, index[BODIES+i], (mm_long) key, step+late, number, index[i], exchanged, heat);
                break;
            case REMEMBER: {
                const int slot = (((mm_long) turns)*PER_STEP+number)%MEMORY;
                EACH(k, 3) {
                    last[(6*slot+k)*BODIES+i] = body.F[k];
                    last[(6*slot+3+k)*BODIES+i] = body.T[k];
                }
                break;
            }
            case LAST_KICK:
                for (int w = 0; w < moves[ROW*row+3]; w++) {
                    GLOBAL const double* from = last;
                    int slot = (((mm_long) turns)*PER_STEP-1-w+MEMORY)%MEMORY;
                    if (KEEPS_DIFFERENCES && w >= number) {
                        from = differences;
                        slot = (((mm_long) turns)*DIFFERENCES_PER_STEP-1-(w-number)+DIFFERENCES)%DIFFERENCES;
                    }
                    EACH(k, 3) {
                        body.P[k] += values[w]*from[(6*slot+k)*BODIES+i];
                        body.L[k] += values[w]*from[(6*slot+3+k)*BODIES+i];
                    }
                }
                break;
            case DISPLACE:
                e = tau;
                EACH(k, 3) {
                    here[k*BODIES+i] = body.F[k];
                    here[(3+k)*BODIES+i] = body.T[k];
                }
                break;
            OWN_MOVES
            }
        }
        if (LANE == 0) {
            EACH(k, 3) {
                P_[k*BODIES+i] = body.P[k]; L_[k*BODIES+i] = body.L[k];
            }
        }
        if (LANE == 0 && (what & MOVES_PARTICLES)) {
            EACH(k, 3)
                R_[k*BODIES+i] = body.R[k];
            EACH(k, 4)
                q_[k*BODIES+i] = body.q[k];
        }
#if LANES > 1
        // The other threads of the body read the new state from global memory. The displacement is the same for all
        // threads.
        SYNC_THREADS
        if (LANE != 0)
            for (int row = first; row < first+count; row++)
                if (moves[ROW*row] == DISPLACE)
                    e = numbers[moves[ROW*row+2]];
        EACH(k, 3) {
            body.R[k] = R_[k*BODIES+i]; body.P[k] = P_[k*BODIES+i]; body.L[k] = L_[k*BODIES+i];
        }
        EACH(k, 4)
            body.q[k] = q_[k*BODIES+i];
#endif
        EACH(k, 3)
            arm[k] = body.R[k];
        EACH(k, 4)
            place[k] = body.q[k];
        if (GRADIENTS && e != 0.0) {
            displaced(&body, e, body.F, body.T, arm, place);
            EACH(k, 3)
                arm[k] += body.R[k];
        }
        if (what & (MOVES_PARTICLES | SHOWS_VELOCITIES))
            attitude(place, Q);
        if (what & MOVES_PARTICLES)
            FOR_SITES {
                double r[3];
                turned(Q, sites+3*(at.site+s*at.site_stride), r);
                write_position(posq, posqCorrection, places[atoms[at.atom+s*at.atom_stride]], box, arm[0]+r[0], arm[1]+r[1], arm[2]+r[2]);
            }
        if (what & SHOWS_VELOCITIES) {
            double w[3], u[3];
            EACH(k, 3)
                w[k] = body.L[k]*body.inverse_inertia[k];
            EACH(k, 3)
                u[k] = Q[3*k]*w[0]+Q[3*k+1]*w[1]+Q[3*k+2]*w[2];
            FOR_SITES {
                const int slot = places[atoms[at.atom+s*at.atom_stride]].x;
                double r[3], v[3] = {body.P[0]*body.inverse_mass, body.P[1]*body.inverse_mass, body.P[2]*body.inverse_mass};
                turned(Q, sites+3*(at.site+s*at.site_stride), r);
                add_cross(v, u, r);
                velm[slot] = make_mixed4((mixed) v[0], (mixed) v[1], (mixed) v[2], velm[slot].w);
            }
        }
    }
}
