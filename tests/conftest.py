import gc
import locale
import os
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import settings

import compilation
import openmm_exactrb as rb
from openmm_exactrb.engines.catalogue import ENGINES
from openmm_exactrb.library.library import missing
from openmm_exactrb.mathematics import quaternions
from places import CPU, PLATFORMS, REFERENCE, WHERE, device_platform

# A shell without job control starts background processes with Ctrl-C ignored; tests of interruptions would never end.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples every time: whether a change passes is no matter of luck.
settings.register_profile("fast", max_examples=50, deadline=None, derandomize=True)
settings.register_profile("thorough", max_examples=2000, deadline=None)


def pytest_addoption(parser):
    parser.addoption("--validate", action="store_true", help="run the long physics too")


def pytest_configure(config):
    # The library of the native engine, also where there is no home folder to write to.
    os.environ.setdefault("EXACTRB_CACHE", str(config.rootpath / ".pytest_cache" / "library"))
    if workers := config.getoption("numprocesses", None):  # they share the cores, and inherit this
        for threads in ("OPENMM_CPU_THREADS", "OPENBLAS_NUM_THREADS"):  # the latter for matrices in NumPy and SciPy
            os.environ.setdefault(threads, str(max(1, (os.cpu_count() or 1) // workers)))
        if not config.option.collectonly:
            compilation.at_once()
    if not config.getoption("--validate"):  # PoCL compiles twice as fast, and optimised texts run on processors
        os.environ.setdefault("POCL_EXTRA_BUILD_FLAGS", "-cl-opt-disable")
    settings.load_profile("thorough" if config.getoption("--validate") else "fast")
    gc.disable()  # while tests are collected: nothing that is made then goes


def pytest_collection_modifyitems(config, items):
    if not config.getoption("--validate"):
        skip = pytest.mark.skip(reason="long physics: run with --validate")
        for item in items:
            if "validate" in item.keywords:
                item.add_marker(skip)


def pytest_runtest_setup(item):
    if item.get_closest_marker("library") and (why := missing()):
        pytest.skip(why)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(call):
    """Skip a test that asks for engine="native" where there is no library, so that the package refuses."""
    error = call.excinfo and call.excinfo.value
    while error is not None:
        if isinstance(error, ValueError) and str(error) == f"{missing()}: use engine='host' instead":
            skipped = pytest.skip.Exception(str(error)).with_traceback(error.__traceback__)
            call.excinfo = pytest.ExceptionInfo.from_exception(skipped)
            return
        error = error.__cause__ or error.__context__


def pytest_collection_finish():
    gc.freeze()  # a Context is found among what was made since
    gc.enable()


@pytest.fixture(scope="module", autouse=True)
def few_objects_to_search():
    """Leave out what earlier tests made, such as compiled kernels, where the Context of an integrator is searched."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _same_locale():
    """Restore the locale: OpenMM's PME leaves "C" on OpenCL (VkFFT), and files are read as ASCII in the tests after."""
    before = locale.setlocale(locale.LC_ALL)
    yield
    locale.setlocale(locale.LC_ALL, before)


# -- engines and platforms --------------------------------------------------------------------------------------------


@pytest.fixture
def host_is_advised(monkeypatch):
    """Let engine="auto" take the host, which elsewhere it takes only for what the kernels do not serve."""
    monkeypatch.setitem(ENGINES, "native", replace(ENGINES["native"], advice=lambda *_: (False, "the host is tested")))


@pytest.fixture(autouse=True)
def draws_of_its_own():
    """Let the terms that a test draws not depend on the tests before it."""
    if terms := sys.modules.get("bonded_terms"):
        terms.RNG.bit_generator.state = terms.START


@pytest.fixture(params=["host", pytest.param("native", marks=pytest.mark.library)])
def every_engine(request):
    """Let engine="auto" take each engine in turn; return its name."""
    if request.param == "host":
        request.getfixturevalue("host_is_advised")
    return request.param


_DEVICE = pytest.param(("native", "device"), marks=pytest.mark.opencl)


@pytest.fixture(params=[("host", "Reference"), ("native", "Reference"), _DEVICE], ids="-".join)
def place(request):
    """Return an engine and a platform, of each engine one."""
    engine, name = request.param
    return engine, REFERENCE if name == "Reference" else device_platform()


@pytest.fixture(params=PLATFORMS)
def platform(request):
    """Return a platform for which there are kernels."""
    return {"Reference": REFERENCE, "CPU": CPU}.get(request.param) or device_platform()


@pytest.fixture(params=WHERE)
def where(request):
    """Return the name of a place where the native engine runs, and the platform there."""
    return request.param, device_platform() if request.param == "native" else REFERENCE


# -- bodies, schemes and rotors ---------------------------------------------------------------------------------------


@pytest.fixture
def rng():
    return np.random.default_rng(20)


@pytest.fixture(params=list(rb.ROTORS))
def method(request):
    return request.param


@pytest.fixture(params=list(rb.SCHEMES))
def scheme(request):
    return rb.SCHEMES[request.param]


#: Every scheme with the exact rotor, and every rotor with one scheme: for laws, where they are cheap.
PAIRINGS = [(name, "exact") for name in rb.SCHEMES] + [("SRKN4_6b", name) for name in rb.ROTORS if name != "exact"]


@pytest.fixture(params=PAIRINGS, ids="-".join)
def pairing(request):
    name, method = request.param
    return rb.SCHEMES[name], method


@pytest.fixture
def bodies(rng):
    """Inertia (N, 3), attitudes (N, 4) and momenta (N, 3) of bodies without any symmetry."""
    n = 40
    return rng.uniform(0.5, 2.0, (n, 3)), quaternions.random(rng, n), rng.standard_normal((n, 3))
