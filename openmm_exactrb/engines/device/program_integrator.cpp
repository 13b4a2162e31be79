// An OpenMM Integrator whose steps are a program: named arrays on the device, kernels given as text, and sequences of
// operations. The integrator contains no physics. The library links only to libOpenMM. It calls OpenCL, CUDA and HIP
// through the virtual functions of ComputeContext, and looks up a few non-virtual functions in the platform's library.
//
// Without a program, the integrator is a CustomIntegrator, and it keeps the global variables when it has a program.
// Python starts the steps of a program after checking that the arrays agree with the Context (library.py). The lines of
// a program are described in program.py.
#include "openmm/Context.h"
#include "openmm/CustomIntegrator.h"
#include "openmm/OpenMMException.h"
#include "openmm/Platform.h"
#include "openmm/System.h"
#include "openmm/common/ComputeContext.h"
#include "openmm/internal/ContextImpl.h"
#include "openmm/serialization/SerializationNode.h"
#include "openmm/serialization/SerializationProxy.h"
#include <algorithm>
#include <cstring>
#include <dlfcn.h>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

using namespace OpenMM;
using std::string;
using std::vector;

namespace {

OpenMMException error(const string& what) {
    return OpenMMException("ProgramIntegrator: " + what);
}

// The beginning of OpenCLPlatform::PlatformData, CudaPlatform::PlatformData and HipPlatform::PlatformData.
struct PlatformDataHead {
    ContextImpl* context;
    vector<ComputeContext*> contexts;
};

typedef std::unique_ptr<ArrayInterface> DeviceArray;

struct Array {
    string name;
    int elementSize = 8;
    size_t size = 0;
    bool saved = false;      // stored in checkpoints and States, and by `keep`
    vector<char> data;       // values on the host, which `build` uploads
    DeviceArray device;
    size_t bytes() const {
        return size * elementSize;
    }
};

struct Scalar {
    string name;
    double value;
};

struct Kernel {
    string name, function;
    int source, threads, block;
    vector<string> arguments;
    vector<std::pair<int, int> > scalars;  // index of the argument, index of the scalar, StepSize or StepCount
    ComputeKernel kernel;
    bool places() const {  // whether the kernel may move particles
        return std::find(arguments.begin(), arguments.end(), "posq") != arguments.end();
    }
};
enum { StepSize = -1, StepCount = -2 };
const int Loads = 8;

struct Operation {
    enum Kind { Run, Forces, Sites, Reorder, Clock, Step, Add, Copy } kind;
    int which = 0, other = 0;
    double value = 0;
};

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

// Makes the context of the device current during the lifetime of the object.
struct Current {
    ComputeContext* cc;
    explicit Current(ComputeContext* cc) : cc(cc) {
        cc->pushAsCurrent();
    }
    ~Current() {
        cc->popAsCurrent();
    }
};

class ProgramIntegrator : public CustomIntegrator {
public:
    explicit ProgramIntegrator(double stepSize) : CustomIntegrator(stepSize) {
    }
    void setProgram(const string& text);
    void step(int steps) override;
    void makeSteps(int steps);
    void runAlone(const string& sequence);
    void keep();
    void restore();
    void upload(const string& name, const void* data, size_t bytes);
    void download(const string& name, void* data, size_t bytes);
    double& scalar(const string& name) {
        return scalars[indexOf(scalars, name, "scalar")].value;
    }
    // External changes to the Context since these bits were cleared: 1 for positions, 2 for velocities, 4 for forces with
    // changed parameters, and 8 for a loaded checkpoint or State.
    int changes = 7;
    long long launches = 0, forceCalls = 0;

protected:
    void initialize(ContextImpl& impl) override;
    void cleanup() override;
    void stateChanged(State::DataType changed) override {
        CustomIntegrator::stateChanged(changed);
        forcesStale = true;
        if (changed == State::Energy && loading)  // OpenMM reports it after each loaded checkpoint
            loading = false;
        else if (!updating)
            changes |= changed == State::Positions ? 1 : changed == State::Velocities ? 2 : changed == State::Energy ? 4 : 0;
    }
    double computeKineticEnergy() override {
        return hasProgram() ? functions.kineticEnergy(&cc->getIntegrationUtilities(), 0.0) : CustomIntegrator::computeKineticEnergy();
    }
    bool kineticEnergyRequiresForce() const override {
        return !hasProgram() && CustomIntegrator::kineticEnergyRequiresForce();
    }
    void createCheckpoint(std::ostream& stream) const override;
    void loadCheckpoint(std::istream& stream) override;
    void serializeParameters(SerializationNode& node) const override;
    void deserializeParameters(const SerializationNode& node) override;

private:
    friend class Proxy;
    class Listener;
    bool hasProgram() const {
        return cc != NULL && !program.empty();
    }
    void show(Array& a);
    vector<char> present(const Array& a) const;
    void save(std::ostream& stream, bool all) const;
    void load(std::istream& stream);
    string savedText(bool all) const;
    void loadText(const string& text);
    template <class Named> static int indexOf(const vector<Named>& all, const string& name, const char* what) {
        for (int i = 0; i < (int) all.size(); i++)
            if (all[i].name == name)
                return i;
        throw error(string("no ") + what + " " + name);
    }
    Operation operation(const string& word, std::istringstream& words) const;
    void takeLoaded();
    void requireDevice() const {
        if (!hasProgram())
            throw error("there is no Context on one device with double precision, or no program");
    }
    void build();
    void release();
    void bind(Kernel& kernel);
    void carryOut(const string& sequence);
    void launch(Kernel& kernel);
    void evaluate(int groups);
    void update(int calls, bool leaves);
    void uploadPlaces();
    void uploadBox();
    template <class Real4> void restoreOrder();
    DeviceArray made(size_t size, int elementSize, const string& name) {
        DeviceArray array(cc->createArray());
        array->initialize(*cc, size, elementSize, name);
        return array;
    }
    string program;
    vector<string> sources;
    vector<Array> arrays;
    vector<Scalar> scalars;
    vector<Kernel> kernels;
    std::map<string, vector<Operation> > sequences;

    ComputeContext* cc = NULL;
    PlatformFunctions functions;
    DeviceArray places, box;  // slot and periodic cell of each atom; nine numbers of the box vectors
    vector<double> lastBox;
    struct Loaded {  // values from a checkpoint or State, until a program is set
        std::map<string, double> scalars;
        std::map<string, vector<char> > arrays;
    } loaded;
    bool forcesStale = true, placesStale = true, updating = false, loading = false;
    int forceCount = -1, forceGroups = 0;
    double stepBegan = 0;  // in ps
    long long updates = 0;  // since the barostat's last move; like the barostat's own counter, not saved

    struct Kept {  // the state saved by `keep`
        double time = 0;
        long long steps = 0;
        Vec3 box[3];
        vector<int> order;
        vector<mm_int4> cells;
        vector<Scalar> scalars;
        std::map<ArrayInterface*, DeviceArray> copies;
    } kept;
};

class ProgramIntegrator::Listener : public ComputeContext::ReorderListener {
public:
    explicit Listener(ProgramIntegrator& owner) : owner(owner) {
    }
    void execute() override {
        owner.placesStale = owner.forcesStale = true;
    }

private:
    ProgramIntegrator& owner;
};

// -- the program ------------------------------------------------------------------------------------------------------

void ProgramIntegrator::setProgram(const string& text) {
    if (text == program)
        return;
    release();
    program.clear(), sources.clear(), arrays.clear(), scalars.clear(), kernels.clear(), sequences.clear();
    std::istringstream lines(text);
    string line, word, name;
    vector<Operation>* sequence = NULL;
    while (std::getline(lines, line)) {
        std::istringstream words(line);
        if (!(words >> word))
            continue;
        if (word == "array") {
            Array a;
            words >> a.name >> a.elementSize >> a.size >> word;
            a.saved = word == "saved";
            a.data.assign(a.bytes(), 0);
            arrays.push_back(std::move(a));
        }
        else if (word == "scalar") {
            Scalar s;
            words >> s.name >> s.value;
            scalars.push_back(s);
        }
        else if (word == "source") {
            size_t bytes = 0;
            words >> bytes;
            string source(bytes, ' ');
            lines.read(&source[0], bytes);
            sources.push_back(source);
        }
        else if (word == "kernel") {
            Kernel k;
            k.source = (int) sources.size() - 1;
            words >> k.name >> k.function >> k.threads >> k.block;
            while (words >> word)
                k.arguments.push_back(word);
            kernels.push_back(std::move(k));
        }
        else if (word == "sequence") {
            words >> name;
            sequence = &sequences[name];
        }
        else if (sequence == NULL)
            throw error("an operation outside a sequence: " + line);
        else
            sequence->push_back(operation(word, words));
    }
    program = text;
    takeLoaded();
    if (cc != NULL)
        build();
}

// Set arrays and scalars to loaded values of the same name and size.
void ProgramIntegrator::takeLoaded() {
    for (Scalar& s : scalars)
        if (loaded.scalars.count(s.name))
            s.value = loaded.scalars[s.name];
    for (Array& a : arrays) {
        auto found = loaded.arrays.find(a.name);
        if (found == loaded.arrays.end() || found->second.size() != a.bytes())
            continue;
        a.data = found->second;
        show(a);
    }
    if (!program.empty())
        loaded = Loaded();
}

Operation ProgramIntegrator::operation(const string& word, std::istringstream& words) const {
    static const std::map<string, Operation::Kind> kinds = {
        {"run", Operation::Run}, {"forces", Operation::Forces}, {"sites", Operation::Sites}, {"reorder", Operation::Reorder},
        {"clock", Operation::Clock}, {"step", Operation::Step}, {"add", Operation::Add}, {"copy", Operation::Copy}};
    if (!kinds.count(word))
        throw error("unknown operation " + word);
    Operation made{kinds.at(word)};
    string name, to;
    if (made.kind == Operation::Run && words >> name)
        made.which = indexOf(kernels, name, "kernel");
    else if (made.kind == Operation::Forces)
        words >> made.which;
    else if (made.kind == Operation::Clock)
        words >> made.value;
    else if (made.kind == Operation::Add && words >> name >> made.value)
        made.which = indexOf(scalars, name, "scalar");
    else if (made.kind == Operation::Copy && words >> name >> to)
        made.which = indexOf(arrays, name, "array"), made.other = indexOf(arrays, to, "array");
    if (words.fail())
        throw error("incomplete operation " + word);
    return made;
}

// -- in a Context -----------------------------------------------------------------------------------------------------

void ProgramIntegrator::initialize(ContextImpl& impl) {
    CustomIntegrator::initialize(impl);
    updates = 0;
    cc = NULL;
    const string platform = impl.getPlatform().getName();
    if (platform != "OpenCL" && platform != "CUDA" && platform != "HIP")
        return;
    PlatformDataHead* data = reinterpret_cast<PlatformDataHead*>(impl.getPlatformData());
    if (data->context != &impl || data->contexts.size() != 1 || !data->contexts[0]->getSupportsDoublePrecision())
        return;
    cc = data->contexts[0];
    functions.lookUp(cc);
    cc->initializeContexts();
    Current current(cc);
    places = made(cc->getPaddedNumAtoms(), sizeof(mm_int4), "places");
    box = made(9, sizeof(double), "box");
    lastBox.clear();
    cc->getReorderListeners().push_back(new Listener(*this));
    changes = 7;
    forcesStale = placesStale = true;
    if (!program.empty())
        build();
}

void ProgramIntegrator::cleanup() {
    CustomIntegrator::cleanup();
    if (hasProgram()) {
        try {
            for (Array& a : arrays)
                a.data = present(a);
        }
        catch (OpenMMException&) {  // the device is lost, and its Context is being destroyed
        }
    }
    release();
    places.reset(), box.reset();
    cc = NULL;
}

void ProgramIntegrator::release() {
    for (Array& a : arrays)
        a.device.reset();
    for (Kernel& k : kernels)
        k.kernel.reset();
    kept = Kept();
}

void ProgramIntegrator::build() {
    Current current(cc);
    for (Array& a : arrays) {
        a.device = made(a.size, a.elementSize, a.name);
        a.device->upload(a.data.data());
    }
    std::map<string, string> defines = {{"PADDED_NUM_ATOMS", std::to_string(cc->getPaddedNumAtoms())}};
    vector<ComputeProgram> programs;
    for (const string& source : sources)
        programs.push_back(cc->compileProgram(source, defines));
    for (Kernel& k : kernels) {
        k.kernel = programs[k.source]->createKernel(k.function);
        bind(k);
    }
}

// Arguments are the names of arrays of OpenMM or of the program, a scalar $name, the step size $h, the step count #step
// (long long), or an integer (int).
void ProgramIntegrator::bind(Kernel& k) {
    std::map<string, ArrayInterface*> given = {{"posq", &cc->getPosq()}, {"velm", &cc->getVelm()},
        {"posqCorrection", cc->getUseMixedPrecision() ? &cc->getPosqCorrection() : &cc->getPosq()},
        {"force", &cc->getLongForceBuffer()}, {"places", places.get()}, {"box", box.get()}};
    k.scalars.clear();
    for (int i = 0; i < (int) k.arguments.size(); i++) {
        const string& name = k.arguments[i];
        if (given.count(name))
            k.kernel->addArg(*given[name]);
        else if (name == "#step") {
            k.scalars.push_back({i, StepCount});
            k.kernel->addArg((long long) 0);
        }
        else if (name[0] == '$') {
            k.scalars.push_back({i, name == "$h" ? (int) StepSize : indexOf(scalars, name.substr(1), "scalar")});
            k.kernel->addArg(0.0);
        }
        else if (name[0] == '-' || isdigit(name[0]))
            k.kernel->addArg(std::stoi(name));
        else
            k.kernel->addArg(*arrays[indexOf(arrays, name, "array")].device);
    }
}

void ProgramIntegrator::uploadPlaces() {
    const vector<int>& atoms = cc->getAtomIndex();
    const vector<mm_int4>& cells = cc->getPosCellOffsets();
    vector<mm_int4> values(cc->getPaddedNumAtoms(), mm_int4(0, 0, 0, 0));
    for (int i = 0; i < cc->getNumAtoms(); i++)
        values[atoms[i]] = mm_int4(i, cells[i].x, cells[i].y, cells[i].z);
    places->upload(values);
    placesStale = false;
}

void ProgramIntegrator::uploadBox() {
    vector<double> now(9, 0.0);
    if (context->getSystem().usesPeriodicBoundaryConditions()) {
        Vec3 a, b, c;
        cc->getPeriodicBoxVectors(a, b, c);
        now = {a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]};
    }
    if (now != lastBox) {
        box->upload(now);
        forcesStale = true;
    }
    lastBox = now;
}

void ProgramIntegrator::launch(Kernel& k) {
    if (placesStale)
        uploadPlaces();
    for (auto& scalar : k.scalars) {
        if (scalar.second == StepCount)
            k.kernel->setArg(scalar.first, cc->getStepCount());
        else
            k.kernel->setArg(scalar.first, scalar.second == StepSize ? getStepSize() : scalars[scalar.second].value);
    }
    k.kernel->execute(k.threads, k.block);
    launches++;
}

// Evaluate the forces of those groups (bits) that are active.
void ProgramIntegrator::evaluate(int groups) {
    context->calcForcesAndEnergy(true, false, groups & getIntegrationForceGroups());
    forceCount = cc->getComputeForceCount(), forceGroups = getIntegrationForceGroups(), forcesStale = false;
    forceCalls++;
}

void ProgramIntegrator::carryOut(const string& name) {
    auto found = sequences.find(name);
    if (found == sequences.end())
        return;
    for (Operation& o : found->second) {
        switch (o.kind) {
        case Operation::Run:
            launch(kernels[o.which]);
            break;
        case Operation::Forces:
            evaluate(o.which);
            break;
        case Operation::Sites:
            functions.virtualSites(&cc->getIntegrationUtilities());
            break;
        case Operation::Reorder:
            functions.reorderAtoms(cc);
            break;
        case Operation::Clock:
            cc->setTime(stepBegan + o.value * getStepSize());
            break;
        case Operation::Step:
            cc->setTime(stepBegan += getStepSize());
            cc->setStepCount(cc->getStepCount() + 1);
            break;
        case Operation::Add:
            scalars[o.which].value += o.value;
            break;
        case Operation::Copy:
            arrays[o.which].device->copyTo(*arrays[o.other].device);
            break;
        }
    }
}

void ProgramIntegrator::step(int steps) {
    if (program.empty() && getNumComputations() > 0)
        CustomIntegrator::step(steps);
    else
        throw error("OpenMM alone cannot perform the steps of this integrator of openmm_exactrb: import openmm_exactrb before reading the integrator from XML, and do not add the integrator to a CompoundIntegrator");
}

// Perform steps with these sequences of the program. "forces" evaluates the forces that "open" needs, unless they are
// known. "open" begins a step, "body" continues it up to its last force evaluation, and "close" ends it. "between"
// combines "close" with the following "open".
//
// OpenMM updates the Context when a barostat acts, after every "interval" updates, or after every step if "always" is
// not 0, and when the number of steps is a multiple of "removal". A value of 0 means never. "pushed" follows an update,
// and "moved" follows if positions changed. Updates in which barostats act are preceded by the sequence "leave", if it
// exists, and followed by "return"; "leave_pushed" and "leave_moved" then replace "pushed" and "moved" if they exist.
void ProgramIntegrator::makeSteps(int steps) {
    requireDevice();
    Current current(cc);
    uploadBox();
    stepBegan = cc->getTime();
    const int interval = (int) scalar("interval"), removal = (int) scalar("removal");
    const bool always = scalar("always") != 0;
    double &calls = scalar("calls");
    bool begins = true;
    for (int i = 0; i < steps; i++) {
        if (begins) {
            if (forcesStale || cc->getComputeForceCount() != forceCount || getIntegrationForceGroups() != forceGroups)
                carryOut("forces");
            carryOut("open");
        }
        carryOut("body");
        calls++;
        const bool acts = always || (interval > 0 && updates + (long long) calls >= interval);
        const bool due = acts || (removal > 0 && (cc->getStepCount() + 1) % removal == 0);
        begins = due || i == steps - 1;
        carryOut(begins ? "close" : "between");
        if (due) {
            update((int) calls, acts && sequences.count("leave"));
            calls = 0;
        }
    }
}

// Execute a sequence outside of a step.
void ProgramIntegrator::runAlone(const string& name) {
    requireDevice();
    Current current(cc);
    uploadBox();
    stepBegan = cc->getTime();
    carryOut(name);
    for (const Operation& o : sequences[name])
        forcesStale |= o.kind == Operation::Forces || (o.kind == Operation::Run && kernels[o.which].places());
}

// Perform OpenMM's updates (barostats, thermostats, CMMotionRemover) for the last `calls` steps.
void ProgramIntegrator::update(int calls, bool leaves) {
    const int interval = (int) scalar("interval");
    updates = interval > 0 && updates + calls >= interval ? 0 : updates + calls;
    auto behind = [&](const string& name) {
        carryOut(leaves && sequences.count("leave_" + name) ? "leave_" + name : name);
    };
    if (leaves)
        carryOut("leave");
    const long long count = cc->getStepCount();
    bool moved = false;
    updating = true;
    for (int i = 1; i <= calls; i++) {
        cc->setStepCount(count - calls + i);
        moved |= context->updateContextState();
    }
    updating = false;
    behind("pushed");
    if (moved) {
        uploadBox();
        uploadPlaces();
        behind("moved");
    }
    if (leaves)
        carryOut("return");
    if (moved || leaves)
        forcesStale = true;
}

// -- saved and loaded states ------------------------------------------------------------------------------------------

// Save the state of the Context and of the program for `restore`.
void ProgramIntegrator::keep() {
    requireDevice();
    Current current(cc);
    kept.time = cc->getTime(), kept.steps = cc->getStepCount();
    cc->getPeriodicBoxVectors(kept.box[0], kept.box[1], kept.box[2]);
    kept.order = cc->getAtomIndex(), kept.cells = cc->getPosCellOffsets(), kept.scalars = scalars;
    vector<ArrayInterface*> state = {&cc->getPosq(), &cc->getVelm()};
    if (cc->getUseMixedPrecision())
        state.push_back(&cc->getPosqCorrection());
    for (Array& a : arrays)
        if (a.saved)
            state.push_back(a.device.get());
    for (ArrayInterface* array : state) {
        DeviceArray& copy = kept.copies[array];
        if (!copy)
            copy = made(array->getSize(), array->getElementSize(), array->getName() + "Kept");
        array->copyTo(*copy);
    }
}

// Restore the order of the atoms. OpenMM stores charges beside positions. They are no part of the state, because they may
// have changed with parameters since `keep`, so the kept positions receive the present charges.
template <class Real4> void ProgramIntegrator::restoreOrder() {
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

void ProgramIntegrator::restore() {
    requireDevice();
    if (kept.copies.empty())
        throw error("nothing was kept");
    Current current(cc);
    cc->setTime(kept.time), cc->setStepCount(kept.steps);
    updating = true;
    context->setPeriodicBoxVectors(kept.box[0], kept.box[1], kept.box[2]);
    if (cc->getUseDoublePrecision())
        restoreOrder<mm_double4>();
    else
        restoreOrder<mm_float4>();
    for (auto& pair : kept.copies)
        pair.second->copyTo(*pair.first);
    vector<Vec3> x, v;  // set through OpenMM, which then updates all data that depend on them
    context->getPositions(x), context->getVelocities(v);
    context->setPositions(x), context->setVelocities(v);
    updating = false;
    scalars = kept.scalars;
    placesStale = forcesStale = true;
}

// Upload the host's values of an array to the device.
void ProgramIntegrator::show(Array& a) {
    if (a.device) {
        Current current(cc);
        a.device->upload(a.data.data());
    }
}

void ProgramIntegrator::upload(const string& name, const void* data, size_t bytes) {
    Array& a = arrays[indexOf(arrays, name, "array")];
    if (bytes != a.bytes())
        throw error("wrong size of " + name);
    memcpy(a.data.data(), data, bytes);
    show(a);
}

void ProgramIntegrator::download(const string& name, void* data, size_t bytes) {
    Array& a = arrays[indexOf(arrays, name, "array")];
    if (bytes != a.bytes())
        throw error("wrong size of " + name);
    if (a.device) {
        Current current(cc);
        a.device->download(a.data.data());
    }
    memcpy(data, a.data.data(), bytes);
}

// Binary format of saved states: pairs of a name and a value, for scalars and then for arrays. An empty name ends each
// list.
template <class T> void put(std::ostream& stream, const T& value) {
    stream.write(reinterpret_cast<const char*>(&value), sizeof(T));
}
template <class T> T get(std::istream& stream) {
    T value = T();
    stream.read(reinterpret_cast<char*>(&value), sizeof(T));
    return stream ? value : T();
}
template <class Bytes> void putBytes(std::ostream& stream, const Bytes& bytes) {
    put<size_t>(stream, bytes.size());
    stream.write(bytes.data(), bytes.size());
}
template <class Bytes> Bytes getBytes(std::istream& stream) {
    Bytes bytes(get<size_t>(stream), 0);
    stream.read(&bytes[0], bytes.size());
    return bytes;
}
const int Mark = 0x45584152;

// Write all scalars, and the arrays that are marked as saved or, if `all`, all arrays.
void ProgramIntegrator::save(std::ostream& stream, bool all) const {
    for (const Scalar& s : scalars)
        putBytes(stream, s.name), put(stream, s.value);
    putBytes(stream, string());
    for (const Array& a : arrays)
        if (a.saved || all)
            putBytes(stream, a.name), putBytes(stream, present(a));
    putBytes(stream, string());
}

void ProgramIntegrator::load(std::istream& stream) {
    loaded = Loaded();
    for (string name = getBytes<string>(stream); !name.empty(); name = getBytes<string>(stream))
        loaded.scalars[name] = get<double>(stream);
    for (string name = getBytes<string>(stream); !name.empty(); name = getBytes<string>(stream))
        loaded.arrays[name] = getBytes<vector<char> >(stream);
    takeLoaded();
}

void ProgramIntegrator::createCheckpoint(std::ostream& stream) const {
    CustomIntegrator::createCheckpoint(stream);
    put(stream, Mark);
    put(stream, changes);
    save(stream, false);
}

void ProgramIntegrator::loadCheckpoint(std::istream& stream) {
    CustomIntegrator::loadCheckpoint(stream);
    forcesStale = placesStale = loading = true;
    changes = 7;
    if (get<int>(stream) != Mark)  // another kind of integrator wrote the stream
        return;
    changes = get<int>(stream) | Loads;
    load(stream);
}

// Return the values of an array, from the device if it exists there.
vector<char> ProgramIntegrator::present(const Array& a) const {
    vector<char> data = a.data;
    if (a.device) {
        Current current(cc);
        a.device->download(data.data());
    }
    return data;
}

string hex(const string& data) {
    static const char* digits = "0123456789abcdef";
    string text;
    text.reserve(2 * data.size());
    for (unsigned char c : data)
        text += digits[c >> 4], text += digits[c & 15];
    return text;
}

string unhex(const string& text) {
    string data(text.size() / 2, 0);
    auto digit = [](char c) { return c <= '9' ? c - '0' : c - 'a' + 10; };
    for (size_t i = 0; i < data.size(); i++)
        data[i] = digit(text[2 * i]) << 4 | digit(text[2 * i + 1]);
    return data;
}

string ProgramIntegrator::savedText(bool all) const {
    std::ostringstream stream;
    save(stream, all);
    return hex(stream.str());
}

void ProgramIntegrator::loadText(const string& text) {
    std::istringstream stream(unhex(text));
    load(stream);
}

void ProgramIntegrator::serializeParameters(SerializationNode& node) const {
    CustomIntegrator::serializeParameters(node);
    node.createChildNode("Program").setIntProperty("changes", changes).setStringProperty("data", savedText(false));
}

void ProgramIntegrator::deserializeParameters(const SerializationNode& node) {
    CustomIntegrator::deserializeParameters(node);
    forcesStale = true;
    for (const SerializationNode& own : node.getChildren())
        if (own.getName() == "Program") {
            changes = own.getIntProperty("changes") | Loads;
            loadText(own.getStringProperty("data"));
        }
}

class Proxy : public SerializationProxy {
public:
    Proxy() : SerializationProxy("ProgramIntegrator") {
    }
    void serialize(const void* object, SerializationNode& node) const override {
        const ProgramIntegrator& integrator = *static_cast<const ProgramIntegrator*>(object);
        node.setIntProperty("version", 1);
        node.setDoubleProperty("stepSize", integrator.getStepSize());
        node.setDoubleProperty("constraintTolerance", integrator.getConstraintTolerance());
        node.setIntProperty("forceGroups", integrator.getIntegrationForceGroups());
        node.setIntProperty("randomSeed", integrator.getRandomNumberSeed());
        node.setStringProperty("kineticEnergyExpression", integrator.getKineticEnergyExpression());
        for (int i = 0; i < integrator.getNumGlobalVariables(); i++)
            node.createChildNode("Global").setStringProperty("name", integrator.getGlobalVariableName(i)).setDoubleProperty("value", integrator.getGlobalVariable(i));
        node.setStringProperty("program", hex(integrator.program)).setStringProperty("data", integrator.savedText(true));
    }
    void* deserialize(const SerializationNode& node) const override {
        std::unique_ptr<ProgramIntegrator> integrator(new ProgramIntegrator(node.getDoubleProperty("stepSize")));
        integrator->setConstraintTolerance(node.getDoubleProperty("constraintTolerance", 1e-5));
        integrator->setIntegrationForceGroups(node.getIntProperty("forceGroups", -1));
        integrator->setRandomNumberSeed(node.getIntProperty("randomSeed", 0));
        integrator->setKineticEnergyExpression(node.getStringProperty("kineticEnergyExpression", integrator->getKineticEnergyExpression()));
        for (const SerializationNode& child : node.getChildren())
            integrator->addGlobalVariable(child.getStringProperty("name"), child.getDoubleProperty("value"));
        integrator->setProgram(unhex(node.getStringProperty("program", "")));
        integrator->loadText(node.getStringProperty("data", ""));
        return integrator.release();
    }
};

// -- for ctypes -------------------------------------------------------------------------------------------------------

thread_local string lastError;

template <class Action> int guarded(void* pointer, Action action) {
    try {
        ProgramIntegrator* integrator = dynamic_cast<ProgramIntegrator*>(static_cast<Integrator*>(pointer));
        if (integrator == NULL)
            throw error("this is another integrator");
        action(*integrator);
        return 0;
    }
    catch (std::exception& e) {
        lastError = e.what();
        return 1;
    }
}

// Return "8.6" for "8.6.1" and for "8.6". Classes have the same layout in all versions that have the same result.
string minorVersion(const string& version) {
    return version.substr(0, version.find('.', version.find('.') + 1));
}

} // namespace

#pragma GCC visibility push(default)
extern "C" {

// Register the class for XmlSerializer. If the library was built for another version of OpenMM, return that version.
const char* pi_register() {
    static bool done = false;
    if (minorVersion(Platform::getOpenMMVersion()) != minorVersion(BUILT_FOR))
        return BUILT_FOR;
    if (!done)
        SerializationProxy::registerProxy(typeid(ProgramIntegrator), new Proxy());
    done = true;
    return NULL;
}
void registerPlatforms() {  // required by Platform.loadPluginLibrary
}
void registerKernelFactories() {
    pi_register();
}
const char* pi_error() {
    return lastError.c_str();
}
// Define an exported function that returns 0, or 1 after an error.
#define EXPORT(name, parameters, action) \
    int pi_##name parameters { \
        return guarded(integrator, [&](ProgramIntegrator& it) { action; }); \
    }
int pi_owns(void* integrator) {
    return guarded(integrator, [](ProgramIntegrator&) {}) == 0;
}
EXPORT(program, (void* integrator, const char* text), it.setProgram(text))
EXPORT(upload, (void* integrator, const char* name, const void* data, size_t bytes), it.upload(name, data, bytes))
EXPORT(download, (void* integrator, const char* name, void* data, size_t bytes), it.download(name, data, bytes))
EXPORT(set, (void* integrator, const char* name, double value), it.scalar(name) = value)
EXPORT(get, (void* integrator, const char* name, double* value), *value = it.scalar(name))
EXPORT(steps, (void* integrator, int steps), it.makeSteps(steps))
EXPORT(run, (void* integrator, const char* sequence), it.runAlone(sequence))
EXPORT(keep, (void* integrator), it.keep())
EXPORT(restore, (void* integrator), it.restore())
EXPORT(count, (void* integrator, int which, long long* value), *value = which == 0 ? it.launches : it.forceCalls)
// Return the bits of external changes, and then clear some of them.
EXPORT(changes, (void* integrator, int clear, int* value), *value = it.changes; it.changes &= ~clear)
}
#pragma GCC visibility pop
