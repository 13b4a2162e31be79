// The kernels of flexible molecules for processors.
#include "stars.h"
#define FINES several
#define EXACTS several
#define ON(a, f, u) force_on(a, (f)*u##0, (f)*u##1, (f)*u##2)
#define ADD_TWO(a, f, u, b, g, v) add({ON(a, f, u), ON(b, g, v)}, sums);
#define ADD_THREE(a, f, u, b, g, v, c, h, w) add({ON(a, f, u), ON(b, g, v), ON(c, h, w)}, sums);
#define ADD_FOUR(a, f, u, b, g, v, c, h, w, d, i, x) add({ON(a, f, u), ON(b, g, v), ON(c, h, w), ON(d, i, x)}, sums);
#define POSITIONS const number* xs
#define POSITIONS_OF_BLOCK xs
#define SPLIT_POSITIONS fine* const split = NULL;
#define split_positions(places, xs)
#define DISTANCE(a, b, e) (coordinates(xs, a, e)-coordinates(xs, b, e))
#define EXACT_DISTANCE DISTANCE
#define DERIVATIVE(kind, v) derivative(force, v, t, terms, numbers, customs, values, parameters)

namespace exactrb {
namespace {

// Atoms for which a further thread is used.
const int ATOMS_OF_THREAD = 256;

struct Flexible : Thread {
    int BLOCKS, HARMONICS, PLACES_OF_BLOCK, OWN_OF_BLOCK, PATCHES, GRAPHS, ALL_ATOMS, MEMORY, PER_STEP, DIFFERENCES, DIFFERENCES_PER_STEP;
    int KEEPS_DIFFERENCES, GRADIENTS, SCALES, HEAT;
    int BONDS, ANGLES, TORSIONS, PAIRS, IMPROPERS, MAPS;
    int CUSTOMS, STARTS_OF_CUSTOMS, STEPS_OF_CUSTOMS;
    int MEMBERS_OF_BONDS, MEMBERS_OF_ANGLES, MEMBERS_OF_TORSIONS, MEMBERS_OF_PAIRS, MEMBERS_OF_IMPROPERS, MEMBERS_OF_MAPS;
    int NUMBERS_OF_BONDS, NUMBERS_OF_ANGLES, NUMBERS_OF_TORSIONS, NUMBERS_OF_PAIRS, NUMBERS_OF_IMPROPERS, NUMBERS_OF_MAPS;
    double STILL, LIGHT;
    explicit Flexible(const Constants& constants) {
#define TAKE(name) name = integer(constants, #name);
        TAKE(CUSTOMS) TAKE(STARTS_OF_CUSTOMS) TAKE(STEPS_OF_CUSTOMS)
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
#include "random/random.cl"
#include "engines/native/kernels/layout.cl"
#include "constraints/pair.cl"
    // Larger stars have a struct for each number of constraints, for a single star and for several stars.
    template <int RAYS, class REALS, class INDICES, bool SEVERAL> struct Star {
        typedef number_of<REALS> NUMBERS;
#include "constraints/star.cl"
    };
#include "constraints/graph.cl"
    // Advance stars with the same number of constraints, from the first row of a table on.
    template <int RAYS> void move_stars(int stars, double t, const int* cluster, int first_atom, const double* inverse, const double* lengths, bool relaxes,
            const double* before, const double* after, double* heat, number* xs, number* v) {
        Atoms first, at;
        EACH(l, AT_ONCE) {
            first.of[l] = cluster[CLUSTER_ROW*std::min(l, stars-1)+FIRST_ATOM];
            at.of[l] = first.of[l]-first_atom;
        }
        if (stars > 1 && Star<RAYS, several, Atoms, true>().move_star(false, t, first, at, RAYS+1, inverse, lengths, relaxes, before, after, heat, xs, v))
            return;
        for (int l = 0; l < stars; l++)
            Star<RAYS, double, int, false>().move_star(false, t, first.of[l], at.of[l], RAYS+1, inverse, lengths, relaxes, before, after, heat, xs, v);
    }
    // Advance the clusters of a block by t.
    void move_clusters(double t, const int* row, int first_atom, const int* clusters, const int* graphs, const double* inverse, const double* lengths, double* room,
            bool relaxes, const double* before, const double* after, double* heat, number* xs, number* v) {
        for (int c = 0, stars; c < row[CLUSTERS]; c += stars) {
            const int *cluster = clusters+CLUSTER_ROW*(row[FIRST_CLUSTER]+c), first = cluster[FIRST_ATOM], at = first-first_atom, atoms = cluster[ATOMS_OF_CLUSTER];
            auto is_another = [&](const int* other) { return other[GRAPH] < 0 && other[ATOMS_OF_CLUSTER] == atoms; };
            stars = 1;
            if (cluster[GRAPH] >= 0)
                move_graph(t, cluster, at, graphs, inverse, lengths, room, relaxes, before, after, heat, xs, v);
            else if (atoms == 1)
                for (int e = 0; e < 3; e++)
                    xs[3*at+e] += t*v[3*first+e];
            else if (atoms == 2)
                move_pair(t, cluster, at, inverse, lengths, relaxes, before, after, heat, xs, v);
            else {
                while (stars < AT_ONCE && c+stars < row[CLUSTERS] && is_another(cluster+CLUSTER_ROW*stars))
                    stars++;
                const auto move = atoms == 3 ? &Flexible::move_stars<2> : atoms == 4 ? &Flexible::move_stars<3> : &Flexible::move_stars<4>;
                (this->*move)(stars, t, cluster, first_atom, inverse, lengths, relaxes, before, after, heat, xs, v);
            }
        }
    }
#include "steps.h"
#include "multiple_time_steps/bonded.cl"
#include "multiple_time_steps/inner.cl"
#include "engines/native/kernels/sums.cl"
#include "engines/native/kernels/flexible_updates.cl"

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

// Advance clusters by a time, or only project their velocities for t = 0. The tables are those of
// openmm_exactrb.constraints.tables; positions and velocities (atoms, 3, 2) are numbers with their low parts.
extern "C" EXPORTED void pi_move_clusters(int clusters, double t, const int* table, const int* graphs, const double* inverse, const double* lengths,
        double* x, double* v) {
    using namespace exactrb;
    Flexible kernels{Constants()};
    int row[Flexible::BLOCK_ROW] = {};
    row[Flexible::CLUSTERS] = clusters;
    kernels.move_clusters(t, row, 0, table, graphs, inverse, lengths, NULL, false, NULL, NULL, NULL, reinterpret_cast<number*>(x), reinterpret_cast<number*>(v));
}

// Add the forces of the terms of a kind to the sums of `atoms` atoms. The columns of terms are those of
// openmm_exactrb.multiple_time_steps.terms; positions (atoms, 3, 2) are numbers with their low parts.
extern "C" EXPORTED void pi_add_forces(const char* kind, int terms, int atoms, int harmonics, double* x, const int* members, const double* of_terms,
        const double* patches, double* sums) {
    using namespace exactrb;
    typedef void (Flexible::*Add)(const number*, double*, int*, int, Flexible::Terms, const int*, const double*);
    static const std::map<std::string, Add> kinds = {{"bonds", &Flexible::add_bonds}, {"angles", &Flexible::add_angles},
        {"torsions", &Flexible::add_torsions}, {"pairs", &Flexible::add_pairs}, {"impropers", &Flexible::add_impropers}};
    Flexible kernels{Constants()};
    kernels.HARMONICS = harmonics;
    int broken = 0; // which only devices use, where forces may be too large for a sum
    const Flexible::Terms all = {0, terms, terms};
    const number* const xs = reinterpret_cast<const number*>(x);
    if (std::string(kind) == "maps")
        kernels.add_maps(xs, sums, &broken, atoms, all, members, of_terms, patches);
    else
        (kernels.*kinds.at(kind))(xs, sums, &broken, atoms, all, members, of_terms);
}
