// Behind what OpenMM does between steps: its changes of velocities and of positions are those of flexible molecules too.
// What it left alone stays as it was, to the last bit. Then what the host is told.

// Changes of velocities (CMMotionRemover, AndersenThermostat).
KERNEL void flexible_pushed(GLOBAL const mixed4* velm, GLOBAL const int4* places, GLOBAL const int* atoms, GLOBAL double* v) {
    for (int i = GLOBAL_ID; i < ALL_ATOMS; i += GLOBAL_SIZE) {
        const mixed4 now = velm[places[atoms[i]].x];
        v[3*i] += now.x-(mixed) v[3*i];
        v[3*i+1] += now.y-(mixed) v[3*i+1];
        v[3*i+2] += now.z-(mixed) v[3*i+2];
    }
}

// Changes of positions (barostats); atoms without mass may be moved by the user too.
KERNEL void flexible_moved(GLOBAL const real4* posq, GLOBAL const real4* posqCorrection, GLOBAL const int4* places, GLOBAL const double* box,
        GLOBAL const int* atoms, GLOBAL double* x) {
    for (int i = GLOBAL_ID; i < ALL_ATOMS; i += GLOBAL_SIZE) {
        double now[3];
        read_position(posq, posqCorrection, places[atoms[i]], box, now);
        for (int e = 0; e < 3; e++)
            if (fabs(now[e]-x[3*i+e]) > STILL)
                x[3*i+e] = now[e];
    }
}
