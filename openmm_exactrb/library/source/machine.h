// What a program runs on: a device of a platform with OpenMM's common dialect (device.cpp), or the processor of the
// platforms Reference and CPU (processor.cpp).
#ifndef EXACTRB_MACHINE_H_
#define EXACTRB_MACHINE_H_

#include "openmm/OpenMMException.h"
#include "openmm/internal/ContextImpl.h"
#include <algorithm>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace exactrb {

inline OpenMM::OpenMMException error(const std::string& what) {
    return OpenMM::OpenMMException("ProgramIntegrator: " + what);
}

struct Array {
    std::string name;
    int elementSize = 8;
    size_t size = 0;
    bool saved = false;      // stored in checkpoints and States, and by `keep`
    std::vector<char> data;  // values of the host, which `Machine::upload` takes and `Machine::download` returns
    size_t bytes() const {
        return size*elementSize;
    }
};

// The text of kernels for devices, or the name and the constants of kernels that are compiled into this library.
struct Source {
    std::string text, name;
    std::map<std::string, std::string> constants;
};

struct Kernel {
    std::string name, function;
    int source = 0, threads = 0, block = -1;
    std::vector<std::string> arguments;
    std::vector<std::pair<int, int> > scalars;  // index of the argument, index of the scalar, StepSize or StepCount
    bool places() const {  // whether the kernel may move particles
        return std::find(arguments.begin(), arguments.end(), "posq") != arguments.end();
    }
};
enum { StepSize = -1, StepCount = -2 };
const int SLOTS = 3;

// Notices that OpenMM has reordered the atoms, so that places and forces are out of date.
class Reordered {
public:
    virtual ~Reordered() {
    }
    virtual void reordered() = 0;
};

class Machine {
public:
    virtual ~Machine() {
    }
    // Make the machine current, and end this.
    virtual void enter() {
    }
    virtual void leave() {
    }
    virtual double time() const = 0;
    virtual void setTime(double time) = 0;
    virtual long long stepCount() const = 0;
    virtual void setStepCount(long long count) = 0;

    // Make the arrays and the kernels of a program, and delete them.
    virtual void build(const std::vector<Source>& sources, std::vector<Array>& arrays, const std::vector<Kernel>& kernels) = 0;
    virtual void release() = 0;
    virtual bool built() const = 0;
    virtual void upload(const Array& array, int index) = 0;
    virtual void download(int index, char* data) const = 0;
    virtual void copy(int from, int to) = 0;
    virtual void set(int kernel, int argument, double value) = 0;
    virtual void set(int kernel, int argument, long long value) = 0;
    virtual void launch(const Kernel& kernel, int index) = 0;

    // Take the box vectors, which are zero without a box, and return whether they have changed. Take the places of the atoms.
    virtual bool takeBox(const std::vector<double>& box) = 0;
    virtual void takePlaces() = 0;
    // Raise OpenMM's error if a coordinate is not finite, where OpenMM's forces would index arrays with it.
    virtual void checkPlaces() const {
    }
    // Note that the forces for the kernels have just been computed, and return whether they are still there.
    virtual void takeForces() = 0;
    virtual bool hasForces() const = 0;
    virtual void computeVirtualSites() = 0;
    virtual void reorderAtoms() = 0;
    virtual double kineticEnergy() const = 0;
    // Keep positions, velocities and the saved arrays in one of SLOTS places, and restore them.
    virtual void keep(const std::vector<Array>& arrays, int slot) = 0;
    virtual void restore(int slot) = 0;
};

// Return the machine of a Context, or NULL if the platform has none.
std::unique_ptr<Machine> deviceOf(OpenMM::ContextImpl& context, Reordered& owner);
std::unique_ptr<Machine> processorOf(OpenMM::ContextImpl& context);

// Makes a machine current during the lifetime of the object.
struct Current {
    Machine& machine;
    explicit Current(Machine& machine) : machine(machine) {
        machine.enter();
    }
    ~Current() {
        machine.leave();
    }
};

// Index of a name among named objects.
template <class Named> int indexOf(const std::vector<Named>& all, const std::string& name, const char* what) {
    for (int i = 0; i < (int) all.size(); i++)
        if (all[i].name == name)
            return i;
    throw error(std::string("no ") + what + " " + name);
}

// Whether an argument of a kernel is an integer.
inline bool isInteger(const std::string& argument) {
    return argument[0] == '-' || (argument[0] >= '0' && argument[0] <= '9');
}

} // namespace exactrb
#endif
