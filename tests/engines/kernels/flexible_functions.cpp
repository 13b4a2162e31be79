// Functions of the kernels of flexible molecules, for tests. Arrays are contiguous; a number of the state is a pair of
// double.
#include "flexible.cpp"

using namespace exactrb;

namespace {

number* numbers(double* pairs) {
    return reinterpret_cast<number*>(pairs);
}

} // namespace

extern "C" {

// Advance clusters by a time, or only project the velocities for t = 0. If a heat exchange `relaxes` velocities from `before`
// to `after`, subtract from the heat the part along the constraints.
void move(int clusters, double t, const int* table, const int* graphs, const double* inverse, const double* lengths,
        double* x, double* v, int relaxes, const double* before, const double* after, double* heat) {
    Flexible kernels{Constants()};
    int row[Flexible::BLOCK_ROW] = {};
    row[Flexible::CLUSTERS] = clusters;
    kernels.move_clusters(t, row, 0, table, graphs, inverse, lengths, NULL, relaxes, before, after, heat, numbers(x), numbers(v));
}

// Write the four sums over atoms; `place` is the index of the heat among the numbers of a thermostat, or negative.
void flexible_kinetic(int atoms, int place, const double* inverse, double* x, double* v, double* heat, double* sums) {
    Flexible({{"ALL_ATOMS", std::to_string(atoms)}, {"HEAT", std::to_string(place)}, {"LIGHT", "299792.458"}})
        .flexible_kinetic(inverse, numbers(x), numbers(v), heat, sums);
}

} // extern "C"
