// Sums of three numbers over the threads of a launch, which has at most GROUPS blocks of BLOCK threads.

DEVICE inline void add_up(LOCAL_ARG double* shared) {
    SYNC_THREADS
    for (int width = BLOCK/2; width > 0; width /= 2) {
        if (LOCAL_ID < width)
            for (int k = 0; k < 3; k++)
                shared[k*BLOCK+LOCAL_ID] += shared[k*BLOCK+LOCAL_ID+width];
        SYNC_THREADS
    }
}

DEVICE inline void write_sums(const double* mine, LOCAL_ARG double* shared, GLOBAL double* sums) {
    for (int k = 0; k < 3; k++)
        shared[k*BLOCK+LOCAL_ID] = mine[k];
    add_up(shared);
    if (LOCAL_ID == 0)
        for (int k = 0; k < 3; k++)
            sums[3*GROUP_ID+k] = shared[k*BLOCK];
}

// Sum the results of all blocks of a part of the program, and write them to `totals` or, if `adds`, add them.
KERNEL void total(GLOBAL const double* sums, GLOBAL double* totals, int adds) {
    LOCAL double shared[3*BLOCK];
    for (int k = 0; k < 3; k++) {
        double mine = 0.0;
        for (int g = LOCAL_ID; g < GROUPS; g += LOCAL_SIZE)
            mine += sums[3*g+k];
        shared[k*BLOCK+LOCAL_ID] = mine;
    }
    add_up(shared);
    if (GROUP_ID == 0)
        for (int k = LOCAL_ID; k < 3; k += LOCAL_SIZE)
            totals[k] = shared[k*BLOCK]+(adds ? totals[k] : 0.0);
}
