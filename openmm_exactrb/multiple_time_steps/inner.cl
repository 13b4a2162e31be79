// The moves of flexible molecules between two evaluations of the slow forces. A block of threads owns the atoms of some
// clusters, and also reads the atoms of other blocks that share terms with them. The block evaluates all terms of its
// own atoms, so that a term between two blocks is evaluated in both. It then kicks its atoms, exchanges heat, and
// advances its clusters along their constraints.
//
// The table of moves contains kicks by fast forces, kicks by slow forces, heat exchanges and drifts. The slow forces
// are OpenMM's forces minus the fast forces. If no blocks share terms, a launch performs all moves of a segment.
// Otherwise a launch ends with the first drift, and writes positions to another array, so that no block reads new
// positions of another block.
//
// A force-gradient kick takes two launches with an evaluation of the forces between them. The first ends with a
// displacement: the atoms move from rest along the geodesic of e times the slow force, and the launch writes the new
// positions to a separate array. The second launch reads these positions, and kicks by the slow force there, which it
// projects onto the constraints. `here` contains the slow accelerations before the displacement, and `push` the velocities
// of the displacement and then the projected accelerations. `seen` contains the projected velocities, which are shown.
//
// If the mean kinetic energy of the atoms of a block exceeds `hottest`, the step has diverged, and the state becomes nan.
//
// Heat is the change of the kinetic energy of projected velocities. A heat exchange adds the change for free atoms. The next
// motion of a cluster starts with a projection at the same positions, and subtracts the part along the constraints, for
// successive exchanges at once.

#define OF_MOVE(k, column) moves[MOVE_ROW*(k)+column]
#define TAU(k) numbers[OF_MOVE(k, FIRST_NUMBER)]
#define IS_EXCHANGE(k) (OF_MOVE(k, OP) == EXCHANGE)
// Whether a heat exchange supplies heat by friction and noise.
#define RELAXES(k) (HEAT >= 0 && !SCALES && IS_EXCHANGE(k) && ((&TAU(k))[FADE] != 0.0 || (&TAU(k))[FADE_OF_FLEXIBLE] != 0.0))
#define MOVES_CLUSTERS(op) (op == DRIFT || (GRADIENTS && (op == DISPLACE || op == DISPLACED_KICK)))
#define OF_KIND(kind, all) terms_of_kind(row[FIRST_TERMS+2*kind], row[FIRST_TERMS+2*kind+1], all, &before)
#define OF_BLOCK POSITIONS_OF_BLOCK, sums, broken, own
#define OF_FORCE OF_BLOCK, terms, members+custom[FIRST_MEMBER], exact+custom[FIRST_OF_NUMBERS], force, customs, exact, parameters

// Return the index of stored accelerations, of which `size` are stored in turn.
DEVICE inline int stored(mm_long number, int size) {
    return 3*ALL_ATOMS*(int) ((number+size)%size);
}

// Perform the moves from `first` to `last` - 1 of an atom: kicks, heat exchanges, and the preparation of displacements and
// of kicks at displaced positions.
DEVICE inline void move_atom(int atom, int first, int last, GLOBAL const int* moves, GLOBAL const double* numbers, LOCAL_ARG const number* x, LOCAL_ARG const term_sum* sum,
        GLOBAL const component* force, int slot, int body, int flexible, fine inverse, GLOBAL const double* factors, mm_long key, mm_long step, mm_long turns,
        GLOBAL double* memory, GLOBAL const double* differences, GLOBAL double* here, GLOBAL number* push,
        GLOBAL double* exchanged, GLOBAL double* heat, GLOBAL number* v) {
    const int fade = flexible ? FADE_OF_FLEXIBLE : FADE;
    number V[3];
    fine fast[3], slow[3], n[4];
    read_force(force, slot, slow);
    for (int e = 0; e < 3; e++) {
        V[e] = v[3*atom+e];
        fast[e] = inverse*OF_SUM(sum[e]);
        slow[e] = inverse*slow[e]-fast[e];
    }
    for (int k = first; k < last; k++) {
        GLOBAL const double* of_move = &TAU(k);
        const fine tau = of_move[0];
        const int which = OF_MOVE(k, NUMBER_OF_MOVE) & 0xffff, late = OF_MOVE(k, NUMBER_OF_MOVE)>>16;
        switch (OF_MOVE(k, OP)) {
        case FAST_KICK:
            for (int e = 0; e < 3; e++)
                V[e] += tau*fast[e];
            break;
        case KICK:
            for (int e = 0; e < 3; e++)
                V[e] += tau*slow[e];
            break;
        case EXCHANGE: {
            fine gain = 0;
            if (!SCALES)
                normals(key, step+late, 16*which, body, n);
            for (int e = 0; e < 3; e++) {
                const double before = V[e];
                const fine rate = before, change = SCALES ? REAL(factors[0]-1.0)*rate : REAL(of_move[fade])*rate+REAL(of_move[fade+1])*sqrt(inverse)*n[e];
                V[e] += change;
                gain += change*(2*rate+change);
                EXCHANGED(AT_EXCHANGE, atom)[e] = x[e];
                if (k == first || !IS_EXCHANGE(k-1))
                    EXCHANGED(BEFORE_EXCHANGES, atom)[e] = before;
                EXCHANGED(BEFORE_EXCHANGE, atom)[e] = before;
                EXCHANGED(AFTER_EXCHANGE, atom)[e] = V[e];
            }
            if (HEAT >= 0 && !SCALES && inverse != 0)
                heat[atom] += REAL(0.5)*gain/inverse;
            break;
        }
        case REMEMBER:
            for (int e = 0; e < 3; e++)
                memory[stored(turns*PER_STEP+which, MEMORY)+3*atom+e] = slow[e];
            break;
        case LAST_KICK: // `which` weights of forces, and then weights of differences
            for (int w = 0; w < OF_MOVE(k, NUMBERS_OF_MOVE); w++) {
                GLOBAL const double* from = memory+stored(turns*PER_STEP-1-w, MEMORY);
                if (KEEPS_DIFFERENCES && w >= which)
                    from = differences+stored(turns*DIFFERENCES_PER_STEP-1-(w-which), DIFFERENCES);
                for (int e = 0; e < 3; e++)
                    V[e] += of_move[w]*from[3*atom+e];
            }
            break;
        case DISPLACE:
            for (int e = 0; e < 3; e++) {
                here[3*atom+e] = slow[e];
                push[3*atom+e] = tau*slow[e];
            }
            break;
        case DISPLACED_KICK:
            for (int e = 0; e < 3; e++)
                push[3*atom+e] = slow[e];
            break;
        }
    }
    for (int e = 0; e < 3; e++)
        v[3*atom+e] = V[e];
}

#ifndef PROCESSOR
#define SPLIT_POSITIONS LOCAL fine split[SINGLE ? 2*REST : 1];
#define POSITIONS_OF_BLOCK xs, split
DEVICE inline void split_positions(int places, LOCAL_ARG const number* xs, LOCAL_ARG fine* split) {
    if (SINGLE) {
        for (int i = LOCAL_ID; i < 3*places; i += LOCAL_SIZE) {
            split[i] = xs[i];
            split[REST+i] = xs[i]-split[i];
        }
        SYNC_THREADS
    }
}

// Advance the clusters of a block by t.
DEVICE inline void move_clusters(double t, GLOBAL const int* row, int first_atom, GLOBAL const int* clusters, GLOBAL const int* graphs, GLOBAL const double* inverse,
        GLOBAL const double* lengths, GLOBAL double* room, bool relaxes, GLOBAL const double* before, GLOBAL const double* after, GLOBAL double* heat,
        LOCAL_ARG number* xs, GLOBAL number* v) {
    for (int done = 0; done < row[CLUSTERS]; done += LOCAL_SIZE/TEAM) {
        const int c = done+(int) (LOCAL_ID/TEAM);
        const bool idle = c >= row[CLUSTERS];
        GLOBAL const int* cluster = clusters+CLUSTER_ROW*(row[FIRST_CLUSTER]+(idle ? 0 : c));
        const int first = cluster[FIRST_ATOM], at = first-first_atom;
        const bool star = cluster[GRAPH] < 0;
        move_star(idle || !star, t, first, at, cluster[ATOMS_OF_CLUSTER], inverse, lengths, relaxes, before, after, heat, xs, v);
        if (GRAPHS > 0 && !idle && !star && LOCAL_ID%TEAM == 0)
            move_graph(t, cluster, at, graphs, inverse, lengths, room, relaxes, before, after, heat, xs, v);
    }
}
#endif

#define INNER_PARAMETERS GLOBAL real4* posq, GLOBAL real4* posqCorrection, GLOBAL mixed4* velm, GLOBAL const component* force, \
    GLOBAL const int4* places, GLOBAL const double* box, GLOBAL const number* x, GLOBAL number* y, GLOBAL number* v, \
    GLOBAL double* memory, GLOBAL double* differences, GLOBAL double* here, GLOBAL number* push, GLOBAL number* seen, \
    GLOBAL double* exchanged, GLOBAL double* heat, GLOBAL const int* atoms, GLOBAL const int* bodies, \
    GLOBAL const double* inverse, GLOBAL const int* blocks, GLOBAL const int* block_atoms, GLOBAL const int* clusters, \
    GLOBAL const double* lengths, GLOBAL const int* graphs, GLOBAL double* room, GLOBAL const int* members, \
    GLOBAL const fine* constants, GLOBAL const double* exact, GLOBAL const int* customs, GLOBAL const double* parameters, \
    GLOBAL const int* moves, GLOBAL const double* numbers, GLOBAL const double* factors, int first_move, int count, int what, \
    mm_long step, double key, double turns, double hottest
#define INNER_ARGUMENTS posq, posqCorrection, velm, force, places, box, x, y, v, memory, differences, here, push, seen, \
    exchanged, heat, atoms, bodies, inverse, blocks, block_atoms, clusters, lengths, graphs, room, members, constants, exact, \
    customs, parameters, moves, numbers, factors, first_move, count, what, step, key, turns, hottest
// The room of a block of threads.
#define ROOM_OF_BLOCK \
    LOCAL_ARRAY(number, xs, 3*PLACES_OF_BLOCK); \
    SPLIT_POSITIONS \
    LOCAL_ARRAY(term_sum, sums, 3*OWN_OF_BLOCK); \
    LOCAL int broken;

// Perform the moves of the atoms of a block.
DEVICE inline void steps_of_block(int block, LOCAL_ARG number* xs, LOCAL_ARG fine* split, LOCAL_ARG term_sum* sums, LOCAL_ARG int* broken, INNER_PARAMETERS) {
    const fine most = 2*REAL(fmin(hottest, 1e30));  // twice the largest mean kinetic energy
    GLOBAL const int* row = blocks+BLOCK_ROW*block;
    const int own = row[OWN], first_atom = block_atoms[row[FIRST_PLACE]], end = first_move+count;
    for (int i = LOCAL_ID; i < 3*row[PLACES]; i += LOCAL_SIZE)
        xs[i] = x[3*block_atoms[row[FIRST_PLACE]+i/3]+i%3];
    SYNC_THREADS
    int stop = first_move;
    for (int begin = first_move; begin < end || (begin == first_move && what & PROJECTS); begin = stop < end && IS_EXCHANGE(stop) ? stop : stop+1) {
        bool kicks = false, relaxes = false;
        for (stop = begin; stop < end && !MOVES_CLUSTERS(OF_MOVE(stop, OP)) && !(relaxes && RELAXES(stop) && !IS_EXCHANGE(stop-1)); stop++) {
            kicks = kicks || OF_MOVE(stop, OP) == FAST_KICK || OF_MOVE(stop, OP) == KICK || OF_MOVE(stop, OP) == REMEMBER;
            relaxes = relaxes || RELAXES(stop);
        }
        const int op = stop < end ? OF_MOVE(stop, OP) : DRIFT;
        const bool by_force = op == DISPLACE || op == DISPLACED_KICK;
        for (int i = LOCAL_ID; i < 3*own; i += LOCAL_SIZE)
            sums[i] = 0;
        if (LOCAL_ID == 0)
            *broken = 0;
        SYNC_THREADS
        if (kicks || by_force) {
            split_positions(row[PLACES], POSITIONS_OF_BLOCK);
            int before = 0;
            const Terms bonds = OF_KIND(0, BONDS), angles = OF_KIND(1, ANGLES), torsions = OF_KIND(2, TORSIONS), pairs = OF_KIND(3, PAIRS);
            const Terms impropers = OF_KIND(4, IMPROPERS), maps = OF_KIND(5, MAPS);
            add_bonds(OF_BLOCK, bonds, members+MEMBERS_OF_BONDS, constants+NUMBERS_OF_BONDS);
            add_angles(OF_BLOCK, angles, members+MEMBERS_OF_ANGLES, constants+NUMBERS_OF_ANGLES);
            add_torsions(OF_BLOCK, torsions, members+MEMBERS_OF_TORSIONS, constants+NUMBERS_OF_TORSIONS);
            add_pairs(OF_BLOCK, pairs, members+MEMBERS_OF_PAIRS, constants+NUMBERS_OF_PAIRS);
            add_impropers(OF_BLOCK, impropers, members+MEMBERS_OF_IMPROPERS, constants+NUMBERS_OF_IMPROPERS);
            add_maps(OF_BLOCK, maps, members+MEMBERS_OF_MAPS, exact, exact+PATCHES);
            for (int force = 0; force < CUSTOMS; force++) {
                GLOBAL const int *custom = customs+CUSTOM_ROW*force, *first = customs+STARTS_OF_CUSTOMS+(BLOCKS+1)*force+block;
                const Terms terms = terms_of_kind(first[0], first[1], custom[TERMS_OF_CUSTOM], &before);
                if (custom[ATOMS_OF_TERM] == 2)
                    add_custom_bonds(OF_FORCE);
                else if (custom[ATOMS_OF_TERM] == 3)
                    add_custom_angles(OF_FORCE);
                else
                    add_custom_torsions(OF_FORCE);
            }
            SYNC_THREADS
        }
        for (int i = LOCAL_ID; i < own; i += LOCAL_SIZE) {
            const int atom = first_atom+i;
            move_atom(atom, begin, stop+by_force, moves, numbers, xs+3*i, sums+3*i, force, places[atoms[atom]].x, bodies[atom], bodies[ALL_ATOMS+atom], inverse[atom], factors, (mm_long) key,
                step, (mm_long) turns, memory, differences, here, push, exchanged, heat, v);
            const fine v0 = v[3*atom], v1 = v[3*atom+1], v2 = v[3*atom+2];
            if (!(v0*v0+v1*v1+v2*v2 <= most*own*REAL(inverse[atom])))
                *broken = 1;  // also for nan
        }
        SYNC_THREADS
        // After the last drift, velocities need a projection only if they are read (PROJECTS), or for the heat. The projected
        // velocities are a copy, so that steps do not depend on whether they are read.
        const bool copies = stop == end || op == EXCHANGE;
        if (stop < end || what & PROJECTS || relaxes) {
            const double t = copies || op == DISPLACED_KICK ? 0.0 : op == DISPLACE ? 1.0 : TAU(stop);
            GLOBAL number* rates = by_force ? push : copies ? seen : v;
            if (copies)
                for (int i = 3*first_atom+LOCAL_ID; i < 3*(first_atom+own); i += LOCAL_SIZE)
                    seen[i] = v[i];
            SYNC_THREADS
            move_clusters(t, row, first_atom, clusters, graphs, inverse, lengths, room, relaxes, EXCHANGED(BEFORE_EXCHANGES, 0), EXCHANGED(AFTER_EXCHANGE, 0),
                heat, xs, rates);
        }
        SYNC_THREADS
        if (*broken)
            for (int i = LOCAL_ID; i < own; i += LOCAL_SIZE)
                v[3*(first_atom+i)] = seen[3*(first_atom+i)] = xs[3*i] = NOT_A_NUMBER;
        SYNC_THREADS
        if (*broken) {  // a step that is far too long has thousands of inner steps
            stop = end;
            break;
        }
        if (GRADIENTS && op == DISPLACED_KICK)
            for (int i = 3*first_atom+LOCAL_ID; i < 3*(first_atom+own); i += LOCAL_SIZE) {
                v[i] += TAU(stop)*push[i];
                if (KEEPS_DIFFERENCES)
                    differences[stored((mm_long) turns*DIFFERENCES_PER_STEP+(OF_MOVE(stop, NUMBER_OF_MOVE) & 0xffff), DIFFERENCES)+i] = push[i]-here[i];
            }
        SYNC_THREADS
    }
    if (what & PROJECTS && stop < end)  // after a drift, no projection is needed
        for (int i = 3*first_atom+LOCAL_ID; i < 3*(first_atom+own); i += LOCAL_SIZE)
            seen[i] = v[i];
    SYNC_THREADS
    for (int i = LOCAL_ID; i < own; i += LOCAL_SIZE) {
        const int atom = first_atom+i;
        const int4 place = places[atoms[atom]];
        if (what & PLACES_ATOMS)
            write_position(posq, posqCorrection, place, box, xs[3*i], xs[3*i+1], xs[3*i+2]);
        if (what & SHOWS_ATOMS)
            velm[place.x] = make_mixed4((mixed) seen[3*atom], (mixed) seen[3*atom+1], (mixed) seen[3*atom+2], velm[place.x].w);
        if (what & MOVES_ATOMS)
            for (int e = 0; e < 3; e++)
                y[3*atom+e] = xs[3*i+e];
    }
    SYNC_THREADS
}

KERNEL void inner_steps(INNER_PARAMETERS) {
    ROOM_OF_BLOCK
    for (OF_GROUP(block, BLOCKS))
        steps_of_block(block, xs, split, sums, &broken, INNER_ARGUMENTS);
}
