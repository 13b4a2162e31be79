// The kernels of flexible molecules for processors.
#include "several.h"
#define FINE double
#define FINES several
#define EXACTS several
#define ON(a, f, u) force_on(a, (f)*u##0, (f)*u##1, (f)*u##2)
#define ADD_TWO(a, f, u, b, g, v) add({ON(a, f, u), ON(b, g, v)}, sums);
#define ADD_THREE(a, f, u, b, g, v, c, h, w) add({ON(a, f, u), ON(b, g, v), ON(c, h, w)}, sums);
#define ADD_FOUR(a, f, u, b, g, v, c, h, w, d, i, x) add({ON(a, f, u), ON(b, g, v), ON(c, h, w), ON(d, i, x)}, sums);
#define DISTANCE(a, b, e) (coordinates(xs, a, e)-coordinates(xs, b, e))

namespace exactrb {
namespace {

// Atoms for which a further thread is used.
const int ATOMS_OF_THREAD = 256;

struct Flexible : Thread {
    int BLOCKS, HARMONICS, PLACES_OF_BLOCK, OWN_OF_BLOCK, PATCHES, GRAPHS, ALL_ATOMS, MEMORY, PER_STEP, DIFFERENCES, DIFFERENCES_PER_STEP;
    int KEEPS_DIFFERENCES, GRADIENTS, SCALES, HEAT;
    int BONDS, ANGLES, TORSIONS, PAIRS, IMPROPERS, MAPS;
    int MEMBERS_OF_BONDS, MEMBERS_OF_ANGLES, MEMBERS_OF_TORSIONS, MEMBERS_OF_PAIRS, MEMBERS_OF_IMPROPERS, MEMBERS_OF_MAPS;
    int NUMBERS_OF_BONDS, NUMBERS_OF_ANGLES, NUMBERS_OF_TORSIONS, NUMBERS_OF_PAIRS, NUMBERS_OF_IMPROPERS, NUMBERS_OF_MAPS;
    double STILL, LIGHT;
    explicit Flexible(const Constants& constants) {
#define TAKE(name) name = integer(constants, #name);
        TAKE(BLOCKS) TAKE(HARMONICS) TAKE(PLACES_OF_BLOCK) TAKE(OWN_OF_BLOCK) TAKE(PATCHES) TAKE(GRAPHS)
        TAKE(ALL_ATOMS) TAKE(MEMORY) TAKE(PER_STEP) TAKE(DIFFERENCES) TAKE(DIFFERENCES_PER_STEP) TAKE(KEEPS_DIFFERENCES) TAKE(GRADIENTS) TAKE(SCALES) TAKE(HEAT)
#define TAKE_KIND(name) TAKE(name) TAKE(MEMBERS_OF_##name) TAKE(NUMBERS_OF_##name)
        TAKE_KIND(BONDS) TAKE_KIND(ANGLES) TAKE_KIND(TORSIONS) TAKE_KIND(PAIRS) TAKE_KIND(IMPROPERS) TAKE_KIND(MAPS)
        STILL = exactrb::real(constants, "STILL"), LIGHT = exactrb::real(constants, "LIGHT");
    }
    std::vector<number> room_of_xs;
    std::vector<double> room_of_sums, room_of_clusters;

    typedef double term_sum;
#define OF_SUM(sum) (sum)
#include "../kernels/random.cl"
#include "../kernels/layout.cl"
#define ORDERS 12
#define GRAPH_ORDERS 30
#define SETTLED 1e-16
#define SHORTEST (1.0/4096)
#include "../kernels/pair.cl"
    // Larger stars have a struct for each number of constraints.
    template <int RAYS> struct Star {
#include "../kernels/star.cl"
    };
    void move_star(bool idle, double t, const int* cluster, int at, const double* inverse_masses, const double* lengths, bool relaxes, const double* before,
            const double* after, double* heat, number* xs, number* v) {
        if (idle || cluster[GRAPH] >= 0)
            return;
        const int first = cluster[FIRST_ATOM];
        switch (cluster[ATOMS_OF_CLUSTER]) {
        case 1:
            for (int e = 0; e < 3; e++)
                xs[3*at+e] += t*v[3*first+e];
            break;
        case 2:
            move_pair(t, cluster, at, inverse_masses, lengths, relaxes, before, after, heat, xs, v);
            break;
        case 3:
            Star<2>().move_star(idle, t, cluster, at, inverse_masses, lengths, relaxes, before, after, heat, xs, v);
            break;
        case 4:
            Star<3>().move_star(idle, t, cluster, at, inverse_masses, lengths, relaxes, before, after, heat, xs, v);
            break;
        default:
            Star<4>().move_star(idle, t, cluster, at, inverse_masses, lengths, relaxes, before, after, heat, xs, v);
        }
    }
#include "../kernels/graph.cl"
#include "../kernels/bonded.cl"
#include "../kernels/inner.cl"
#include "../kernels/sums.cl"
#include "../kernels/flexible_updates.cl"

    static Function function(KernelsOf<Flexible>& of, const std::string& name) {
        if (name == "inner_steps")
            return of.together(&Flexible::inner_steps, std::min(of.first().BLOCKS, of.first().ALL_ATOMS/ATOMS_OF_THREAD));
        if (name == "flexible_kinetic")
            return of.alone(&Flexible::flexible_kinetic);
        if (name == "total")
            return of.alone(&Flexible::total);
        if (name == "flexible_pushed")
            return of.alone(&Flexible::flexible_pushed);
        if (name == "flexible_moved")
            return of.alone(&Flexible::flexible_moved);
        return Function();
    }
};

} // namespace

std::unique_ptr<Kernels> flexibleKernels(const Constants& constants, OpenMM::ThreadPool* threads) {
    return std::unique_ptr<Kernels>(new KernelsOf<Flexible>(constants, threads));
}

} // namespace exactrb
