// Rigid bodies of all kinds: the state of a body, and its indices in the tables.
//
// The host defines macros, or data members on processors. BODIES is the number of bodies, and LANES the number of threads
// per body (1 or a block). MEMORY and PER_STEP are the numbers of stored forces, at least 1 in total, and per step.
// DIFFERENCES and DIFFERENCES_PER_STEP are these numbers for differences between displaced and undisplaced forces, which
// are stored if KEEPS_DIFFERENCES is nonzero. GRADIENTS is nonzero if the scheme has force-gradient kicks, and SCALES if
// heat exchanges multiply momenta by common factors. HEAT is the index of the heat among the persistent numbers of the
// thermostat, or negative.

// The state of a body, the force on it, the torque in its body frame, and its row of the table of constants. Unknown
// forces and torques are zero.
typedef struct {
    number R[3], P[3], q[4], L[3];
    fine F[3], T[3];
    double inverse_mass, inverse_inertia[3];
    GLOBAL const double* constants;
} Body;

// Numbers of columns of the tables of kinds, of constants and of moves.
#define KIND_COLUMNS 8
#define CONSTANTS 12
#define ROW 4

// On processors, a thread moves up to AT_ONCE bodies together (source/rigid.cpp).
#ifndef PROCESSOR
#define AT_ONCE 1
#define FOR_SEVERAL_BODIES(i, n) const int n = 1; FOR_BODIES
#endif

// The number of particles of a body, which is a constant if all bodies have the same number.
#ifndef SITES
#define SITES row[2]
#endif
#define FOR_SITES _Pragma("unroll 4") for (int s = LANE_ID; s < at.sites; s += LANES)
#if LANES > 1
#define LANE_ID LOCAL_ID
#define FOR_BODIES for (OF_GROUP(i, BODIES))
#define SHARED LOCAL double shared[LANES];
#define SHARED_ARG LOCAL_ARG double*
#else
#define LANE_ID 0
#define FOR_BODIES for (OF_THREAD(i, BODIES))
#define SHARED double shared[1];
#define SHARED_ARG double*
#endif

// Sum numbers over all threads of a body.
#if LANES > 1
typedef double of_lane;
DEVICE inline void sum_over_lanes(double* values, int n, SHARED_ARG shared) {
    for (int k = 0; k < n; k++) {
        shared[LANE_ID] = values[k];
        SYNC_THREADS
        for (int width = LANES/2; width > 0; width /= 2) {
            if (LANE_ID < width)
                shared[LANE_ID] += shared[LANE_ID+width];
            SYNC_THREADS
        }
        values[k] = shared[0];
        SYNC_THREADS
    }
}
#else
typedef fine of_lane;
#define sum_over_lanes(values, n, shared)
#endif

// The indices of a body in the tables: its particles, sites, masses and constants, from the row of its kind.
typedef struct {
    int sites, atom, atom_stride, site, site_stride, mass, constants;
} Place;

DEVICE inline Place place_of(int i, GLOBAL const int* kind, GLOBAL const int* kinds) {
    GLOBAL const int* row = kinds+KIND_COLUMNS*kind[i];
    const int within = i-row[0], own = row[6] ? within : 0;
    Place p;
    p.sites = SITES;
    p.atom = row[3]+within;
    p.atom_stride = row[1];
    p.site = row[4]+own;
    p.site_stride = row[6] ? row[1] : 1;
    p.mass = row[5];
    p.constants = row[7]+own;
    return p;
}

// Rotate a site from the body frame to space by a rotation matrix, and add a cross product.
#define TURN_SITE(Q, site, r) \
    EACH(k, 3) \
        r[k] = Q[3*k]*site[0]+Q[3*k+1]*site[1]+Q[3*k+2]*site[2];
#define ADD_CROSS(sum, a, b) \
    sum[0] += a[1]*b[2]-a[2]*b[1]; sum[1] += a[2]*b[0]-a[0]*b[2]; sum[2] += a[0]*b[1]-a[1]*b[0];
// Rotate a vector from space to the body frame. Components about axes without a moment of inertia become zero.
#define TURN_BACK(Q, inverse_inertia, v, u) \
    EACH(k, 3) \
        u[k] = inverse_inertia[k] == 0.0 ? 0 : Q[k]*v[0]+Q[3+k]*v[1]+Q[6+k]*v[2];

// Compute the displacement e F/M of a body, and its orientation after a rotation by the vector e T/I.
DEVICE inline void displaced(const Body* body, fine e, const fine* F, const fine* T, fine* arm, number* q) {
    fine v[3];
    EACH(k, 3) {
        arm[k] = e*F[k]*REAL(body->inverse_mass);
        v[k] = e*T[k]*REAL(body->inverse_inertia[k]);
    }
    EACH(k, 4)
        q[k] = body->q[k];
    turn_by(q, v);
}

DEVICE inline void load_state(Body* body, int i, GLOBAL const number* R, GLOBAL const number* P, GLOBAL const number* q, GLOBAL const number* L) {
    EACH(k, 3) {
        body->R[k] = R[k*BODIES+i]; body->P[k] = P[k*BODIES+i]; body->L[k] = L[k*BODIES+i];
    }
    EACH(k, 4)
        body->q[k] = q[k*BODIES+i];
}

DEVICE inline void load_body(Body* body, int i, GLOBAL const number* R, GLOBAL const number* P, GLOBAL const number* q,
        GLOBAL const number* L, GLOBAL const double* constants) {
    load_state(body, i, R, P, q, L);
    EACH(k, 3) {
        body->F[k] = body->T[k] = 0.0;
        body->inverse_inertia[k] = constants[4+k];
    }
    body->inverse_mass = constants[7];
    body->constants = constants;
}

// Store the momenta of a body, and its position and orientation if it has moved.
DEVICE inline void store_body(const Body* body, int i, GLOBAL number* R, GLOBAL number* P, GLOBAL number* q, GLOBAL number* L, int what) {
    EACH(k, 3) {
        P[k*BODIES+i] = body->P[k]; L[k*BODIES+i] = body->L[k];
    }
    if (what & MOVES_PARTICLES) {
        EACH(k, 3)
            R[k*BODIES+i] = body->R[k];
        EACH(k, 4)
            q[k*BODIES+i] = body->q[k];
    }
}

#define CONTEXT GLOBAL real4* posq, GLOBAL real4* posqCorrection, GLOBAL mixed4* velm, GLOBAL const int4* places, GLOBAL const double* box
#define TABLES GLOBAL const int* kind, GLOBAL const int* kinds, GLOBAL const int* atoms, GLOBAL const double* sites, \
    GLOBAL const double* masses, GLOBAL const double* constants
#define STATE GLOBAL number* R_, GLOBAL number* P_, GLOBAL number* q_, GLOBAL number* L_
