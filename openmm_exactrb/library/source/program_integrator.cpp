// An OpenMM Integrator whose steps are a program: named arrays on the device, kernels given as text, and sequences of
// operations. The integrator contains no physics. The library links only to libOpenMM. It calls OpenCL, CUDA and HIP
// through the virtual functions of ComputeContext, and looks up a few non-virtual functions in the platform's library.
//
// Without a program, the integrator is a CustomIntegrator, and it keeps the global variables when it has a program.
// Python starts the steps of a program after checking that the arrays agree with the Context (library.py). If C++ calls
// `step`, the integrator calls Python. The lines of a program are described in program.py.
#include "expressions.h"
#include "kernels.h"
#include "machine.h"
#include "openmm/Context.h"
#include "openmm/CustomIntegrator.h"
#include "openmm/Platform.h"
#include "openmm/System.h"
#include "openmm/serialization/SerializationNode.h"
#include "openmm/serialization/SerializationProxy.h"
#include <atomic>
#include <csignal>
#include <cstring>
#include <sstream>

using namespace OpenMM;
using std::string;
using std::vector;

namespace {

using namespace exactrb;
using exactrb::Kernel;  // and not OpenMM's class

struct Scalar {
    string name;
    double value;
};

const int Loads = 8;
const string Prefix = "exactrb_";  // of the names of all variables

// Functions of Python, which return 0, or another number after a call of pi_fail. `number` identifies an integrator.
// The text is the message about a State whose variables an integrator lacks.
struct Hooks {
    int (*bound)(void* integrator, long long number) = NULL;  // a Context is being created
    int (*step)(long long number, int steps) = NULL;
    int (*asked)(long long number) = NULL;  // the tolerance of constraints is needed, as at the start of a minimisation
    string otherFormat;
} hooks;
std::atomic<long long> created(0);
thread_local string lastError;
thread_local bool interrupted = false;  // whether a signal has interrupted Python in its main thread

// Call Python, and throw the error that the call ends with, which is 1. After an interruption, the signal is repeated, so that
// Python raises KeyboardInterrupt as soon as it runs again. ctypes returns another number if an interruption precedes the
// first instruction of the function.
template <class Call> void callPython(Call call) {
    interrupted = false;
    const int ending = call();
    if (ending == 0)
        return;
    if (ending == 1 && !interrupted)
        throw OpenMMException(lastError);
    std::raise(SIGINT);
}

// The integrator that the next integrator read from XML by this thread is, so that SWIG creates an object for it.
thread_local Integrator* handed = NULL;

struct Operation {
    enum Kind { Run, Forces, Sites, Reorder, Clock, Step, Add, Copy } kind;
    int which = 0, other = 0;
    double value = 0;
};

class ProgramIntegrator : public CustomIntegrator, private Reordered {
public:
    explicit ProgramIntegrator(double stepSize) : CustomIntegrator(stepSize), number(++created) {
    }
    const long long number;  // unlike its address, no other integrator has it later
    double getConstraintTolerance() const override {
        if (hasSettings() && context != NULL && hooks.asked != NULL)
            callPython([&]() { return hooks.asked(number); });
        return CustomIntegrator::getConstraintTolerance();
    }
    void setProgram(const string& text);
    void step(int steps) override;
    void makeSteps(int steps);
    void makeOwnPart(int steps);
    void runAlone(const string& sequence);
    void perform(int steps, bool shows, double* result);
    void show();
    void report(bool shown, double* totals);
    void keep(int slot);
    void restore(int slot);
    void storeNumbers();
    void upload(const string& name, const void* data, size_t bytes);
    void download(const string& name, void* data, size_t bytes);
    double& scalar(const string& name) {
        return scalars[indexOf(scalars, name, "scalar")].value;
    }
    // External changes to the Context since these bits were cleared: 1 for positions, 2 for velocities, 4 for forces with
    // changed parameters, and 8 for a loaded checkpoint or State.
    int changes = 7;
    // Another part of a CompoundIntegrator moves particles without notice, but counts steps.
    void noticeSteps() {
        if (machine && lastStep >= 0 && machine->stepCount() != lastStep)
            changes |= 3, forcesStale = placesStale = true;
        lastStep = machine ? machine->stepCount() : -1;
    }
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
        return hasProgram() ? machine->kineticEnergy() : CustomIntegrator::computeKineticEnergy();
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
    void reordered() override {
        placesStale = forcesStale = true;
    }
    bool hasProgram() const {
        return machine && !program.empty();
    }
    // Whether Python stored the settings of an integrator, and performs its steps.
    bool hasSettings() const {
        return getKineticEnergyExpression().find(Prefix + "settings") != string::npos;
    }
    void show(int index);
    vector<char> present(int index) const;
    void save(std::ostream& stream) const;
    void load(std::istream& stream);
    string savedText() const;
    void loadText(const string& text);
    void takeNumbers(const SerializationNode& node);
    Operation operation(const string& word, std::istringstream& words) const;
    void takeLoaded();
    void requireMachine() const {
        if (!hasProgram())
            throw error("there is no Context on a processor or on one device with double precision, or no program");
    }
    void build();
    const vector<Operation>& sequence(const string& name) const;
    double fingerprint();
    void carryOut(const vector<Operation>& operations);
    void launch(int index);
    void evaluate(int groups);
    void update(int calls, bool leaves);
    void takeBox();
    void takeParameters();
    string program;
    vector<Source> sources;
    vector<Array> arrays;
    vector<Scalar> scalars;
    int numbers = 0;                // index of the array of persistent numbers
    vector<string> namesOfNumbers;  // global variables with the same values after each call
    int parameters = 0;             // index of the array of parameters of the Context
    vector<string> namesOfParameters;
    vector<Kernel> kernels;
    std::map<string, vector<Operation> > sequences;

    std::unique_ptr<Machine> machine;  // NULL without a Context, or on other platforms
    struct Loaded {  // values from a checkpoint or State, until a program is set
        std::map<string, double> scalars;
        std::map<string, vector<char> > arrays;
    } loaded;
    bool forcesStale = true, placesStale = true, updating = false, loading = false;
    int forceGroups = 0;
    double stepBegan = 0;  // in ps
    long long lastStep = -1;  // the step count after the last steps of this integrator, or -1 if it is unknown
    long long updates = 0;  // since the barostat's last move; like the barostat's own counter, not saved

    struct Kept {  // the state saved by `keep`
        double time = 0;
        long long steps = 0;
        Vec3 box[3];
        vector<Scalar> scalars;
        bool any = false;
    } slots[SLOTS];
    void forget() {
        for (Kept& kept : slots)
            kept = Kept();
    }
};

// -- the program ------------------------------------------------------------------------------------------------------

void ProgramIntegrator::setProgram(const string& text) {
    if (text == program)
        return;
    if (machine)
        machine->release();
    forget();
    program.clear(), sources.clear(), arrays.clear(), scalars.clear(), namesOfNumbers.clear(), namesOfParameters.clear(), kernels.clear(), sequences.clear();
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
        else if (word == "numbers") {
            words >> name;
            numbers = indexOf(arrays, name, "array");
            while (words >> name)
                namesOfNumbers.push_back(name);
        }
        else if (word == "parameters") {
            words >> name;
            parameters = indexOf(arrays, name, "array");
            while (words >> name)
                namesOfParameters.push_back(name);
        }
        else if (word == "source") {
            size_t bytes = 0;
            words >> bytes;
            Source source;
            source.text.assign(bytes, ' ');
            lines.read(&source.text[0], bytes);
            sources.push_back(source);
        }
        else if (word == "compiled") {
            int count = 0;
            Source source;
            words >> source.name >> count;
            for (int i = 0; i < count && std::getline(lines, line); i++)
                source.constants[line.substr(0, line.find(' '))] = line.substr(line.find(' ')+1);
            sources.push_back(source);
        }
        else if (word == "kernel") {
            Kernel k;
            k.source = (int) sources.size() - 1;
            words >> k.name >> k.function >> k.threads >> k.block;
            while (words >> word) {
                if (word == "#step")
                    k.scalars.push_back({(int) k.arguments.size(), StepCount});
                else if (word[0] == '$')
                    k.scalars.push_back({(int) k.arguments.size(), word == "$h" ? (int) StepSize : indexOf(scalars, word.substr(1), "scalar")});
                k.arguments.push_back(word);
            }
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
    build();
}

// Set arrays and scalars to loaded values of the same name and size.
void ProgramIntegrator::takeLoaded() {
    for (Scalar& s : scalars)
        if (loaded.scalars.count(s.name))
            s.value = loaded.scalars[s.name];
    for (size_t i = 0; i < arrays.size(); i++) {
        auto found = loaded.arrays.find(arrays[i].name);
        if (found == loaded.arrays.end() || found->second.size() != arrays[i].bytes())
            continue;
        arrays[i].data = found->second;
        show((int) i);
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
    machine = deviceOf(impl, *this);
    if (!machine)
        machine = processorOf(impl);
    changes = 7;
    lastStep = -1;
    forcesStale = placesStale = true;
    build();
    if (hasSettings() && hooks.bound != NULL)
        callPython([&]() { return hooks.bound(static_cast<Integrator*>(this), number); });
}

void ProgramIntegrator::cleanup() {
    CustomIntegrator::cleanup();
    if (hasProgram()) {
        try {
            for (size_t i = 0; i < arrays.size(); i++)
                machine->download((int) i, arrays[i].data.data());
        }
        catch (OpenMMException&) {  // the device is lost, and its Context is being destroyed
        }
    }
    forget();
    machine.reset();
}

void ProgramIntegrator::build() {
    if (hasProgram())
        machine->build(sources, arrays, kernels);
}

void ProgramIntegrator::takeBox() {
    vector<double> now(9, 0.0);
    if (context->getSystem().usesPeriodicBoundaryConditions()) {
        Vec3 a, b, c;
        context->getPeriodicBoxVectors(a, b, c);
        now = {a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]};
    }
    if (machine->takeBox(now))
        forcesStale = true;
}

// Write the parameters of the Context to their array if they have changed. Parameters of forces that were added to the System
// later are not in the Context, and keep their values.
void ProgramIntegrator::takeParameters() {
    if (namesOfParameters.empty())
        return;
    const Array& array = arrays[parameters];
    vector<double> now(namesOfParameters.size());
    memcpy(now.data(), array.data.data(), array.bytes());
    for (size_t i = 0; i < now.size(); i++) {
        auto found = context->getParameters().find(namesOfParameters[i]);
        now[i] = found == context->getParameters().end() ? now[i] : found->second;
    }
    if (memcmp(now.data(), array.data.data(), array.bytes()) != 0)
        upload(array.name, now.data(), array.bytes());
}

// Launch a kernel. Its arguments are the names of arrays of OpenMM or of the program, a scalar $name, the step size $h,
// the step count #step (long long), or an integer (int).
void ProgramIntegrator::launch(int index) {
    if (placesStale)
        machine->takePlaces();
    placesStale = false;
    const Kernel& k = kernels[index];
    for (auto& scalar : k.scalars) {
        if (scalar.second == StepCount)
            machine->set(index, scalar.first, machine->stepCount());
        else
            machine->set(index, scalar.first, scalar.second == StepSize ? getStepSize() : scalars[scalar.second].value);
    }
    machine->launch(k, index);
    launches++;
}

// Evaluate the forces of those groups (bits) that are active.
void ProgramIntegrator::evaluate(int groups) {
    machine->checkPlaces();
    context->calcForcesAndEnergy(true, false, groups & getIntegrationForceGroups());
    machine->takeForces();
    takeParameters();
    forceGroups = getIntegrationForceGroups(), forcesStale = false;
    forceCalls++;
}

// Return the operations of a sequence, or none if the program has no such sequence.
const vector<Operation>& ProgramIntegrator::sequence(const string& name) const {
    static const vector<Operation> none;
    auto found = sequences.find(name);
    return found == sequences.end() ? none : found->second;
}

void ProgramIntegrator::carryOut(const vector<Operation>& operations) {
    for (const Operation& o : operations) {
        switch (o.kind) {
        case Operation::Run:
            launch(o.which);
            break;
        case Operation::Forces:
            evaluate(o.which);
            break;
        case Operation::Sites:
            machine->computeVirtualSites();
            break;
        case Operation::Reorder:
            machine->reorderAtoms();
            break;
        case Operation::Clock:
            machine->setTime(stepBegan + o.value * getStepSize());
            break;
        case Operation::Step:
            machine->setTime(stepBegan += getStepSize());
            machine->setStepCount(machine->stepCount() + 1);
            break;
        case Operation::Add:
            scalars[o.which].value += o.value;
            break;
        case Operation::Copy:
            machine->copy(o.which, o.other);
            break;
        }
    }
}

// Let Python perform steps that C++ starts, such as those of a part of a CompoundIntegrator.
void ProgramIntegrator::step(int steps) {
    if (!hasSettings() && program.empty())
        CustomIntegrator::step(steps);
    else if (context == NULL)
        throw OpenMMException("This Integrator is not bound to a context!");
    else if (hooks.step == NULL)
        throw error("Python performs the steps of this integrator of openmm_exactrb: import openmm_exactrb first");
    else
        callPython([&]() { return hooks.step(number, steps); });
}

// Perform steps with these sequences of the program. "forces" evaluates the forces that "open" needs, unless they are
// known. "open" begins a step, "body" continues it up to its last force evaluation, and "close" ends it. "between"
// combines "close" with the following "open". If they exist, "hold" ends a call instead of "close", and "resume" begins
// the next call, so that the two have the same result as "between".
//
// OpenMM updates the Context when a barostat acts, after every "interval" updates, or after every step if "always" is
// not 0, and when the number of steps is a multiple of "removal". A value of 0 means never. "pushed" follows an update,
// and "moved" follows if positions changed. Updates in which barostats act are preceded by the sequence "leave", if it
// exists, and followed by "return"; "leave_pushed" and "leave_moved" then replace "pushed" and "moved" if they exist.
void ProgramIntegrator::makeSteps(int steps) {
    requireMachine();
    Current current(*machine);
    takeBox();
    takeParameters();
    stepBegan = machine->time();
    const int interval = (int) scalar("interval"), removal = (int) scalar("removal");
    const bool always = scalar("always") != 0;
    double &calls = scalar("calls"), &held = scalar("held");
    const vector<Operation> &forces = sequence("forces"), &open = sequence("open"), &body = sequence("body");
    const vector<Operation> &between = sequence("between"), &close = sequence("close");
    const bool holds = sequences.count("hold") > 0;
    bool begins = true;
    for (int i = 0; i < steps; i++) {
        if (begins && held != 0 && holds)
            carryOut(sequence("resume"));
        else if (begins) {
            if (forcesStale || !machine->hasForces() || getIntegrationForceGroups() != forceGroups)
                carryOut(forces);
            carryOut(open);
        }
        held = 0;
        carryOut(body);
        calls++;
        const bool acts = always || (interval > 0 && updates + (long long) calls >= interval);
        const bool due = acts || (removal > 0 && (machine->stepCount() + 1) % removal == 0);
        begins = due || i == steps - 1;
        if (begins && !due && holds) {
            carryOut(sequence("hold"));
            held = 1;
        }
        else
            carryOut(begins ? close : between);
        if (due) {
            update((int) calls, acts && sequences.count("leave"));
            calls = 0;
        }
    }
    lastStep = machine->stepCount();
}

// Perform OpenMM's own part of steps (barostats, thermostats, CMMotionRemover), and advance the time.
void ProgramIntegrator::makeOwnPart(int steps) {
    if (context == NULL)
        throw error("there is no Context");
    for (int i = 0; i < steps; i++) {
        context->updateContextState();
        context->setTime(context->getTime() + getStepSize());
        context->setStepCount(context->getStepCount() + 1);
    }
    lastStep = context->getStepCount();
}

// Execute a sequence outside of a step, or the sequence with "_held" added to its name after a call that ended with "hold".
void ProgramIntegrator::runAlone(const string& name) {
    requireMachine();
    Current current(*machine);
    takeBox();
    takeParameters();
    stepBegan = machine->time();
    const string used = scalar("held") != 0 && sequences.count(name + "_held") ? name + "_held" : name;
    carryOut(sequence(used));
    for (const Operation& o : sequence(used))
        forcesStale |= o.kind == Operation::Forces || (o.kind == Operation::Run && kernels[o.which].places());
}

// A number that identifies all to which the inner state of a processed scheme belongs, except forces: the settings, the
// box, the parameters and the time.
double ProgramIntegrator::fingerprint() {
    unsigned long long hash = 14695981039346656037ULL;  // FNV-1a
    auto add = [&](const void* data, size_t bytes) {
        for (size_t i = 0; i < bytes; i++)
            hash = (hash^static_cast<const unsigned char*>(data)[i])*1099511628211ULL;
    };
    const double settings = scalar("settings"), time = machine->time();
    add(&settings, sizeof(settings)), add(&time, sizeof(time));
    Vec3 box[3];
    context->getPeriodicBoxVectors(box[0], box[1], box[2]);
    add(box, sizeof(box));
    for (auto& parameter : context->getParameters())
        add(parameter.first.data(), parameter.first.size()), add(&parameter.second, sizeof(parameter.second));
    return 1.0+(double) (hash>>16);
}

// Show the state of a processed scheme in the Context: by "output" if "turn" is at least "enough", else by "postprocess".
void ProgramIntegrator::show() {
    runAlone(scalar("turn") >= scalar("enough") ? "output" : "postprocess");
}

// Compute the kinetic energies of translation and rotation, and the number of invalid bodies, of the state that the Context
// shows or of the inner state.
void ProgramIntegrator::report(bool shown, double* totals) {
    runAlone(shown ? "report" : "report_inner");
    download("totals", totals, 3*sizeof(double));
}

// Keep the state, perform steps, show the result if `shows` is true or the scheme is not processed, report on it, and store
// the persistent numbers. The
// fourth number of the result is `forceCalls`. "inner" is the fingerprint of the inner state, or 0 without one.
void ProgramIntegrator::perform(int steps, bool shows, double* result) {
    keep(0);
    const bool processed = sequences.count("enter") > 0;
    if (processed && scalar("inner") != fingerprint()) {
        runAlone("enter");
        scalar("turn") = scalar("held") = 0;
        scalar("inner") = fingerprint();
    }
    makeSteps(steps);
    if (processed) {
        scalar("inner") = fingerprint();  // a barostat may have changed the box
        if (shows)
            show();
    }
    report(shows || !processed, result);
    result[3] = (double) forceCalls;
    storeNumbers();
}

// Perform OpenMM's updates (barostats, thermostats, CMMotionRemover) for the last `calls` steps.
void ProgramIntegrator::update(int calls, bool leaves) {
    const int interval = (int) scalar("interval");
    updates = interval > 0 && updates + calls >= interval ? 0 : updates + calls;
    auto behind = [&](const string& name) {
        carryOut(sequence(leaves && sequences.count("leave_" + name) ? "leave_" + name : name));
    };
    if (leaves)
        carryOut(sequence("leave"));
    const long long count = machine->stepCount();
    bool moved = false;
    updating = true;
    for (int i = 1; i <= calls; i++) {
        machine->setStepCount(count - calls + i);
        moved |= context->updateContextState();
    }
    updating = false;
    behind("pushed");
    if (moved) {
        takeBox();
        placesStale = true;
        behind("moved");
    }
    if (leaves)
        carryOut(sequence("return"));
    if (moved || leaves)
        forcesStale = true;
}

// -- saved and loaded states ------------------------------------------------------------------------------------------

// Save the state of the Context and of the program for `restore`.
void ProgramIntegrator::keep(int slot) {
    requireMachine();
    Kept& kept = slots[slot];
    Current current(*machine);
    kept.time = machine->time(), kept.steps = machine->stepCount(), kept.scalars = scalars, kept.any = true;
    context->getPeriodicBoxVectors(kept.box[0], kept.box[1], kept.box[2]);
    machine->keep(arrays, slot);
}

void ProgramIntegrator::restore(int slot) {
    requireMachine();
    const Kept& kept = slots[slot];
    if (!kept.any)
        throw error("nothing was kept");
    Current current(*machine);
    machine->setTime(kept.time), machine->setStepCount(lastStep = kept.steps);
    updating = true;
    context->setPeriodicBoxVectors(kept.box[0], kept.box[1], kept.box[2]);
    machine->restore(slot);
    updating = false;
    scalars = kept.scalars;
    placesStale = forcesStale = true;
    storeNumbers();
}

// Copy the persistent numbers to the global variables, which other engines read from a checkpoint.
void ProgramIntegrator::storeNumbers() {
    if (namesOfNumbers.empty())
        return;
    const vector<char> values = present(numbers);
    for (size_t i = 0; i < namesOfNumbers.size(); i++) {
        double value;
        memcpy(&value, values.data()+i*sizeof(double), sizeof(double));
        setGlobalVariableByName(namesOfNumbers[i], value);
    }
}

// Take the host's values of an array.
void ProgramIntegrator::show(int index) {
    if (machine && machine->built())
        machine->upload(arrays[index], index);
}

void ProgramIntegrator::upload(const string& name, const void* data, size_t bytes) {
    const int index = indexOf(arrays, name, "array");
    if (bytes != arrays[index].bytes())
        throw error("wrong size of " + name);
    memcpy(arrays[index].data.data(), data, bytes);
    show(index);
}

void ProgramIntegrator::download(const string& name, void* data, size_t bytes) {
    const int index = indexOf(arrays, name, "array");
    if (bytes != arrays[index].bytes())
        throw error("wrong size of " + name);
    const vector<char> values = present(index);
    memcpy(data, values.data(), bytes);
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

// Write all scalars, and the arrays that are marked as saved.
void ProgramIntegrator::save(std::ostream& stream) const {
    for (const Scalar& s : scalars)
        putBytes(stream, s.name), put(stream, s.value);
    putBytes(stream, string());
    for (size_t i = 0; i < arrays.size(); i++)
        if (arrays[i].saved)
            putBytes(stream, arrays[i].name), putBytes(stream, present((int) i));
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
    save(stream);
}

void ProgramIntegrator::loadCheckpoint(std::istream& stream) {
    CustomIntegrator::loadCheckpoint(stream);
    forcesStale = placesStale = loading = true;
    changes = 7, lastStep = -1;
    if (get<int>(stream) != Mark)  // another kind of integrator wrote the stream
        return;
    changes = get<int>(stream) | Loads;
    load(stream);
}

// Return the values of an array, from the machine if it has them.
vector<char> ProgramIntegrator::present(int index) const {
    vector<char> data = arrays[index].data;
    if (machine && machine->built())
        machine->download(index, data.data());
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

string ProgramIntegrator::savedText() const {
    std::ostringstream stream;
    save(stream);
    return hex(stream.str());
}

void ProgramIntegrator::loadText(const string& text) {
    std::istringstream stream(unhex(text));
    load(stream);
}

// The numbers are not among the variables of a CustomIntegrator, which other integrators could not read.
void ProgramIntegrator::serializeParameters(SerializationNode& node) const {
    node.setIntProperty("version", 1);
    node.createChildNode("GlobalVariables"), node.createChildNode("PerDofVariables");
    SerializationNode& numbers = node.createChildNode("Numbers");
    for (int i = 0; i < getNumGlobalVariables(); i++)
        numbers.setDoubleProperty(getGlobalVariableName(i), getGlobalVariable(i));
    node.createChildNode("Program").setIntProperty("changes", changes).setStringProperty("data", savedText());
}

// Read the data that an integrator of this library has saved. Those of other integrators are ignored.
void ProgramIntegrator::deserializeParameters(const SerializationNode& node) {
    forcesStale = true;
    lastStep = -1;
    for (const SerializationNode& own : node.getChildren()) {
        if (own.getName() == "Program") {
            changes = own.getIntProperty("changes") | Loads;
            loadText(own.getStringProperty("data"));
        }
        else if (own.getName() == "Numbers" || own.getName() == "GlobalVariables")  // the latter in earlier versions
            takeNumbers(own);
    }
}

void ProgramIntegrator::takeNumbers(const SerializationNode& node) {
    for (auto& property : node.getProperties()) {
        const string& name = property.first;
        if (name.compare(0, Prefix.size(), Prefix) != 0)
            continue;
        int index = 0;
        while (index < getNumGlobalVariables() && getGlobalVariableName(index) != name)
            index++;
        if (index == getNumGlobalVariables())
            throw error(hooks.otherFormat);
        setGlobalVariable(index, node.getDoubleProperty(name));
    }
}

class Proxy : public SerializationProxy {
public:
    Proxy() : SerializationProxy("openmm_exactrb (import this package before you read its integrators)") {
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
            node.createChildNode("Global").setStringProperty("name", integrator.getGlobalVariableName(i));
    }
    void* deserialize(const SerializationNode& node) const override {
        if (handed != NULL) {
            Integrator* integrator = handed;
            handed = NULL;
            return integrator;
        }
        std::unique_ptr<ProgramIntegrator> integrator(new ProgramIntegrator(node.getDoubleProperty("stepSize")));
        integrator->setConstraintTolerance(node.getDoubleProperty("constraintTolerance", 1e-5));
        integrator->setIntegrationForceGroups(node.getIntProperty("forceGroups", -1));
        integrator->setRandomNumberSeed(node.getIntProperty("randomSeed", 0));
        integrator->setKineticEnergyExpression(node.getStringProperty("kineticEnergyExpression", integrator->getKineticEnergyExpression()));
        for (const SerializationNode& child : node.getChildren())
            integrator->addGlobalVariable(child.getStringProperty("name"), 0.0);
        return integrator.release();
    }
};

// -- for ctypes -------------------------------------------------------------------------------------------------------

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

extern "C" {

// Register the class for XmlSerializer. If the library was built for another version of OpenMM, return that version.
EXPORTED const char* pi_register() {
    static bool done = false;
    if (minorVersion(Platform::getOpenMMVersion()) != minorVersion(BUILT_FOR))
        return BUILT_FOR;
    if (!done)
        SerializationProxy::registerProxy(typeid(ProgramIntegrator), new Proxy());
    done = true;
    return NULL;
}
EXPORTED void registerPlatforms() {  // required by Platform.loadPluginLibrary
}
EXPORTED void registerKernelFactories() {
    pi_register();
}
EXPORTED const char* pi_error() {
    return lastError.c_str();
}
// Define an exported function that returns 0, or 1 after an error.
#define EXPORT(name, parameters, action) \
    EXPORTED int pi_##name parameters { \
        return guarded(integrator, [&](ProgramIntegrator& it) { action; }); \
    }
EXPORTED int pi_owns(void* integrator) {
    return guarded(integrator, [](ProgramIntegrator&) {}) == 0;
}
EXPORTED void pi_hooks(decltype(Hooks::bound) bound, decltype(Hooks::step) step, decltype(Hooks::asked) asked, const char* otherFormat) {
    hooks.bound = bound, hooks.step = step, hooks.asked = asked, hooks.otherFormat = otherFormat;
}
// State why a function of Python failed, and whether a signal has interrupted it.
EXPORTED void pi_fail(const char* message, int interrupt) {
    lastError = message, interrupted = interrupt != 0;
}
// Return `derivative`, or NULL after an error.
EXPORTED const char* pi_derivative(const char* energy, const char* variable) {
    static thread_local string steps;
    try {
        steps = derivative(energy, variable);
        return steps.c_str();
    }
    catch (std::exception& e) {
        lastError = e.what();
        return NULL;
    }
}
EXPORTED void pi_hand(void* integrator) {
    handed = static_cast<Integrator*>(integrator);
}
EXPORT(notice, (void* integrator), it.noticeSteps())
EXPORT(number, (void* integrator, long long* number), *number = it.number)
EXPORT(program, (void* integrator, const char* text), it.setProgram(text))
EXPORT(upload, (void* integrator, const char* name, const void* data, size_t bytes), it.upload(name, data, bytes))
EXPORT(download, (void* integrator, const char* name, void* data, size_t bytes), it.download(name, data, bytes))
EXPORT(set, (void* integrator, const char* name, double value), it.scalar(name) = value)
EXPORT(get, (void* integrator, const char* name, double* value), *value = it.scalar(name))
EXPORT(steps, (void* integrator, int steps), it.makeSteps(steps))
EXPORT(own, (void* integrator, int steps), it.makeOwnPart(steps))
EXPORT(run, (void* integrator, const char* sequence), it.runAlone(sequence))
EXPORT(perform, (void* integrator, int steps, int shows, double* result), it.perform(steps, shows != 0, result))
EXPORT(show, (void* integrator), it.show())
EXPORT(report, (void* integrator, int shown, double* totals), it.report(shown != 0, totals))
EXPORT(keep, (void* integrator, int slot), it.keep(slot))
EXPORT(restore, (void* integrator, int slot), it.restore(slot))
EXPORT(count, (void* integrator, int which, long long* value), *value = which == 0 ? it.launches : it.forceCalls)
// Return where the bits of external changes are.
EXPORT(changes, (void* integrator, int** bits), *bits = &it.changes)
}
