// Kernels compiled for processors: the texts for devices, as members of structs whose data members are the constants that
// devices know as macros.
#ifndef EXACTRB_KERNELS_H_
#define EXACTRB_KERNELS_H_

#include "openmm/internal/ThreadPool.h"
#include <cstdlib>
#include <functional>
#include <locale>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

namespace exactrb {

// An argument of a kernel.
union Value {
    void* pointer;
    long long integer;
    double real;
};
typedef std::function<void(const Value*)> Function;
typedef std::map<std::string, std::string> Constants;

class Kernels {
public:
    virtual ~Kernels() {
    }
    // Return the kernel with a name, or an empty function.
    virtual Function function(const std::string& name) = 0;
};

// The kernels by the names of `Source`; `threads` is NULL on a single thread.
typedef std::unique_ptr<Kernels> (*Maker)(const Constants& constants, OpenMM::ThreadPool* threads);
std::unique_ptr<Kernels> rigidKernels(const Constants& constants, OpenMM::ThreadPool* threads);
std::unique_ptr<Kernels> flexibleKernels(const Constants& constants, OpenMM::ThreadPool* threads);
std::unique_ptr<Kernels> thermostatKernels(const Constants& constants, OpenMM::ThreadPool* threads);

template <class T> struct Read;
template <class T> struct Read<T*> {
    static T* of(const Value& v) {
        return static_cast<T*>(v.pointer);
    }
};
template <> struct Read<int> {
    static int of(const Value& v) {
        return (int) v.integer;
    }
};
template <> struct Read<long long> {
    static long long of(const Value& v) {
        return v.integer;
    }
};
template <> struct Read<double> {
    static double of(const Value& v) {
        return v.real;
    }
};
template <class K, class... A, size_t... I> void call(K& k, void (K::*f)(A...), const Value* v, std::index_sequence<I...>) {
    (k.*f)(Read<A>::of(v[I])...);
}
template <class K, class... A> void call(K& k, void (K::*f)(A...), const Value* v) {
    call(k, f, v, std::index_sequence_for<A...>());
}

// The kernels of a struct K, with one object for each thread. K has `thread`, `n_threads` and a constructor from the
// constants.
template <class K> class KernelsOf : public Kernels {
public:
    KernelsOf(const Constants& constants, OpenMM::ThreadPool* threads) : threads(threads) {
        const int n = threads == NULL ? 1 : threads->getNumThreads();
        for (int i = 0; i < n; i++) {
            each.emplace_back(constants);
            each.back().thread = i;
        }
    }
    Function function(const std::string& name) override {
        return K::function(*this, name);
    }
    template <class... A> Function alone(void (K::*f)(A...)) {
        return [this, f](const Value* v) {
            call(each[0], f, v);
        };
    }
    // A kernel for at most `most` threads.
    template <class... A> Function together(void (K::*f)(A...), int most) {
        const int n = std::min(most, (int) each.size());
        if (n < 2)
            return alone(f);
        return [this, f, n](const Value* v) {
            threads->execute([this, f, n, v](OpenMM::ThreadPool&, int index) {
                if (index < n) {
                    each[index].n_threads = n;
                    call(each[index], f, v);
                    each[index].n_threads = 1;
                }
            });
            threads->waitForThreads();
        };
    }
    const K& first() const {
        return each[0];
    }

private:
    OpenMM::ThreadPool* threads;
    std::vector<K> each;
};

inline int integer(const Constants& constants, const char* name) {
    auto found = constants.find(name);
    return found == constants.end() ? 0 : std::atoi(found->second.c_str());
}
// Read a number independently of the locale, unlike strtod.
inline double number_in(const std::string& text) {
    std::istringstream words(text);
    words.imbue(std::locale::classic());
    double number = 0.0;
    words >> number;
    return number;
}
inline double real(const Constants& constants, const char* name) {
    auto found = constants.find(name);
    return found == constants.end() ? 0.0 : number_in(found->second);
}

} // namespace exactrb
#endif
