// Operations in double precision of the parts of an inner step: of the thread of one constraint, of a term of each kind, and of an atom.
#include "counted.h"
#include "constants.h"
#define RAYS 1
#define GRAPHS 0
#define ALL_ATOMS 4
#define BLOCKS 1
#define PLACES_OF_BLOCK 4
#define OWN_OF_BLOCK 4
#define CUSTOMS 0
#define HARMONICS 6
#include "engines/native/kernels/precision.cl"
#include "random/random.cl"
#include "engines/native/kernels/context.cl"
#include "engines/native/kernels/layout.cl"
#include "engines/native/kernels/fixed_sums.cl"
#include "constraints/star.cl"
#define OF_CUSTOM_(kind) double derivative_of_##kind(int, double, GLOBAL const double*, int, GLOBAL const double*) { return double(0.0); }
OF_CUSTOM_(bond) OF_CUSTOM_(angle) OF_CUSTOM_(torsion)
#include "multiple_time_steps/bonded.cl"
#define move_graph(...)
#define BONDS 0
#define ANGLES 0
#define TORSIONS 0
#define PAIRS 0
#define IMPROPERS 0
#define MAPS 0
#define MEMBERS_OF_BONDS 0
#define MEMBERS_OF_ANGLES 0
#define MEMBERS_OF_TORSIONS 0
#define MEMBERS_OF_PAIRS 0
#define MEMBERS_OF_IMPROPERS 0
#define MEMBERS_OF_MAPS 0
#define NUMBERS_OF_BONDS 0
#define NUMBERS_OF_ANGLES 0
#define NUMBERS_OF_TORSIONS 0
#define NUMBERS_OF_PAIRS 0
#define NUMBERS_OF_IMPROPERS 0
#define NUMBERS_OF_MAPS 0
#define PATCHES 0
#define STARTS_OF_CUSTOMS 0
#include "multiple_time_steps/inner.cl"
#undef double
#include <random>

static std::mt19937 generator(1);
static double normal() {
    static std::normal_distribution<double> draw;
    return draw(generator);
}

static void show(const char* name, long repetitions) {
    std::printf("%s,%.1f\n", name, (double) counts.total()/repetitions);
    counts = Counts();
}

// The argument is the time of a motion (ps). Stars have one hydrogen of 3 amu, at 300 K.
int main(int, char** arguments) {
    const int times = 200;
    const double t = std::atof(arguments[1]), kT = 2.494, mass[2] = {9.994, 3.024}, r = 0.109;
    for (int i = 0; i < times; i++) {
        Double x[6] = {0.0, 0.0, 0.0, r, 0.0, 0.0}, v[6], inverse[2] = {1.0/mass[0], 1.0/mass[1]}, lengths[2] = {0.0, r}, heat[2];
        for (int k = 0; k < 6; k++)
            v[k] = std::sqrt(kT/mass[k/3])*normal();
        counts = Counts();
        static Counts sum;
        move_star(false, Float(t), 0, 0, 2, inverse, lengths, false, v, v, heat, x, v);
        sum.add += counts.total();
        counts = sum;
    }
    show("thread of a constraint", times);
    Double xs[12];
    Float split[24], number[12];
    term_sum sums[12];
    int broken = 0, members[10] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1};
    const Double places[12] = {1.0, 1.0, 1.0, 1.1, 1.0, 1.0, 1.15, 1.1, 1.0, 1.2, 1.15, 1.1};
    for (int k = 0; k < 12; k++)
        xs[k] = places[k], number[k] = Float(0.3f);
    const Terms one = {0, 1, 1};
    counts = Counts();
    split_positions(4, xs, split);
    show("position", 4);
    add_bonds(xs, split, sums, &broken, 4, one, members, number);
    show("bond", 1);
    add_angles(xs, split, sums, &broken, 4, one, members, number);
    show("angle", 1);
    add_torsions(xs, split, sums, &broken, 4, one, members, number);
    show("torsion", 1);
    add_pairs(xs, split, sums, &broken, 4, one, members, number);
    show("pair", 1);
    add_impropers(xs, split, sums, &broken, 4, one, members, number);
    show("improper", 1);
    mm_long force[12] = {};
    Double numbers[10] = {0.001, -0.1, 0.3, -0.1, 0.3, -0.1, 0.3, -0.1, 0.3, 0.0}, none[12], exchanged[48], heat[4], v[12], factors[2];
    const int kick[] = {FAST_KICK, 0, 0, 1}, both[] = {FAST_KICK, 0, 0, 1, KICK, 0, 0, 1}, exchange[] = {EXCHANGE, 0, 0, 9};
    counts = Counts();
    auto move = [&](const char* name, int n, const int* moves) {
        move_atom(0, 0, n, moves, numbers, xs, sums, force, 0, 0, 1, Float(0.1f), factors, 7, 1, 0, none, none, none, none, exchanged, heat, v);
        show(name, 1);
    };
    move("kick of an atom", 1, kick);
    move("kicks of an atom", 2, both);
    move("heat exchange of an atom", 1, exchange);
}
