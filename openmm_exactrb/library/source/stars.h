// What the kernel of stars needs on processors, for a star and for several stars at once.
#ifndef EXACTRB_STARS_H_
#define EXACTRB_STARS_H_

#include "several.h"

#define IF_HELD(c, number, other) (number)
#define NUMBER_AT(array, first, outer) number_at(array, first, outer)
#define VECTOR_AT(array, first, outer, e) vector_at(array, first, outer, e)
#define PUT_AT(array, first, outer, e, number) put_at(array, first, outer, e, number)
#define TAKE_FROM(array, first, number) take_from(array, first, number)

namespace exactrb {
namespace {

// Whether a series has not ended yet, as a factor and as a condition, and the number of its last successive small orders;
// see kernels/star.cl.
inline double is_large(double small) {
    return small < 2.0 ? 1.0 : 0.0;
}

inline bool still_large(double small) {
    return small < 2.0;
}

inline double small_orders(double small, double largest, double bound) {
    return small >= 2.0 ? small : largest <= bound ? small+1.0 : 0.0;
}

// a/b, or 0 for b = 0.
inline double part_of(double a, double b) {
    return b > 0.0 ? a/b : 0.0;
}

#if AT_ONCE > 1
typedef number_of<several> several_numbers;

inline several operator-(const several_numbers& a, const several_numbers& b) {
    return a.high-b.high;
}

inline several operator-(const several_numbers& a, const several& b) {
    return a.high-b;
}

inline several operator*(const several& a, const several_numbers& b) {
    return a*b.high;
}

inline several operator*(double a, const several_numbers& b) {
    return a*b.high;
}

inline several operator/(const several_numbers& a, const several& b) {
    return a.high/b;
}

inline several is_large(several x) {
    EACH(l, AT_ONCE)
        x[l] = is_large(x[l]);
    return x;
}

inline bool still_large(several x) {
    return still_large(std::min(std::min(x[0], x[1]), std::min(x[2], x[3])));
}

inline several small_orders(several small, several largest, several bound) {
    EACH(l, AT_ONCE)
        small[l] = small_orders(small[l], largest[l], bound[l]);
    return small;
}

inline several part_of(several a, several b) {
    EACH(l, AT_ONCE)
        a[l] = part_of(a[l], b[l]);
    return a;
}
#endif

// The number of an atom, or component e of its vector, where `first` is the first atom of a star.
inline double number_at(const double* array, int first, int outer) {
    return array[first+outer];
}

template <class T> inline const T& vector_at(const T* array, int first, int outer, int e) {
    return array[3*(first+outer)+e];
}

inline void put_at(number* array, int first, int outer, int e, const number& value) {
    array[3*(first+outer)+e] = value;
}

inline void take_from(double* array, int first, double value) {
    array[first] -= value;
}

// The same for several stars.
inline several number_at(const double* array, const Atoms& first, int outer) {
    several x;
    EACH(l, AT_ONCE)
        LANE(x, l) = array[first.of[l]+outer];
    return x;
}

inline several vector_at(const double* array, const Atoms& first, int outer, int e) {
    several x;
    EACH(l, AT_ONCE)
        LANE(x, l) = array[3*(first.of[l]+outer)+e];
    return x;
}

inline number_of<several> vector_at(const number* array, const Atoms& first, int outer, int e) {
    number_of<several> x;
    EACH(l, AT_ONCE) {
        LANE(x.high, l) = array[3*(first.of[l]+outer)+e].high;
        LANE(x.low, l) = array[3*(first.of[l]+outer)+e].low;
    }
    return x;
}

inline void put_at(number* array, const Atoms& first, int outer, int e, const number_of<several>& value) {
    EACH(l, AT_ONCE)
        array[3*(first.of[l]+outer)+e] = number(LANE(value.high, l), LANE(value.low, l));
}

inline void take_from(double* array, const Atoms& first, several value) {
    EACH(l, AT_ONCE)
        if (l == 0 || first.of[l] != first.of[l-1])  // the last star may be repeated
            array[first.of[l]] -= LANE(value, l);
}

} // namespace
} // namespace exactrb
#endif
