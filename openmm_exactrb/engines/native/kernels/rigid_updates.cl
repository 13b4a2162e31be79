// Transfer OpenMM's changes of velocities and positions between steps to the state of the bodies. Bodies that OpenMM
// did not change keep their state to the last bit.

// Convert changes of velocities (CMMotionRemover, AndersenThermostat) to changes of momenta, and add them to this state
// of the bodies, or to another state. If all of them are by a CMMotionRemover (`removes`), add the kinetic energy that they
// supply to the heat.
KERNEL void pushed(CONTEXT, TABLES, STATE, GLOBAL number* P_to, GLOBAL number* L_to, GLOBAL double* heat, double removes) {
    SHARED
    FOR_BODIES {
        const Place at = place_of(i, kind, kinds);
        GLOBAL const double* own = constants+CONSTANTS*at.constants;
        Body body;
        load_body(&body, i, R_, P_, q_, L_, own);
        double Q[9], w[3], u[3], sums[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0}, L[3];
        attitude(body.q, Q);
        EACH(k, 3)
            w[k] = body.L[k]*body.inverse_inertia[k];
        TURN_SITE(Q, w, u)
        FOR_SITES {
            GLOBAL const double* site = sites+3*(at.site+s*at.site_stride);
            const mixed4 now = velm[places[atoms[at.atom+s*at.atom_stride]].x];
            const double m = masses[at.mass+s];
            double r[3], v[3] = {body.P[0]*body.inverse_mass, body.P[1]*body.inverse_mass, body.P[2]*body.inverse_mass}, p[3];
            TURN_SITE(Q, site, r)
            ADD_CROSS(v, u, r)
            p[0] = m*(now.x-(mixed) v[0]); p[1] = m*(now.y-(mixed) v[1]); p[2] = m*(now.z-(mixed) v[2]);
            EACH(k, 3)
                sums[k] += p[k];
            ADD_CROSS((sums+3), r, p)
        }
        sum_over_lanes(sums, 6, shared);
        TURN_BACK(Q, body.inverse_inertia, (sums+3), L)
        if (LANE_ID == 0) {
            double gain = 0.0;
            EACH(k, 3) {
                gain += sums[k]*(2.0*body.P[k]+sums[k])*body.inverse_mass+L[k]*(2.0*body.L[k]+L[k])*body.inverse_inertia[k];
                P_to[k*BODIES+i] += sums[k];
                L_to[k*BODIES+i] += L[k];
            }
            if (HEAT >= 0 && removes != 0.0)
                heat[i] += 0.5*gain;
        }
    }
}

// Convert changes of positions by barostats, which do not rotate bodies, to changes of their centres.
KERNEL void moved(CONTEXT, TABLES, STATE) {
    SHARED
    FOR_BODIES {
        const Place at = place_of(i, kind, kinds);
        GLOBAL const double* own = constants+CONSTANTS*at.constants;
        Body body;
        load_body(&body, i, R_, P_, q_, L_, own);
        double Q[9], sums[3] = {0.0, 0.0, 0.0};
        attitude(body.q, Q);
        FOR_SITES {
            GLOBAL const double* site = sites+3*(at.site+s*at.site_stride);
            double r[3], x[3];
            TURN_SITE(Q, site, r)
            read_position(posq, posqCorrection, places[atoms[at.atom+s*at.atom_stride]], box, x);
            EACH(k, 3)
                sums[k] += masses[at.mass+s]*body.inverse_mass*(x[k]-body.R[k]-r[k]);
        }
        sum_over_lanes(sums, 3, shared);
        if (LANE_ID == 0 && sums[0]*sums[0]+sums[1]*sums[1]+sums[2]*sums[2] > STILL*STILL) {
            EACH(k, 3)
                R_[k*BODIES+i] += sums[k];
        }
    }
}
