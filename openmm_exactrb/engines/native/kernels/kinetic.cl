// Sum the kinetic energies of translation and of rotation, the number of invalid bodies, which have a non-finite state or
// are faster than light, and the heat, which begins again at zero.

KERNEL void kinetic(GLOBAL const int* kind, GLOBAL const int* kinds, GLOBAL const double* constants, STATE, GLOBAL double* heat, GLOBAL double* sums) {
    LOCAL double shared[SUMS*BLOCK];
    double mine[SUMS] = {0.0, 0.0, 0.0, 0.0};
    for (OF_THREAD(i, BODIES)) {
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
        if (HEAT >= 0) {
            mine[3] += heat[i];
            heat[i] = 0.0;
        }
    }
    write_sums(mine, shared, sums);
}
