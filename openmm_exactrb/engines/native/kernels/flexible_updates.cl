// Transfer OpenMM's changes of velocities and positions between steps to the state of flexible molecules, and compute
// the kinetic energy. Atoms that OpenMM did not change keep their state to the last bit.

// Add changes of the velocities that were shown (CMMotionRemover, AndersenThermostat) to the velocities of a state. If all of
// them are by a CMMotionRemover (`removes`), add the kinetic energy that they supply to the heat.
KERNEL void flexible_pushed(GLOBAL const mixed4* velm, GLOBAL const int4* places, GLOBAL const int* atoms, GLOBAL const double* inverse,
        GLOBAL const number* seen, GLOBAL number* v, GLOBAL double* heat, double removes) {
    for (OF_THREAD(i, ALL_ATOMS)) {
        const mixed4 now = velm[places[atoms[i]].x];
        const double change[3] = {now.x-(mixed) seen[3*i], now.y-(mixed) seen[3*i+1], now.z-(mixed) seen[3*i+2]};
        double gain = 0.0;
        for (int e = 0; e < 3; e++) {
            gain += change[e]*(2.0*seen[3*i+e]+change[e]);
            v[3*i+e] += change[e];
        }
        if (HEAT >= 0 && removes != 0.0 && inverse[i] != 0.0)
            heat[i] += 0.5*gain/inverse[i];
    }
}

// Accept changes of positions, by barostats or, for massless atoms, by the user.
KERNEL void flexible_moved(GLOBAL const real4* posq, GLOBAL const real4* posqCorrection, GLOBAL const int4* places, GLOBAL const double* box,
        GLOBAL const int* atoms, GLOBAL number* x) {
    for (OF_THREAD(i, ALL_ATOMS)) {
        double now[3];
        read_position(posq, posqCorrection, places[atoms[i]], box, now);
        for (int e = 0; e < 3; e++)
            if (fabs(now[e]-x[3*i+e]) > STILL)
                x[3*i+e] = now[e];
    }
}

// Sum the kinetic energy, the number of invalid atoms, which have a non-finite state or are faster than light, and the
// heat, which begins again at zero. The second sum, the kinetic energy of rotation, is zero for atoms.
KERNEL void flexible_kinetic(GLOBAL const double* inverse, GLOBAL const number* x, GLOBAL const number* seen, GLOBAL double* heat, GLOBAL double* sums) {
    LOCAL double shared[SUMS*BLOCK];
    double mine[SUMS] = {0.0, 0.0, 0.0, 0.0};
    for (OF_THREAD(i, ALL_ATOMS)) {
        const double square = seen[3*i]*seen[3*i]+seen[3*i+1]*seen[3*i+1]+seen[3*i+2]*seen[3*i+2];
        if (inverse[i] != 0.0)
            mine[0] += 0.5*square/inverse[i];
        if (!(square <= LIGHT*LIGHT && x[3*i]*x[3*i]+x[3*i+1]*x[3*i+1]+x[3*i+2]*x[3*i+2] < 1e300))
            mine[2] += 1.0;
        if (HEAT >= 0) {
            mine[3] += heat[i];
            heat[i] = 0.0;
        }
    }
    write_sums(mine, shared, sums);
}
