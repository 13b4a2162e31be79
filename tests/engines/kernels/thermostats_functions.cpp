// Functions of the kernels of thermostats, for tests. Arrays are contiguous.
#include "thermostats.cpp"

using namespace exactrb;

namespace {

Thermostats of_chains(int links, int repetitions, int weights, const char* text) {
    return Thermostats({{"CHAIN", std::to_string(links)}, {"REPETITIONS", std::to_string(repetitions)},
        {"N_WEIGHTS", std::to_string(weights)}, {"WEIGHTS", text}});
}

} // namespace

extern "C" {

void gamma_variates(int n, const long long* key, const long long* step, const int* stream, const double* shape, double* out) {
    Thermostats kernels{Constants()};
    for (int i = 0; i < n; i++)
        out[i] = kernels.gamma_variate(key[i], step[i], stream[i], shape[i]);
}
void scalings(int n, double kinetic, double f, double kT, double elapsed, const long long* key, const long long* step,
        const int* stream, double* out) {
    Thermostats kernels{Constants()};
    for (int i = 0; i < n; i++)
        out[i] = kernels.scaling(kinetic, f, kT, elapsed, key[i], step[i], stream[i]);
}
void rescaling(const double* totals, double* factors, double* own, const int* moves, const double* numbers, int row, int step, double key) {
    Thermostats(Constants()).rescaling(totals, factors, own, moves, numbers, row, step, key);
}

void chain(int links, int repetitions, int weights, const char* text, double* x, double kinetic, double f, double kT,
        double frequency, double tau, double* scale) {
    *scale = of_chains(links, repetitions, weights, text).chain(x, kinetic, f, kT, frequency, tau);
}
void nose_hoover(int links, int repetitions, int weights, const char* text, const double* totals, double* factors, double* own,
        const int* moves, const double* numbers, int row) {
    of_chains(links, repetitions, weights, text).nose_hoover(totals, factors, own, moves, numbers, row, 0, 0.0);
}

} // extern "C"
