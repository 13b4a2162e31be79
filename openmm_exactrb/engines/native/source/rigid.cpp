// The kernels of rigid bodies for processors. Bodies with SITES particles each have a struct of their own for the
// commonest number of particles.
#include "dialect.h"
#define LANES 1
#define OWN_MOVES

namespace exactrb {
namespace {

// Bodies for which a further thread is used.
const int BODIES_OF_THREAD = 256;

template <int KNOWN> struct Rigid : Thread {
    int BODIES, MEMORY, PER_STEP, DIFFERENCES, DIFFERENCES_PER_STEP, KEEPS_DIFFERENCES, GRADIENTS, SCALES, HEAT;
    double STILL, LIGHT;
    explicit Rigid(const Constants& constants) {
#define TAKE(name) name = integer(constants, #name);
        TAKE(BODIES) TAKE(MEMORY) TAKE(PER_STEP) TAKE(DIFFERENCES) TAKE(DIFFERENCES_PER_STEP) TAKE(KEEPS_DIFFERENCES)
        TAKE(GRADIENTS) TAKE(SCALES) TAKE(HEAT)
        STILL = exactrb::real(constants, "STILL"), LIGHT = exactrb::real(constants, "LIGHT");
    }
#define SITES (KNOWN > 0 ? KNOWN : row[2])
#include "../kernels/nodes.cl"
#include "../kernels/rotation.cl"
#include "../kernels/random.cl"
#include "../kernels/body.cl"
#include "../kernels/rigid.cl"
#include "../kernels/rigid_updates.cl"
#include "../kernels/sums.cl"
#include "../kernels/kinetic.cl"

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
