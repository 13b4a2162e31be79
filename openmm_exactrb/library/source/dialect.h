// OpenMM's common dialect on a processor: a group of threads is a single thread, so that barriers and memory that a group
// shares need nothing. Kernels process a contiguous range of indices for each thread.
#include "kernels.h"
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#if defined(_MSC_VER)
#include <intrin.h>
#elif defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wpsabi" // about calls with vectors, which are inlined
#endif
#include "constants.h" // which openmm_exactrb.library.compilation writes
#define PROCESSOR
#define KERNEL
#define DEVICE
#define GLOBAL
#define LOCAL
#define LOCAL_ARG
#define SYNC_THREADS
#define LOCAL_ID 0
#define LOCAL_SIZE 1
#define GROUP_ID 0
#define GLOBAL_ID 0
#define GLOBAL_SIZE 1
#define BLOCK 1
#define GROUPS 1
#define EACH(k, n) for (int k = 0; k < n; k++)
#define OF_THREAD(i, n) int i = begin_of(thread, n); i < begin_of(thread+1, n); i++
#define OF_GROUP(i, n) OF_THREAD(i, n)
#define LOCAL_ARRAY(type, name, size) type* const name = sized(room_of_##name, size)
#define WORKSPACE(room, place, size) sized(room_of_clusters, size)
#define HIGH_PRODUCT(a, b) high_product(a, b)
#define LOW_PARTS 1
// Increments of the state have its precision; see kernels/precision.cl.
#define FINE double
#define SINGLE 0
#define REAL(x) (x)
#define DOUBLES REALS
#define NOT_A_NUMBER std::numeric_limits<double>::quiet_NaN()
#define TIMES_LOW_PARTS(a, q) low_parts_along(a, q)

namespace exactrb {
namespace {

typedef long long mm_long;
typedef unsigned long long mm_ulong;
typedef FINE fine;
typedef double real;
typedef double mixed;
typedef double component;
struct int4 {
    int x, y, z, w;
};
struct vector3 { // OpenMM::Vec3, which has no fourth number
    double x, y, z;
};
typedef vector3 real4;
typedef vector3 mixed4;
#define make_mixed4(x, y, z, w) mixed4{x, y, z}

// A number of the state: a double and its rounding error. Sums have the rounding error of D. E. Knuth (The Art of
// Computer Programming 2, 4.2.2, theorem B), as in openmm_exactrb.mathematics.compensated.
template <class T> struct number_of {
    T high, low;
    number_of() = default;
    number_of(T high, T low = T()) : high(high), low(low) {
    }
    operator T() const {
        return high;
    }
    number_of& operator+=(T step) {
        const T b = step+low, sum = high+b, shadow = sum-high;
        low = (high-(sum-shadow))+(b-shadow);
        high = sum;
        return *this;
    }
    number_of& operator-=(T step) {
        return *this += -step;
    }
};
typedef number_of<double> number;

template <class T> inline T low_parts_along(const T* a, const number_of<T>* q) {
    return a[0]*q[0].low+a[1]*q[1].low+a[2]*q[2].low+a[3]*q[3].low;
}

// The difference of two numbers, and the rounding error of the result.
template <class T> inline T apart(const number_of<T>& a, const number_of<T>& b, T* rest) {
    const T high = a.high-b.high, shadow = a.high-high, error = (a.high-(high+shadow))+(shadow-b.high);
    const T low = error+(a.low-b.low), sum = high+low;
    *rest = low-(sum-high);
    return sum;
}

// The largest power of two up to a positive number, or to each of several numbers.
template <class T> inline T power_of_two(T x) {
    mm_ulong bits[sizeof(T)/8];
    memcpy(bits, &x, sizeof(T));
    for (mm_ulong& b : bits)
        b &= 0x7FF0000000000000UL;
    memcpy(&x, bits, sizeof(T));
    return x;
}

// (d*d-r.r)/2, with an error below 1e-7 times the rounding error of d*d: numbers are divided into multiples of d/2^26 or
// so, whose squares are exact, and remainders.
template <class T> inline T half_defect(T d, const T* r, const T* rest) {
    const T to_grid = 201326592.0*power_of_two(d), coarse = (d+to_grid)-to_grid;
    T near[3], defect = coarse*coarse;
    EACH(e, 3) {
        near[e] = (r[e]+to_grid)-to_grid;
        defect -= near[e]*near[e];
    }
    EACH(e, 3)
        defect -= (r[e]-near[e])*(r[e]+near[e])+2.0*r[e]*rest[e];
    return 0.5*(defect+(d-coarse)*(d+coarse));
}

inline mm_ulong high_product(mm_ulong a, mm_ulong b) {
#if defined(_MSC_VER)
    return __umulh(a, b);
#else
    return (mm_ulong) (((unsigned __int128) a*b)>>64);
#endif
}

template <class T> T* sized(std::vector<T>& room, size_t size) {
    if (room.size() < size)
        room.resize(size);
    return room.data();
}

// OpenMM's Reference platform misses pairs of particles at negative coordinates that are roundoff.
inline double without_roundoff(double x) {
    return x < 0.0 && x > -1e-14 ? 0.0 : x;
}

inline void write_position(real4* posq, real4*, int4 place, const double*, double x, double y, double z) {
    posq[place.x] = real4{without_roundoff(x), without_roundoff(y), without_roundoff(z)};
}

inline void read_position(const real4* posq, const real4*, int4 place, const double*, double* x) {
    const real4 at = posq[place.x];
    x[0] = at.x; x[1] = at.y; x[2] = at.z;
}

inline void read_force(const component* force, int slot, double* f) {
    EACH(k, 3)
        f[k] = force[3*slot+k];
}

// What all structs of kernels have.
struct Thread {
    int thread = 0, n_threads = 1;
    int begin_of(int part, int n) const {
        return (int) ((long long) n*part/n_threads);
    }
};

// The function of the C library calls the library, because of nan.
inline double fmax(double a, double b) {
    return a < b ? b : a;
}

inline bool all_of(bool condition) {
    return condition;
}

using std::fabs;
using std::sqrt;
using std::max;
using std::min;

} // namespace
} // namespace exactrb
