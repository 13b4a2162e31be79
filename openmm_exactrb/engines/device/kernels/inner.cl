// Inner steps of flexible molecules. A block of threads has the atoms of some clusters, and beside them those with which
// they have terms in common. It evaluates all terms that touch its own atoms, so that terms across a border are
// evaluated in both blocks; kicks its atoms, exchanges heat, and lets its clusters move along their constraints.
//
// What happens is in rows of the table of moves, up to a drift: kicks by the fast forces and by the slow ones, which are
// all forces, as OpenMM has them, less the fast ones, and heat exchanges. A launch makes all moves of a segment if no
// block has terms with atoms of another one. Else it makes one drift, and positions go to another array, so that no
// block reads what a neighbour has written.

#define OF_KIND(kind, all) {row[FIRST_TERMS+2*kind], row[FIRST_TERMS+2*kind+1], all}
#define OF_BLOCK xs, sums, &broken, own
#define OP(k) moves[MOVE_ROW*(k)]
#define FIRST_NUMBER(k) numbers[moves[MOVE_ROW*(k)+2]]

// Kick an atom and exchange its heat: the moves from `first` to `last`.
DEVICE inline void move_atom(int atom, int first, int last, GLOBAL const int* moves, GLOBAL const double* numbers, LOCAL_ARG const mm_ulong* sum,
        GLOBAL const mm_long* force, int slot, int body, double inverse, double key, mm_long step, GLOBAL double* v) {
    const double unit = inverse*(1.0/FIXED_POINT);
    double V[3], fast[3], n[4];
    for (int e = 0; e < 3; e++) {
        V[e] = v[3*atom+e];
        fast[e] = unit*(double) (mm_long) sum[e];
    }
    for (int k = first; k < last; k++) {
        GLOBAL const double* number = &FIRST_NUMBER(k);
        switch (OP(k)) {
        case FAST_KICK:
            for (int e = 0; e < 3; e++)
                V[e] += number[0]*fast[e];
            break;
        case KICK:
            for (int e = 0; e < 3; e++)
                V[e] += number[0]*(unit*(double) force[slot+e*PADDED_NUM_ATOMS]-fast[e]);
            break;
        case EXCHANGE: {
            const int which = moves[MOVE_ROW*k+1];
            normals(key, step+(which>>16), PURPOSES*(which&0xffff), body, n);
            for (int e = 0; e < 3; e++)
                V[e] += number[FADE]*V[e]+number[SPREAD]*sqrt(inverse)*n[e];
            break;
        }
        }
    }
    for (int e = 0; e < 3; e++)
        v[3*atom+e] = V[e];
}

// Let a cluster of a block move for a time t, of which its first atom has the place `at` in the block.
DEVICE inline void drift(GLOBAL const int* cluster, int at, double t, GLOBAL const double* inverse, GLOBAL const double* lengths,
        GLOBAL const int* ends, GLOBAL double* room, LOCAL_ARG double* xs, GLOBAL double* v) {
    const int first = cluster[FIRST_ATOM], atoms = cluster[ATOMS_OF_CLUSTER];
#if GRAPHS > 0
    if (cluster[GRAPH] >= 0) {
        move_graph(t, cluster, at, inverse, lengths, ends, room, xs, v);
        return;
    }
#endif
    double X[STAR][3], V[STAR][3], w[STAR], length[STAR];
    for (int i = 0; i < atoms; i++) {
        w[i] = inverse[first+i];
        length[i] = lengths[first+i];
        for (int e = 0; e < 3; e++) {
            X[i][e] = xs[3*(at+i)+e];
            V[i][e] = v[3*(first+i)+e];
        }
    }
    switch (atoms) {
    case 1:
        for (int e = 0; e < 3; e++)
            X[0][e] += t*V[0][e];
        break;
    MOVE_STARS
    }
    for (int i = 0; i < atoms; i++)
        for (int e = 0; e < 3; e++) {
            xs[3*(at+i)+e] = X[i][e];
            v[3*(first+i)+e] = V[i][e];
        }
}

KERNEL void inner_steps(GLOBAL const double* x, GLOBAL double* y, GLOBAL double* v, GLOBAL real4* posq, GLOBAL real4* posqCorrection,
        GLOBAL mixed4* velm, GLOBAL const mm_long* force, GLOBAL const int* slots, GLOBAL const double* box, GLOBAL const int* atoms,
        GLOBAL const int* bodies, GLOBAL const double* inverse, GLOBAL const int* blocks, GLOBAL const int* block_atoms, GLOBAL const int* clusters,
        GLOBAL const double* lengths, GLOBAL const int* ends, GLOBAL double* room, GLOBAL const int* members, GLOBAL const fine* constants,
        GLOBAL const fine* patches, GLOBAL const int* moves, GLOBAL const double* numbers, double first_move, double count, double shows, double key,
        mm_long step) {
    LOCAL double xs[3*PLACES_OF_BLOCK];
    LOCAL mm_ulong sums[3*OWN_OF_BLOCK];
    LOCAL int broken;
    for (int block = GROUP_ID; block < BLOCKS; block += GLOBAL_SIZE/LOCAL_SIZE) {
        GLOBAL const int* row = blocks+BLOCK_ROW*block;
        const int own = row[OWN], first_atom = block_atoms[row[FIRST_PLACE]], end = (int) (first_move+count);
        for (int i = LOCAL_ID; i < 3*row[PLACES]; i += LOCAL_SIZE)
            xs[i] = x[3*block_atoms[row[FIRST_PLACE]+i/3]+i%3];
        for (int begin = (int) first_move, drifts = begin; begin < end; begin = drifts+1) {
            bool kicks = false;
            for (drifts = begin; drifts < end && OP(drifts) != DRIFT; drifts++)
                kicks = kicks || OP(drifts) == FAST_KICK || OP(drifts) == KICK;
            for (int i = LOCAL_ID; i < 3*own; i += LOCAL_SIZE)
                sums[i] = 0;
            if (LOCAL_ID == 0)
                broken = 0;
            SYNC_THREADS
            if (kicks) {
                const Terms bonds = OF_KIND(0, BONDS), angles = OF_KIND(1, ANGLES), torsions = OF_KIND(2, TORSIONS), pairs = OF_KIND(3, PAIRS);
                const Terms impropers = OF_KIND(4, IMPROPERS), maps = OF_KIND(5, MAPS);
                add_bonds(OF_BLOCK, bonds, members+MEMBERS_OF_BONDS, constants+NUMBERS_OF_BONDS);
                add_angles(OF_BLOCK, angles, members+MEMBERS_OF_ANGLES, constants+NUMBERS_OF_ANGLES);
                add_torsions(OF_BLOCK, torsions, members+MEMBERS_OF_TORSIONS, constants+NUMBERS_OF_TORSIONS);
                add_pairs(OF_BLOCK, pairs, members+MEMBERS_OF_PAIRS, constants+NUMBERS_OF_PAIRS);
                add_impropers(OF_BLOCK, impropers, members+MEMBERS_OF_IMPROPERS, constants+NUMBERS_OF_IMPROPERS);
                add_maps(OF_BLOCK, maps, members+MEMBERS_OF_MAPS, constants, patches);
                SYNC_THREADS
            }
            for (int i = LOCAL_ID; i < own; i += LOCAL_SIZE) {
                const int atom = first_atom+i;
                move_atom(atom, begin, drifts, moves, numbers, sums+3*i, force, slots[atoms[atom]], bodies[atom], inverse[atom], key, step, v);
            }
            SYNC_THREADS
            if (drifts < end || shows > 1.0) {
                const double t = drifts < end ? FIRST_NUMBER(drifts) : 0.0;
                for (int c = LOCAL_ID; c < row[CLUSTERS]; c += LOCAL_SIZE) {
                    GLOBAL const int* cluster = clusters+CLUSTER_ROW*(row[FIRST_CLUSTER]+c);
                    drift(cluster, cluster[FIRST_ATOM]-first_atom, t, inverse, lengths, ends, room, xs, v);
                }
            }
            SYNC_THREADS
            if (broken)
                for (int i = LOCAL_ID; i < own; i += LOCAL_SIZE)
                    v[3*(first_atom+i)] = xs[3*i] = NOT_A_NUMBER;
        }
        for (int i = LOCAL_ID; i < own; i += LOCAL_SIZE) {
            const int atom = first_atom+i, slot = slots[atoms[atom]];
            double X[3] = {xs[3*i], xs[3*i+1], xs[3*i+2]};
            if (shows > 0.0) {
                follow_image(READ(slot), box, X);
                WRITE(slot, X[0], X[1], X[2])
            }
            if (shows > 1.0)
                velm[slot] = make_mixed4(v[3*atom], v[3*atom+1], v[3*atom+2], inverse[atom]);
            for (int e = 0; e < 3; e++)
                y[3*atom+e] = X[e];
        }
        SYNC_THREADS
    }
}
