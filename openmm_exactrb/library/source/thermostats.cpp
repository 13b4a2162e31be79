// The kernels of thermostats for processors.
#include "dialect.h"
#include <sstream>

namespace exactrb {
namespace {

// The largest number of weights of a splitting of Nose-Hoover chains.
const int MOST_WEIGHTS = 7;

struct Thermostats : Thread {
    int links, REPETITIONS, N_WEIGHTS;
    double weight[MOST_WEIGHTS] = {};
    explicit Thermostats(const Constants& constants) {
        links = integer(constants, "CHAIN"), REPETITIONS = integer(constants, "REPETITIONS"), N_WEIGHTS = integer(constants, "N_WEIGHTS");
        auto found = constants.find("WEIGHTS");
        std::istringstream words(found == constants.end() ? "" : found->second);
        std::string word;
        for (int k = 0; k < MOST_WEIGHTS && std::getline(words, word, ','); k++)
            weight[k] = number_in(word);
    }
#define RESCALING
#define CHAIN links
#define WEIGHTS weight[0], weight[1], weight[2], weight[3], weight[4], weight[5], weight[6]
#include "random/random.cl"
#include "thermostats/thermostats.cl"

    static Function function(KernelsOf<Thermostats>& of, const std::string& name) {
#define NAMED(kernel) if (name == #kernel) return of.alone(&Thermostats::kernel);
        EACH_THERMOSTAT(NAMED)
        return Function();
    }
};

} // namespace

std::unique_ptr<Kernels> thermostatKernels(const Constants& constants, OpenMM::ThreadPool*) {
    return std::unique_ptr<Kernels>(new KernelsOf<Thermostats>(constants, NULL));
}

} // namespace exactrb
