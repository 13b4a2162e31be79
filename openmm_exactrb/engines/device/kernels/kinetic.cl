// Kinetic energies of translation and of rotation, and how many bodies have no finite state or are faster than light.

KERNEL void kinetic(GLOBAL const int* kind, GLOBAL const int* kinds, GLOBAL const double* constants, STATE, GLOBAL double* sums) {
    LOCAL double shared[3*BLOCK];
    double mine[3] = {0.0, 0.0, 0.0};
    for (int i = GLOBAL_ID; i < BODIES; i += GLOBAL_SIZE) {
        const Place at = place_of(i, kind, kinds);
        Body body;
        load_body(&body, i, R_, P_, q_, L_, constants+CONSTANTS*at.constants);
        double P = 0.0, L = 0.0, x = 0.0;
        for (int k = 0; k < 3; k++) {
            P += body.P[k]*body.P[k]*body.inverse_mass;
            L += body.L[k]*body.L[k]*body.inverse_inertia[k];
            x += body.R[k]*body.R[k]+body.q[k]*body.q[k];
        }
        x += body.q[3]*body.q[3];
        mine[0] += 0.5*P;
        mine[1] += 0.5*L;
        if (!(P*body.inverse_mass <= LIGHT*LIGHT && L < 1e300 && x < 1e300))
            mine[2] += 1.0;
    }
    for (int k = 0; k < 3; k++)
        shared[k*BLOCK+LOCAL_ID] = mine[k];
    SYNC_THREADS
    for (int width = BLOCK/2; width > 0; width /= 2) {
        if (LOCAL_ID < width)
            for (int k = 0; k < 3; k++)
                shared[k*BLOCK+LOCAL_ID] += shared[k*BLOCK+LOCAL_ID+width];
        SYNC_THREADS
    }
    if (LOCAL_ID == 0)
        for (int k = 0; k < 3; k++)
            sums[3*GROUP_ID+k] = shared[k*BLOCK];
}

// The sums of all groups of threads of a part, in one block: added to those of other parts, or in their place.
KERNEL void total(GLOBAL const double* sums, GLOBAL double* totals, int adds) {
    LOCAL double shared[3*BLOCK];
    for (int k = 0; k < 3; k++) {
        double mine = 0.0;
        for (int g = LOCAL_ID; g < GROUPS; g += LOCAL_SIZE)
            mine += sums[3*g+k];
        shared[k*BLOCK+LOCAL_ID] = mine;
    }
    SYNC_THREADS
    for (int width = BLOCK/2; width > 0; width /= 2) {
        if (LOCAL_ID < width)
            for (int k = 0; k < 3; k++)
                shared[k*BLOCK+LOCAL_ID] += shared[k*BLOCK+LOCAL_ID+width];
        SYNC_THREADS
    }
    if (GROUP_ID == 0 && LOCAL_ID < 3)
        totals[LOCAL_ID] = shared[LOCAL_ID*BLOCK]+(adds ? totals[LOCAL_ID] : 0.0);
}
