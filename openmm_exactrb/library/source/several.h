// Vectors of numbers, with which a thread of a processor evaluates several terms at once. Elements are independent of each
// other, so that the results of a term do not depend on the terms beside it.
#ifndef EXACTRB_SEVERAL_H_
#define EXACTRB_SEVERAL_H_

#include "dialect.h"
#define ZERO REALS()

namespace exactrb {
namespace {

#if defined(__GNUC__)
#define AT_ONCE 4
#define LANE(x, l) (x)[l]
typedef double several __attribute__((vector_size(8*AT_ONCE)));

inline several sqrt(several x) {
    EACH(l, AT_ONCE)
        x[l] = std::sqrt(x[l]);
    return x;
}

inline several fabs(several x) {
    EACH(l, AT_ONCE)
        x[l] = std::fabs(x[l]);
    return x;
}

inline several fmax(several a, several b) {
    EACH(l, AT_ONCE)
        a[l] = fmax(a[l], b[l]);
    return a;
}

// Whether a comparison holds for all elements.
template <class Mask> inline bool all_of(Mask condition) {
    bool all = true;
    EACH(l, AT_ONCE)
        all &= condition[l] != 0;
    return all;
}
#else
#define AT_ONCE 1
#define LANE(x, l) (x)
typedef double several;
#endif

// An atom of each of several terms from term t on, which repeat the last term.
struct Atoms {
    int of[AT_ONCE];
};

inline Atoms atoms_of(const int* column, int t, int last) {
    Atoms a;
    EACH(l, AT_ONCE)
        a.of[l] = column[std::min(t+l, last-1)];
    return a;
}

inline several numbers_of(const double* column, int t, int last) {
    several x;
    EACH(l, AT_ONCE)
        LANE(x, l) = column[std::min(t+l, last-1)];
    return x;
}

// Numbers to which forces are proportional, and zero for repeated terms.
inline several strengths_of(const double* column, int t, int last) {
    several x = {};
    for (int l = 0; l < std::min(AT_ONCE, last-t); l++)
        LANE(x, l) = column[t+l];
    return x;
}

inline several coordinates(const number* xs, const Atoms& a, int e) {
    several x;
    EACH(l, AT_ONCE)
        LANE(x, l) = xs[3*a.of[l]+e].high;
    return x;
}

inline double coordinates(const number* xs, int a, int e) {
    return xs[3*a+e].high;
}

// The force of a term on an atom, or the forces of several terms.
template <class A, class N> struct Force {
    A on;
    N x, y, z;
};
template <class A, class N> inline Force<A, N> force_on(const A& a, const N& x, const N& y, const N& z) {
    return Force<A, N>{a, x, y, z};
}

inline void add(double x, double y, double z, double* sum) {
    sum[0] += x;
    sum[1] += y;
    sum[2] += z;
}

// Add forces to the sums of atoms, term by term.
template <int COUNT> void add(const Force<Atoms, several> (&forces)[COUNT], double* sums) {
    EACH(l, AT_ONCE)
        for (const auto& f : forces)
            add(LANE(f.x, l), LANE(f.y, l), LANE(f.z, l), sums+3*f.on.of[l]);
}
template <int COUNT> void add(const Force<int, double> (&forces)[COUNT], double* sums) {
    for (const auto& f : forces)
        add(f.x, f.y, f.z, sums+3*f.on);
}

} // namespace
} // namespace exactrb
#endif
