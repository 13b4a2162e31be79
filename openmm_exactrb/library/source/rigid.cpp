// The kernels of rigid bodies for processors. Bodies with SITES particles each have a struct of their own for the
// commonest number of particles.
#include "several.h"
#define LANES 1
#define OWN_MOVES
#define FOR_SEVERAL_BODIES(i, n) for (int n, i = begin_of(thread, BODIES); (n = std::min(AT_ONCE, begin_of(thread+1, BODIES)-i)) > 0; i += n)

namespace exactrb {
namespace {

// Bodies for which a further thread is used.
const int BODIES_OF_THREAD = 256;

// The flow of a free body, or of several bodies at once.
template <class REALS, class NUMBERS> struct FreeRotation {
#define ALL_OF(condition) all_of(condition)
#include "rotors/nodes.cl"
#include "rotors/rotation.cl"
};
typedef FreeRotation<several, number_of<several> > RotationOfSeveral;

template <int KNOWN> struct Rigid : Thread, FreeRotation<double, number> {
    int BODIES, MEMORY, PER_STEP, DIFFERENCES, DIFFERENCES_PER_STEP, KEEPS_DIFFERENCES, GRADIENTS, SCALES, HEAT;
    double STILL, LIGHT;
    explicit Rigid(const Constants& constants) {
#define TAKE(name) name = integer(constants, #name);
        TAKE(BODIES) TAKE(MEMORY) TAKE(PER_STEP) TAKE(DIFFERENCES) TAKE(DIFFERENCES_PER_STEP) TAKE(KEEPS_DIFFERENCES)
        TAKE(GRADIENTS) TAKE(SCALES) TAKE(HEAT)
        STILL = exactrb::real(constants, "STILL"), LIGHT = exactrb::real(constants, "LIGHT");
    }
#define SITES (KNOWN > 0 ? KNOWN : row[2])
#include "random/random.cl"
#include "engines/native/kernels/body.cl"
    // Advance n bodies by t: together if one short step suffices for each, and otherwise one by one.
    void drift(double t, Body* some, int n) {
        EACH(l, n)
            EACH(k, 3)
                some[l].R[k] += t*some[l].P[k]*some[l].inverse_mass;
#if AT_ONCE > 1
        number_of<several> q[4], m[3];
        several of[4];
        EACH(l, AT_ONCE) {
            const Body& body = some[std::min(l, n-1)];
            EACH(k, 4) {
                q[k].high[l] = body.q[k].high, q[k].low[l] = body.q[k].low;
                of[k][l] = body.constants[k];
            }
            EACH(k, 3)
                m[k].high[l] = body.L[k].high, m[k].low[l] = body.L[k].low;
        }
        const several x = m[0], y = m[1], z = m[2], G = sqrt(x*x+y*y+z*z), parts = fabs(of[0]*t)*G*(1.0/SHORT);
        if (n > 1 && t != 0.0 && all_of((G > 1e-70) & (parts <= 1.0))) {
            RotationOfSeveral().rotate_short(several()+t, G, of[0], of[1], of[2], of[3], q, m);
            EACH(l, n) {
                EACH(k, 4)
                    some[l].q[k] = number(q[k].high[l], q[k].low[l]);
                EACH(k, 3)
                    some[l].L[k] = number(m[k].high[l], m[k].low[l]);
            }
            return;
        }
#endif
        EACH(l, n)
            rotate(t, some[l].constants, some[l].q, some[l].L);
    }
#include "engines/native/kernels/rigid.cl"
#include "engines/native/kernels/rigid_updates.cl"
#include "engines/native/kernels/sums.cl"
#include "engines/native/kernels/kinetic.cl"

    static Function function(KernelsOf<Rigid>& of, const std::string& name) {
        if (name == "segment")
            return of.together(&Rigid::segment, of.first().BODIES/BODIES_OF_THREAD);
        if (name == "kinetic")
            return of.alone(&Rigid::kinetic);
        if (name == "total")
            return of.alone(&Rigid::total);
        if (name == "pushed")
            return of.alone(&Rigid::pushed);
        if (name == "moved")
            return of.alone(&Rigid::moved);
        return Function();
    }
};

} // namespace

std::unique_ptr<Kernels> rigidKernels(const Constants& constants, OpenMM::ThreadPool* threads) {
    if (integer(constants, "SITES") == 3)
        return std::unique_ptr<Kernels>(new KernelsOf<Rigid<3> >(constants, threads));
    return std::unique_ptr<Kernels>(new KernelsOf<Rigid<0> >(constants, threads));
}

} // namespace exactrb

// Advance n free bodies for which few short steps suffice, and return the number of the others, for which `advanced` is zero.
// Arrays are stored row by row: `constants` (4 or more, n or 1), t (n or 1), q (4, n) and m (3, n), and then the low parts of
// q and m if they are `sums`. See openmm_exactrb.rotors.exact for the `limits`.
extern "C" EXPORTED int pi_rotate(int n, int alike, int at_one_time, int sums, const double* limits, const double* constants, const double* t,
        const double* q, const double* m, double* q1, double* m1, char* advanced) {
    using namespace exactrb;
    Rigid<0> kernels{Constants()};
    typedef Rigid<0>::Body Body;
    auto of_state = [&](const double* x, int rows, int k, int i) {
        return number(x[k*n+i], sums ? x[(rows+k)*n+i] : 0.0);
    };
    auto put = [&](double* x, int rows, int k, int i, const number& value) {
        x[k*n+i] = value.high;
        if (sums)
            x[(rows+k)*n+i] = value.low;
    };
    int left = 0;
    for (int first = 0, count; first < n; first += count) {
        Body some[AT_ONCE];
        double of_body[AT_ONCE][4];
        int body[AT_ONCE], found = 0;
        count = std::min(at_one_time ? AT_ONCE : 1, n-first);
        const double time = t[at_one_time ? 0 : first];
        for (int i = first; i < first+count; i++) {
            Body& one = some[found];
            double* const of = of_body[found];
            EACH(k, 4)
                of[k] = constants[alike ? k : k*n+i];
            EACH(k, 3) {
                one.R[k] = one.P[k] = number(0.0);
                one.L[k] = of_state(m, 3, k, i);
            }
            const double x = one.L[0], y = one.L[1], z = one.L[2], G = std::sqrt(x*x+y*y+z*z);
            const bool is_safe = G > limits[1] && G < limits[2] && max(fabs(x), fabs(y)) > limits[3]*G;
            advanced[i] = is_safe && fabs(of[0]*time)*G <= limits[0] && fabs(of[3]*time)*G <= limits[4];
            if (!advanced[i]) {
                left++;
                continue;
            }
            EACH(k, 4)
                one.q[k] = of_state(q, 4, k, i);
            one.inverse_mass = 0.0, one.constants = of;
            body[found++] = i;
        }
        if (found > 0)
            kernels.drift(time, some, found);
        for (int l = 0; l < found; l++) {
            EACH(k, 4)
                put(q1, 4, k, body[l], some[l].q[k]);
            EACH(k, 3)
                put(m1, 3, k, body[l], some[l].L[k]);
        }
    }
    return left;
}

// Write four numbers in (0, 1) for each of n bodies, u (4, n); `instant` contains the seed, the step, the stream and the block
// of openmm_exactrb.random.rng.
extern "C" EXPORTED void pi_uniforms(int n, const long long* instant, double* u) {
    using namespace exactrb;
    Rigid<0> kernels{Constants()};
    for (int body = 0; body < n; body++) {
        mm_ulong words[4] = {(mm_ulong) body+1, (mm_ulong) instant[3], (mm_ulong) instant[2], (mm_ulong) instant[1]};
        kernels.philox((mm_ulong) instant[0], words);
        EACH(k, 4)
            u[k*n+body] = kernels.uniform(words[k]);
    }
}
