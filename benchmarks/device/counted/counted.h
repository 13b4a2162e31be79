// OpenMM's common dialect with types that count their operations in double precision, for the kernels of Contexts in mixed
// precision. Double stands for double and Float for float. An operation between Double, or a constant without REAL, and Float is an operation of Double
// after a conversion. Operations of Float are not counted, because a GPU of a consumer performs 64 of them in the time of one of Double.
#include <cmath>
#include <cstdio>
#include <type_traits>

struct Counts {
    long add = 0, multiply = 0, divide = 0, root = 0, compare = 0, convert = 0, function = 0;
    // Instructions: about ten for a quotient and a root, and forty for a logarithm or a sine.
    long total() const {
        return add+multiply+compare+convert+10*(divide+root)+40*function;
    }
} counts;

struct Float;
struct Double {
    double v;
    Double() = default;
    Double(double x) : v(x) {}
    Double(int x) : v(x) {}
    Double(float x) : v(x) { counts.convert++; }
    Double(long long x) : v(x) { counts.convert++; }
    Double(unsigned long long x) : v(x) { counts.convert++; }
    Double(Float x);
    explicit operator int() const { counts.convert++; return (int) v; }
    explicit operator float() const { counts.convert++; return (float) v; }
    explicit operator long long() const { return (long long) v; } // of scalars of the program
};
struct Float {
    float v;
    Float() = default;
    Float(int x) : v(x) {}
    Float(unsigned x) : v(x) {}
    Float(float x) : v(x) {}
    Float(double x) : v(x) {} // a constant
    Float(Double x) : v((float) x.v) { counts.convert++; }
    explicit operator int() const { return (int) v; }
    explicit operator long long() const { counts.convert++; return (long long) v; }
};
inline Double::Double(Float x) : v(x.v) { counts.convert++; }

#define OPERATOR(op, kind) \
    inline Double operator op(Double a, Double b) { counts.kind++; return Double(a.v op b.v); } \
    template <class T, std::enable_if_t<std::is_arithmetic_v<T>, int> = 0> Double operator op(Double a, T b) { return a op Double(b); } \
    template <class T, std::enable_if_t<std::is_arithmetic_v<T>, int> = 0> Double operator op(T a, Double b) { return Double(a) op b; } \
    inline Double operator op(Double a, Float b) { return a op Double(b); } \
    inline Double operator op(Float a, Double b) { return Double(a) op b; } \
    inline Double operator op(Float a, double b) { return Double(a) op Double(b); } \
    inline Double operator op(double a, Float b) { return Double(a) op Double(b); } \
    inline Float operator op(Float a, float b) { return Float((float) (a.v op b)); } \
    inline Float operator op(float a, Float b) { return Float((float) (a op b.v)); } \
    inline Float operator op(Float a, Float b) { return Float((float) (a.v op b.v)); } \
    template <class T, std::enable_if_t<std::is_integral_v<T>, int> = 0> Float operator op(Float a, T b) { return a op Float((float) b); } \
    template <class T, std::enable_if_t<std::is_integral_v<T>, int> = 0> Float operator op(T a, Float b) { return Float((float) a) op b; }
OPERATOR(+, add) OPERATOR(-, add) OPERATOR(*, multiply) OPERATOR(/, divide)
#define COMPARISON(op) \
    inline bool operator op(Double a, Double b) { counts.compare++; return a.v op b.v; } \
    template <class T, std::enable_if_t<std::is_arithmetic_v<T>, int> = 0> bool operator op(Double a, T b) { return a op Double(b); } \
    inline bool operator op(Float a, Float b) { return a.v op b.v; } \
    inline bool operator op(Float a, float b) { return a.v op b; } \
    inline bool operator op(Float a, double b) { return Double(a) op Double(b); } \
    template <class T, std::enable_if_t<std::is_integral_v<T>, int> = 0> bool operator op(Float a, T b) { return a.v op b; }
COMPARISON(<) COMPARISON(>) COMPARISON(<=) COMPARISON(>=) COMPARISON(==) COMPARISON(!=)
inline Double operator-(Double a) { return Double(-a.v); } // signs are part of other operations
inline Float operator-(Float a) { return Float(-a.v); }
template <class T> Double& operator+=(Double& a, T b) { return a = a+Double(b); }
template <class T> Double& operator-=(Double& a, T b) { return a = a-Double(b); }
template <class T> Double& operator*=(Double& a, T b) { return a = a*Double(b); }
template <class T> Float& operator+=(Float& a, T b) { return a = a+b; }
template <class T> Float& operator-=(Float& a, T b) { return a = a-b; }
template <class T> Float& operator*=(Float& a, T b) { return a = a*b; }
template <class T> Float& operator/=(Float& a, T b) { return a = a/b; }
#define FUNCTION(name, kind) \
    inline Double name(Double a) { counts.kind++; return Double(std::name(a.v)); } \
    inline Float name(Float a) { return Float((float) std::name(a.v)); }
FUNCTION(sqrt, root) FUNCTION(sin, function) FUNCTION(cos, function) FUNCTION(log, function) FUNCTION(fabs, compare) FUNCTION(ceil, add) FUNCTION(rint, add)
inline Double atan2(Double a, Double b) { counts.function++; return Double(std::atan2(a.v, b.v)); }
inline Float atan2(Float a, Float b) { return Float(std::atan2(a.v, b.v)); }
inline Float fmax(Float a, Float b) { return Float(std::fmax(a.v, b.v)); }
inline Double fmin(Double a, Double b) { counts.compare++; return Double(std::fmin(a.v, b.v)); }
inline int max(int a, int b) { return a > b ? a : b; }
inline int min(int a, int b) { return a < b ? a : b; }

typedef long long mm_long;
typedef unsigned long long mm_ulong;
struct int4 { int x, y, z, w; };
struct real4 { float x, y, z, w; };
struct mixed4 { Double x, y, z, w; };
inline real4 make_real4(float x, float y, float z, float w) { return {x, y, z, w}; }
inline mixed4 make_mixed4(Double x, Double y, Double z, Double w) { return {x, y, z, w}; }
#define __OPENCL_VERSION__ 120 // a thread for each star
inline mm_ulong mul_hi(mm_ulong a, mm_ulong b) { return (mm_ulong) (((unsigned __int128) a*b)>>64); }
typedef float real;
typedef Double mixed;
#define double Double
#define FINE Float
#define USE_MIXED_PRECISION
#define KERNEL static
#define DEVICE static
#define GLOBAL
#define LOCAL static
#define LOCAL_ARG
#define SYNC_THREADS
#define GLOBAL_ID 0
#define GLOBAL_SIZE 1
#define LOCAL_ID 0
#define LOCAL_SIZE 1
#define GROUP_ID 0
#define ATOMIC_ADD(p, v) *(p) += (v)
#define PADDED_NUM_ATOMS 4
#define LIGHT 3e5
#define STILL 0
#define BLOCK 1
#define GROUPS 1
#define GRADIENTS 0
#define KEEPS_DIFFERENCES 0
#define DIFFERENCES 1
#define DIFFERENCES_PER_STEP 1
#define MEMORY 1
#define PER_STEP 0
#define SCALES 0
#define HEAT 0
