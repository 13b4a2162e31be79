// Functions of the kernels of rigid bodies, of random numbers and of the dialect for processors, for tests. Arrays are
// contiguous; a number of the state is a pair of double.
#include "rigid.cpp"

using namespace exactrb;

namespace {

Rigid<3> kernels{Constants()};

number* numbers(double* pairs) {
    return reinterpret_cast<number*>(pairs);
}

Rigid<0> of_sums(int bodies, int heat) {
    return Rigid<0>({{"BODIES", std::to_string(bodies)}, {"HEAT", std::to_string(heat)}, {"LIGHT", "299792.458"}});
}

} // namespace

extern "C" {

void rotate(int n, const double* t, const double* body, double* q, double* m) {
    for (int i = 0; i < n; i++)
        kernels.rotate(t[i], body+4*i, numbers(q)+4*i, numbers(m)+3*i);
}
// Rotate bodies in groups of at most `together`, as a thread does.
void drift(int n, int together, double t, const double* constants, double* q, double* m) {
    for (int i = 0, count; i < n; i += count) {
        Rigid<3>::Body some[AT_ONCE] = {};
        count = std::min(together, n-i);
        for (int l = 0; l < count; l++) {
            some[l].constants = constants+4*(i+l);
            std::copy_n(numbers(q)+4*(i+l), 4, some[l].q);
            std::copy_n(numbers(m)+3*(i+l), 3, some[l].L);
        }
        kernels.drift(t, some, count);
        for (int l = 0; l < count; l++) {
            std::copy_n(some[l].q, 4, numbers(q)+4*(i+l));
            std::copy_n(some[l].L, 3, numbers(m)+3*(i+l));
        }
    }
}
int bodies_at_once() {
    return AT_ONCE;
}
void turn_by(int n, double* q, const double* v) {
    for (int i = 0; i < n; i++)
        kernels.turn_by(numbers(q)+4*i, v+3*i);
}
void attitude(int n, double* q, double* Q) {
    for (int i = 0; i < n; i++)
        kernels.attitude(numbers(q)+4*i, Q+9*i);
}
void norm_defect(int n, double* q, double* defect) {
    for (int i = 0; i < n; i++)
        defect[i] = kernels.norm_defect(numbers(q)+4*i);
}
void jacobi_short(int n, const double* s, const double* x, const double* z, double* w, double* cn_less, double* dn_less) {
    for (int i = 0; i < n; i++)
        w[i] = kernels.jacobi_short(s[i], x[i], z[i], cn_less+i, dn_less+i);
}
void third_kind_short(int n, const double* w, const double* x, const double* z, const double* b, double* integral) {
    for (int i = 0; i < n; i++)
        integral[i] = kernels.third_kind_short(w[i], x[i], z[i], b[i]);
}
void cosine_and_sine(int n, const double* angle, double* cosine, double* sine) {
    for (int i = 0; i < n; i++)
        kernels.cosine_and_sine(angle[i], cosine+i, sine+i);
}

void philox(int n, const unsigned long long* key, unsigned long long* counter) {
    for (int i = 0; i < n; i++)
        kernels.philox(key[i], counter+4*i);
}
void uniform(int n, const unsigned long long* word, double* number) {
    for (int i = 0; i < n; i++)
        number[i] = kernels.uniform(word[i]);
}
void normals(int n, const long long* key, const long long* step, const int* stream, const int* body, double* out) {
    for (int i = 0; i < n; i++)
        kernels.normals(key[i], step[i], stream[i], body[i], out+4*i);
}

// Write the four sums over bodies; `place` is the index of the heat among the numbers of a thermostat, or negative.
void kinetic(int bodies, int place, const int* kind, const int* kinds, const double* constants, double* R, double* P,
        double* q, double* L, double* heat, double* sums) {
    of_sums(bodies, place).kinetic(kind, kinds, constants, numbers(R), numbers(P), numbers(q), numbers(L), heat, sums);
}
void total(int place, const double* sums, double* totals, double* thermostat, int adds) {
    of_sums(0, place).total(sums, totals, thermostat, adds);
}

void add_to(int n, double* sum, const double* step) {
    for (int i = 0; i < n; i++)
        numbers(sum)[i] += step[i];
}
void take_from(int n, double* sum, const double* step) {
    for (int i = 0; i < n; i++)
        numbers(sum)[i] -= step[i];
}
void difference(int n, double* a, double* b, double* high, double* rest) {
    for (int i = 0; i < n; i++)
        high[i] = apart(numbers(a)[i], numbers(b)[i], rest+i);
}
void defect_of_length(int n, const double* d, const double* r, const double* rest, double* defect) {
    for (int i = 0; i < n; i++)
        defect[i] = half_defect(d[i], r+3*i, rest+3*i);
}
void upper_words(int n, const unsigned long long* a, const unsigned long long* b, unsigned long long* product) {
    for (int i = 0; i < n; i++)
        product[i] = high_product(a[i], b[i]);
}

} // extern "C"
