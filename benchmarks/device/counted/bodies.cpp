// Operations in double precision of a segment of a water: a kick, half of a drift, a heat exchange and half of a drift. The arguments
// are the step in ps and the numbers of a heat exchange.
#include "counted.h"
#include "constants.h"
#define BODIES 1
#define LANES 1
#define SITES 3
#define OWN_MOVES
#include "engines/native/kernels/precision.cl"
#include "random/random.cl"
#include "engines/native/kernels/context.cl"
#include "rotors/nodes.cl"
#include "rotors/rotation.cl"
#include "engines/native/kernels/body.cl"
#include "engines/native/kernels/rigid.cl"
#undef double
#include <cstdlib>
#include <vector>

static std::vector<Double> read(std::FILE* file) {
    int n;
    std::vector<Double> numbers;
    if (std::fscanf(file, "%d", &n) == 1)
        for (double x; n > 0 && std::fscanf(file, "%lf", &x) == 1; n--)
            numbers.push_back(Double(x));
    return numbers;
}

// Read the constants, sites and state of a body, forces, and the numbers of the moves; write the operations of each move and of the segment.
int main() {
    std::vector<Double> constants = read(stdin), sites = read(stdin), R = read(stdin), P = read(stdin), q = read(stdin), L = read(stdin), f = read(stdin), numbers = read(stdin);
    int kind[1] = {0}, kinds[8] = {0, 1, 3, 0, 0, 0, 0, 0}, atoms[3] = {0, 1, 2}, index[2] = {0, 0};
    int4 places[3] = {{0, 0, 0, 0}, {1, 0, 0, 0}, {2, 0, 0, 0}};
    Double box[9] = {Double(3.0)}, masses[3], last[6], differences[6], here[6], exchanged[12], heat[1] = {Double(0.0)}, factors[2];
    mm_long force[12] = {};
    for (int s = 0; s < 3; s++)
        for (int e = 0; e < 3; e++)
            force[s+4*e] = (mm_long) (f[3*s+e].v*4294967296.0);
    real4 posq[4], correction[4];
    mixed4 velm[4];
    const int moves[] = {KICK, 0, 0, 1, DRIFT, 0, 1, 1, EXCHANGE, 0, 2, 9, DRIFT, 0, 1, 1};
    auto count = [&](const char* name, int first, int n, int what) {
        counts = Counts();
        segment(posq, correction, velm, places, box, force, kind, kinds, atoms, sites.data(), masses, constants.data(), R.data(), P.data(), q.data(), L.data(), index,
            last, differences, here, exchanged, heat, moves, numbers.data(), factors, first, n, what, 1, Double(7.0), Double(0.0));
        std::printf("%s,%ld\n", name, counts.total());
    };
    count("kick", 0, 1, HAS_FORCES);
    count("half drift", 1, 1, 0);
    count("heat exchange", 2, 1, 0);
    count("positions", 0, 0, MOVES_PARTICLES);
    count("segment", 0, 4, HAS_FORCES | MOVES_PARTICLES);
}
