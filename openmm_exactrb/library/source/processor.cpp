// The machine of the platforms Reference and CPU. Positions and velocities are OpenMM's own vectors.
#include "kernels.h"
#include "machine.h"
#include "openmm/Platform.h"
#include "openmm/System.h"
#include "openmm/reference/ReferencePlatform.h"
#include "openmm/reference/ReferenceVirtualSites.h"
#include <cmath>
#include <cstring>

using namespace OpenMM;
using std::string;
using std::vector;

namespace exactrb {
namespace {

struct Place {  // the int4 of kernels: slot and periodic cell of an atom
    int slot, a, b, c;
};

class Processor : public Machine {
public:
    Processor(ContextImpl& context, ReferencePlatform::PlatformData& data, bool threads) :
            context(context), data(data), threads(threads && data.threads.getNumThreads() > 1 ? &data.threads : NULL),
            forces(3*data.numParticles), places(data.numParticles) {
        for (int i = 0; i < data.numParticles; i++)
            places[i] = Place{i, 0, 0, 0};
        for (int i = 0; i < data.numParticles; i++)
            masses.push_back(context.getSystem().getParticleMass(i));
    }
    double time() const override {
        return data.time;
    }
    void setTime(double time) override {
        data.time = time;
    }
    long long stepCount() const override {
        return data.stepCount;
    }
    void setStepCount(long long count) override {
        data.stepCount = count;
    }
    void build(const vector<Source>& sources, vector<Array>& all, const vector<Kernel>& some) override {
        static const std::map<string, Maker> makers = {
            {"rigid", rigidKernels}, {"flexible", flexibleKernels}, {"thermostats", thermostatKernels}};
        for (const Array& a : all)
            arrays.push_back(a.data);
        for (const Source& source : sources) {
            if (!makers.count(source.name))
                throw error("no compiled kernels " + source.name);
            compiled.push_back(makers.at(source.name)(source.constants, threads));
        }
        for (const Kernel& k : some) {
            functions.push_back(compiled[k.source]->function(k.function));
            if (!functions.back())
                throw error("no compiled kernel " + k.function);
            values.emplace_back();
            for (const string& name : k.arguments)
                values.back().push_back(valueOf(name, all));
        }
    }
    void release() override {
        functions.clear(), values.clear(), compiled.clear(), arrays.clear();
        for (Kept& kept : slots)
            kept = Kept();
    }
    bool built() const override {
        return !arrays.empty();
    }
    void upload(const Array& array, int index) override {
        memcpy(arrays[index].data(), array.data.data(), array.bytes());
    }
    void download(int index, char* out) const override {
        memcpy(out, arrays[index].data(), arrays[index].size());
    }
    void copy(int from, int to) override {
        memcpy(arrays[to].data(), arrays[from].data(), arrays[from].size());
    }
    void set(int kernel, int argument, double value) override {
        values[kernel][argument].real = value;
    }
    void set(int kernel, int argument, long long value) override {
        values[kernel][argument].integer = value;
    }
    void launch(const Kernel&, int index) override {
        functions[index](values[index].data());
    }
    bool takeBox(const vector<double>& now) override {
        const bool same = std::equal(now.begin(), now.end(), box);
        std::copy(now.begin(), now.end(), box);
        return !same;
    }
    void takePlaces() override {
    }
    void checkPlaces() const override {  // the mesh of PME, on Reference
        for (const Vec3& x : *data.positions)
            if (!std::isfinite(x[0]) || !std::isfinite(x[1]) || !std::isfinite(x[2]))
                throw OpenMMException("Particle coordinate is NaN");
    }
    void takeForces() override {
        memcpy(forces.data(), data.forces->data(), forces.size()*sizeof(double));
    }
    bool hasForces() const override {
        return true;
    }
    void computeVirtualSites() override {
        data.virtualSites->computePositions(context.getSystem(), *data.positions, data.periodicBoxVectors);
    }
    void reorderAtoms() override {
    }
    double kineticEnergy() const override {
        double sum = 0;
        for (int i = 0; i < data.numParticles; i++)
            sum += 0.5*masses[i]*(*data.velocities)[i].dot((*data.velocities)[i]);
        return sum;
    }
    void keep(const vector<Array>& all, int slot) override {
        Kept& kept = slots[slot];
        kept.positions = *data.positions, kept.velocities = *data.velocities;
        kept.arrays.resize(all.size());
        for (size_t i = 0; i < all.size(); i++)
            if (all[i].saved)
                kept.arrays[i] = arrays[i];
    }
    void restore(int slot) override {
        const Kept& kept = slots[slot];
        context.setPositions(kept.positions), context.setVelocities(kept.velocities);
        for (size_t i = 0; i < arrays.size(); i++)
            if (!kept.arrays[i].empty())
                memcpy(arrays[i].data(), kept.arrays[i].data(), arrays[i].size());
    }

private:
    Value valueOf(const string& name, const vector<Array>& all) {
        Value v;
        v.integer = 0;
        if (name == "posq" || name == "posqCorrection")
            v.pointer = data.positions->data();
        else if (name == "velm")
            v.pointer = data.velocities->data();
        else if (name == "force")
            v.pointer = forces.data();
        else if (name == "places")
            v.pointer = places.data();
        else if (name == "box")
            v.pointer = box;
        else if (isInteger(name))
            v.integer = std::atoi(name.c_str());
        else if (name[0] != '#' && name[0] != '$')
            v.pointer = arrays[indexOf(all, name, "array")].data();
        return v;
    }
    ContextImpl& context;
    ReferencePlatform::PlatformData& data;
    ThreadPool* threads;
    vector<double> forces, masses;
    vector<Place> places;
    double box[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    vector<vector<char> > arrays;
    vector<std::unique_ptr<Kernels> > compiled;
    vector<Function> functions;
    vector<vector<Value> > values;
    struct Kept {
        vector<Vec3> positions, velocities;
        vector<vector<char> > arrays;
    } slots[SLOTS];
};

} // namespace

std::unique_ptr<Machine> processorOf(ContextImpl& context) {
    const string platform = context.getPlatform().getName();
    if (platform != "Reference" && platform != "CPU")
        return nullptr;
    void* data = context.getPlatformData();
    return std::unique_ptr<Machine>(
        new Processor(context, *static_cast<ReferencePlatform::PlatformData*>(data), platform == "CPU"));
}

} // namespace exactrb
