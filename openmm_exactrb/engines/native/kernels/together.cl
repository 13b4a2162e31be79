// The moves of a segment for rigid bodies, in the launch of inner steps: the first blocks of threads move atoms, and each thread
// of the other blocks moves a body.
KERNEL void inner_steps_and_segment(INNER_PARAMETERS, GLOBAL const int* kind, GLOBAL const int* kinds, GLOBAL const int* rigid_atoms, GLOBAL const double* sites,
        GLOBAL const double* masses, GLOBAL const double* rigid_constants, STATE, GLOBAL const int* index, GLOBAL double* last, GLOBAL double* rigid_differences,
        GLOBAL double* rigid_here, GLOBAL double* rigid_exchanged, GLOBAL double* rigid_heat, int rigid_first, int rigid_count, int rigid_what) {
    ROOM_OF_BLOCK
    double shared[1];
    for (OF_GROUP(group, BLOCKS+(int) ((BODIES+LOCAL_SIZE-1)/LOCAL_SIZE)))
        if (group < BLOCKS)
            steps_of_block(group, xs, split, sums, &broken, INNER_ARGUMENTS);
        else {
            const int i = (group-BLOCKS)*LOCAL_SIZE+LOCAL_ID;
            if (i < BODIES)
                segment_of_bodies(i, 1, shared, posq, posqCorrection, velm, places, box, force, kind, kinds, rigid_atoms, sites, masses, rigid_constants, R_, P_, q_, L_,
                    index, last, rigid_differences, rigid_here, rigid_exchanged, rigid_heat, moves, numbers, factors, rigid_first, rigid_count, rigid_what, step, key, turns);
        }
}
