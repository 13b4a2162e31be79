// The machine of the platforms OpenCL, CUDA and HIP. It is called through the virtual functions of ComputeContext, and
// through a few non-virtual functions, which are looked up in the platform's library.
#include "machine.h"
#include "openmm/Platform.h"
#include "openmm/System.h"
#ifdef _WIN32
namespace exactrb {
std::unique_ptr<Machine> deviceOf(OpenMM::ContextImpl&, Reordered&) {
    return nullptr;  // the functions below have other names in libraries for Windows
}
}
#else
#include "openmm/common/ComputeContext.h"
#include <dlfcn.h>

using namespace OpenMM;
using std::string;
using std::vector;

namespace exactrb {
namespace {

// The beginning of OpenCLPlatform::PlatformData, CudaPlatform::PlatformData and HipPlatform::PlatformData.
struct PlatformDataHead {
    ContextImpl* context;
    vector<ComputeContext*> contexts;
};

typedef std::unique_ptr<ArrayInterface> DeviceArray;

// Functions of the platform's library that are not virtual.
struct PlatformFunctions {
    void (*reorderAtoms)(ComputeContext*);
    void (*setAtomIndex)(ComputeContext*, vector<int>&);
    void (*virtualSites)(IntegrationUtilities*);
    double (*kineticEnergy)(IntegrationUtilities*, double);

    // Find the library that contains the class of the context, by the address of the class's virtual function table.
    void lookUp(ComputeContext* cc) {
        Dl_info info;
        if (dladdr(*reinterpret_cast<void**>(cc), &info) == 0)
            throw error("cannot find the library of the platform");
        void* library = dlopen(info.dli_fname, RTLD_LAZY | RTLD_NOLOAD);
        find(library, "_ZN6OpenMM14ComputeContext12reorderAtomsEv", reorderAtoms);
        find(library, "_ZN6OpenMM14ComputeContext12setAtomIndexERSt6vectorIiSaIiEE", setAtomIndex);
        find(library, "_ZN6OpenMM20IntegrationUtilities19computeVirtualSitesEv", virtualSites);
        find(library, "_ZN6OpenMM20IntegrationUtilities20computeKineticEnergyEd", kineticEnergy);
    }
    template <class Function> static void find(void* library, const char* name, Function& found) {
        void* address = dlsym(library, name);
        if (address == NULL)
            throw error(string("the library of the platform has no ") + name);
        found = reinterpret_cast<Function>(address);
    }
};

class Listener : public ComputeContext::ReorderListener {
public:
    explicit Listener(Reordered& owner) : owner(owner) {
    }
    void execute() override {
        owner.reordered();
    }

private:
    Reordered& owner;
};

class Device : public Machine {
public:
    Device(ContextImpl& context, ComputeContext* cc, Reordered& owner) : context(context), cc(cc) {
        functions.lookUp(cc);
        cc->initializeContexts();
        Current current(*this);
        places = made(cc->getPaddedNumAtoms(), sizeof(mm_int4), "places");
        box = made(9, sizeof(double), "box");
        cc->getReorderListeners().push_back(new Listener(owner));
    }
    void enter() override {
        cc->pushAsCurrent();
    }
    void leave() override {
        cc->popAsCurrent();
    }
    double time() const override {
        return cc->getTime();
    }
    void setTime(double time) override {
        cc->setTime(time);
    }
    long long stepCount() const override {
        return cc->getStepCount();
    }
    void setStepCount(long long count) override {
        cc->setStepCount(count);
    }
    void build(const vector<Source>& sources, vector<Array>& all, const vector<Kernel>& some) override {
        Current current(*this);
        for (Array& a : all) {
            arrays.push_back(made(a.size, a.elementSize, a.name));
            arrays.back()->upload(a.data.data());
        }
        std::map<string, string> defines = {{"PADDED_NUM_ATOMS", std::to_string(cc->getPaddedNumAtoms())}};
        vector<ComputeProgram> programs;
        for (const Source& source : sources)
            programs.push_back(cc->compileProgram(source.text, defines));
        for (const Kernel& k : some) {
            kernels.push_back(programs[k.source]->createKernel(k.function));
            bind(k, kernels.back(), all);
        }
    }
    void release() override {
        arrays.clear(), kernels.clear();
        for (Kept& kept : slots)
            kept = Kept();
    }
    bool built() const override {
        return !arrays.empty();
    }
    void upload(const Array& array, int index) override {
        Current current(*this);
        arrays[index]->upload(array.data.data());
    }
    void download(int index, char* data) const override {
        Current current(const_cast<Device&>(*this));
        arrays[index]->download(data);
    }
    void copy(int from, int to) override {
        arrays[from]->copyTo(*arrays[to]);
    }
    void set(int kernel, int argument, double value) override {
        kernels[kernel]->setArg(argument, value);
    }
    void set(int kernel, int argument, long long value) override {
        kernels[kernel]->setArg(argument, value);
    }
    void launch(const Kernel& k, int index) override {
        kernels[index]->execute(k.threads, k.block);
    }
    bool takeBox(const vector<double>& now) override {
        if (now == lastBox)
            return false;
        box->upload(now);
        lastBox = now;
        return true;
    }
    void takePlaces() override {
        const vector<int>& atoms = cc->getAtomIndex();
        const vector<mm_int4>& cells = cc->getPosCellOffsets();
        vector<mm_int4> values(cc->getPaddedNumAtoms(), mm_int4(0, 0, 0, 0));
        for (int i = 0; i < cc->getNumAtoms(); i++)
            values[atoms[i]] = mm_int4(i, cells[i].x, cells[i].y, cells[i].z);
        places->upload(values);
    }
    void takeForces() override {
        forceCount = cc->getComputeForceCount();
    }
    bool hasForces() const override {
        return cc->getComputeForceCount() == forceCount;
    }
    void computeVirtualSites() override {
        functions.virtualSites(&cc->getIntegrationUtilities());
    }
    void reorderAtoms() override {
        functions.reorderAtoms(cc);
    }
    double kineticEnergy() const override {
        return functions.kineticEnergy(&cc->getIntegrationUtilities(), 0.0);
    }
    void keep(const vector<Array>& all, int slot) override {
        Kept& kept = slots[slot];
        kept.order = cc->getAtomIndex(), kept.cells = cc->getPosCellOffsets();
        vector<ArrayInterface*> state = {&cc->getPosq(), &cc->getVelm()};
        if (cc->getUseMixedPrecision())
            state.push_back(&cc->getPosqCorrection());
        for (size_t i = 0; i < all.size(); i++)
            if (all[i].saved)
                state.push_back(arrays[i].get());
        for (ArrayInterface* array : state) {
            DeviceArray& copy = kept.copies[array];
            if (!copy)
                copy = made(array->getSize(), array->getElementSize(), array->getName() + "Kept");
            array->copyTo(*copy);
        }
    }
    void restore(int slot) override {
        Kept& kept = slots[slot];
        if (cc->getUseDoublePrecision())
            restoreOrder<mm_double4>(kept);
        else
            restoreOrder<mm_float4>(kept);
        for (auto& pair : kept.copies)
            pair.second->copyTo(*pair.first);
        vector<Vec3> x, v;  // set through OpenMM, which then updates all data that depend on them
        context.getPositions(x), context.getVelocities(v);
        context.setPositions(x), context.setVelocities(v);
    }

private:
    DeviceArray made(size_t size, int elementSize, const string& name) {
        DeviceArray array(cc->createArray());
        array->initialize(*cc, size, elementSize, name);
        return array;
    }
    void bind(const Kernel& k, ComputeKernel& kernel, const vector<Array>& all) {
        std::map<string, ArrayInterface*> given = {{"posq", &cc->getPosq()}, {"velm", &cc->getVelm()},
            {"posqCorrection", cc->getUseMixedPrecision() ? &cc->getPosqCorrection() : &cc->getPosq()},
            {"force", &cc->getLongForceBuffer()}, {"places", places.get()}, {"box", box.get()}};
        for (const string& name : k.arguments) {
            if (given.count(name))
                kernel->addArg(*given[name]);
            else if (name == "#step")
                kernel->addArg((long long) 0);
            else if (name[0] == '$')
                kernel->addArg(0.0);
            else if (isInteger(name))
                kernel->addArg(std::stoi(name));
            else
                kernel->addArg(*arrays[indexOf(all, name, "array")]);
        }
    }
    struct Kept {
        vector<int> order;
        vector<mm_int4> cells;
        std::map<ArrayInterface*, DeviceArray> copies;
    };
    // Restore the order of the atoms. OpenMM stores charges beside positions. They are no part of the state, because they
    // may have changed with parameters since `keep`, so the kept positions receive the present charges.
    template <class Real4> void restoreOrder(Kept& kept) {
        vector<Real4> now, then;
        cc->getPosq().download(now);
        kept.copies[&cc->getPosq()]->download(then);
        vector<decltype(Real4::w)> charges(now.size());
        const vector<int>& atoms = cc->getAtomIndex();
        for (int i = 0; i < cc->getNumAtoms(); i++)
            charges[atoms[i]] = now[i].w;
        for (int i = 0; i < cc->getNumAtoms(); i++)
            then[i].w = charges[kept.order[i]];
        kept.copies[&cc->getPosq()]->upload(then);
        functions.setAtomIndex(cc, kept.order);
        cc->setPosCellOffsets(kept.cells);
    }
    ContextImpl& context;
    ComputeContext* cc;
    PlatformFunctions functions;
    vector<DeviceArray> arrays;
    vector<ComputeKernel> kernels;
    DeviceArray places, box;  // slot and periodic cell of each atom; nine numbers of the box vectors
    vector<double> lastBox;
    int forceCount = -1;
    Kept slots[SLOTS];
};

} // namespace

std::unique_ptr<Machine> deviceOf(ContextImpl& context, Reordered& owner) {
    const string platform = context.getPlatform().getName();
    if (platform != "OpenCL" && platform != "CUDA" && platform != "HIP")
        return nullptr;
    PlatformDataHead* data = reinterpret_cast<PlatformDataHead*>(context.getPlatformData());
    if (data->context != &context || data->contexts.size() != 1 || !data->contexts[0]->getSupportsDoublePrecision())
        return nullptr;
    return std::unique_ptr<Machine>(new Device(context, data->contexts[0], owner));
}

} // namespace exactrb
#endif
