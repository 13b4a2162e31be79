// Sums of four numbers over the threads of a launch, which has at most GROUPS blocks of BLOCK threads: the kinetic energies
// of translation and of rotation, the number of invalid bodies, and the heat since the previous sum.
#define SUMS 4

DEVICE inline void add_up(LOCAL_ARG double* shared) {
    SYNC_THREADS
    for (int width = BLOCK/2; width > 0; width /= 2) {
        if (LOCAL_ID < width)
            for (int k = 0; k < SUMS; k++)
                shared[k*BLOCK+LOCAL_ID] += shared[k*BLOCK+LOCAL_ID+width];
        SYNC_THREADS
    }
}

DEVICE inline void write_sums(const double* mine, LOCAL_ARG double* shared, GLOBAL double* sums) {
    for (int k = 0; k < SUMS; k++)
        shared[k*BLOCK+LOCAL_ID] = mine[k];
    add_up(shared);
    if (LOCAL_ID == 0)
        for (int k = 0; k < SUMS; k++)
            sums[SUMS*GROUP_ID+k] = shared[k*BLOCK];
}

// Sum the results of all blocks of a part of the program. Write the first three to `totals` or, if `adds`, add them, and
// add the heat to the persistent numbers of the thermostat.
KERNEL void total(GLOBAL const double* sums, GLOBAL double* totals, GLOBAL double* thermostat, int adds) {
    LOCAL double shared[SUMS*BLOCK];
    for (int k = 0; k < SUMS; k++) {
        double mine = 0.0;
        for (int g = LOCAL_ID; g < GROUPS; g += LOCAL_SIZE)
            mine += sums[SUMS*g+k];
        shared[k*BLOCK+LOCAL_ID] = mine;
    }
    add_up(shared);
    if (GROUP_ID == 0)
        for (int k = LOCAL_ID; k < 3; k += LOCAL_SIZE)
            totals[k] = shared[k*BLOCK]+(adds ? totals[k] : 0.0);
    if (HEAT >= 0 && GROUP_ID == 0 && LOCAL_ID == 0)
        thermostat[HEAT] += shared[3*BLOCK];
}
