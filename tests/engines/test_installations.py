"""The cases of docs/install.md: where the library comes from, and what runs and is said where it is missing.

Each case is a process of its own, with an empty home folder.
"""

import os
import platform
import runpy
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from openmm_exactrb.library import compilation, library
from places import has_device

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the compilers here are scripts")
needs_compiler = pytest.mark.skipif(shutil.which("c++") is None, reason="needs a C++ compiler")

SLOWER = "steps are performed in NumPy; with the package's library, "
COMPILING, COMPILED = "compiling the library of integrators", "compiled in "
STEPS = """
import openmm
import openmm_exactrb as rb
from openmm_exactrb.library.library import describe
_, system, positions = rb.rigid_water(2)
for engine in ("auto", "host", "native"):
    try:
        integrator = rb.ExactRigidBodyIntegrator(0.001, engine=engine)
    except ValueError as error:
        print("refused:", error)
        continue
    context = openmm.Context(system, integrator, openmm.Platform.getPlatform("Reference"))
    context.setPositions(positions)
    integrator.step(2)
print(integrator.getEngine(), describe(), integrator.engineNote(), sep="; ")
"""
OTHER_OPENMM = "import openmm; openmm.__version__ = '8.7.1'\n"


class Machine:
    """A machine with an empty home folder and one compiler, which may be missing or fail, and writes what it does."""

    def __init__(self, folder):
        self.folder, self.cache, self.package = folder, folder / "home" / "cache", ROOT
        self.log = folder / "compilations"
        (folder / "home").mkdir()
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("EXACTRB_", "XDG_"))}
        self.environment = kept | {"HOME": str(folder / "home"), library.CACHE: str(self.cache)}
        self.environment |= {"PATH": str(folder), "OPENMM_CPU_THREADS": "1"}
        self.environment.setdefault("POCL_CACHE_DIR", str(Path.home() / ".cache" / "pocl" / "kcache"))  # of other tests
        self.environment.pop(compilation.COMPILER, None)

    def install(self, command):
        """Install a compiler that is a command of the shell."""
        compiler = self.folder / "c++"
        compiler.write_text(f'#!/bin/sh\nPATH={os.environ["PATH"]}\necho "$@" >> {self.log}\n{command}\n')
        compiler.chmod(0o700)

    def start(self, script=STEPS):
        """Start a process with the package; it is the leader of a group."""
        return subprocess.Popen(
            [sys.executable, "-c", script],
            env=self.environment | {"PYTHONPATH": f"{self.package}{os.pathsep}{ROOT / 'tests' / 'common'}"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=self.folder,
            start_new_session=True,
        )

    def run(self, script=STEPS):
        """Return the lines that a process prints, and those that are logged."""
        out, logged = (process := self.start(script)).communicate()
        assert process.returncode == 0, logged
        return out.splitlines(), [line for line in logged.splitlines() if "compiling kernels" not in line]

    def compilations(self):
        """Return how many sources were compiled."""
        return self.log.read_text().count(".cpp") if self.log.exists() else 0


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path)


def assert_in_python(printed, logged, why):
    """Assert that all integrators run on the host, and that one line says so."""
    assert len(logged) == 1
    assert logged[0].startswith(SLOWER)
    assert why in logged[0]
    refused, last = printed
    assert why in refused
    assert refused.endswith("use engine='host' instead")
    assert last.startswith("host; ")


FAST = 'exec c++ "$@" -O0'
# A compiler with a static C++ library of its own, which is usual on Linux alone.
STATIC = 'exec c++ -static-libstdc++ "$@" -O0' if sys.platform == "linux" else FAST
# A compiler that begins to write and does not end.
ENDLESS = 'test "$1" = --version && exec c++ "$1"; while [ "$1" != -o ]; do shift; done; : > "$2"; exec sleep 600'
ON_DEVICE = """
import openmm
import openmm_exactrb as rb
from places import device_platform
_, system, positions = rb.rigid_water(8)
integrator = rb.ExactRigidBodyIntegrator(0.002, "S2_2", engine="native")
context = openmm.Context(system, integrator, device_platform())
context.setPositions(positions)
integrator.step(2)
print(integrator.getEngine())
"""


@needs_compiler
def test_many_processes_compile_once_and_a_killed_one_does_no_harm(machine):
    machine.install(ENDLESS)
    killed = machine.start()
    while not list(machine.cache.glob(f"{compilation.TEMPORARY}*/*")):  # the compiler writes
        assert killed.poll() is None, killed.communicate()
        time.sleep(0.05)
    os.killpg(killed.pid, signal.SIGKILL)  # noqa: TID251  # skipped on Windows
    killed.communicate()
    assert list(machine.cache.glob(f"{compilation.TEMPORARY}*"))
    machine.log.unlink()
    machine.install(STATIC)
    with ThreadPoolExecutor(3) as workers:
        runs = list(workers.map(lambda _: machine.run(), range(3)))
    logged = [line for _, lines in runs for line in lines]
    assert [line.startswith(COMPILING) for line in logged] == [True, False]
    assert logged[1].startswith(COMPILED)
    assert machine.compilations() == len(compilation.SOURCES)
    (path,) = machine.cache.glob("*.so")
    assert {file.name for file in machine.cache.iterdir()} == {"lock", path.name}
    for printed, _ in runs:
        assert str(path) in printed[-1]
        assert printed[-1].startswith("native; ")
    if has_device():
        folders = os.environ["PATH"]  # PoCL links its kernels
        machine.environment["PATH"] = f"{machine.folder}{os.pathsep}{folders}"
        assert machine.run(ON_DEVICE)[0][-1] == "native"  # OpenMM warns about PoCL before
        assert machine.compilations() == len(compilation.SOURCES)  # by the same compiler, so that none is new
        machine.environment["PATH"] = str(machine.folder)
    # A wheel with this library needs no compiler, and writes nothing.
    machine.package = machine.folder / "site-packages"
    shutil.copytree(ROOT / "openmm_exactrb", machine.package / "openmm_exactrb")
    bundled = machine.package / compilation.BUNDLED.relative_to(ROOT)
    shutil.copy(path, bundled)
    shutil.rmtree(machine.cache)
    (machine.folder / "c++").unlink()
    printed, logged = machine.run()
    assert str(bundled) in printed[-1]
    assert not logged
    assert not machine.cache.exists()
    # And is not used with another OpenMM, or if the user does not want it.
    assert_in_python(*machine.run(OTHER_OPENMM + STEPS), f"supports OpenMM {compilation.OPENMM}, not 8.7.1")
    machine.environment[library.LIBRARY] = library.NONE
    assert_in_python(*machine.run(), f"{library.LIBRARY} is {library.NONE}")


def test_without_a_compiler_steps_are_performed_in_python(machine):
    printed, logged = machine.run()
    assert_in_python(printed, logged, why := "no C++ compiler was found: install g++ or clang++")
    assert "not available: " in printed[-1]
    assert why in printed[-1]


def test_a_compiler_that_fails_is_quoted_and_tried_once(machine):
    machine.install('case "$1" in --version) ;; *) echo "a.cpp:1: error: this is nonsense" >&2; exit 1 ;; esac')
    printed, logged = machine.run()
    assert logged.pop(0).startswith(COMPILING)
    assert_in_python(printed, logged, "cannot compile the library (a.cpp:1: error: this is nonsense)")
    assert 0 < machine.compilations() <= len(compilation.SOURCES)
    assert [file.name for file in machine.cache.iterdir()] == ["lock"]


def test_a_file_that_is_no_program_is_no_compiler(machine):
    machine.install("")
    (machine.folder / "c++").write_text("nonsense\x00\n")
    assert_in_python(*machine.run(), "c++ cannot compile the library (")


def test_another_openmm_is_refused_before_anything_is_compiled(machine):
    machine.install(FAST)
    assert_in_python(*machine.run(OTHER_OPENMM + STEPS), f'not 8.7.1: install "openmm=={compilation.OPENMM}.*"')
    assert not machine.log.exists()


def test_a_user_can_do_without_the_library(machine):
    machine.install(FAST)
    machine.environment[library.LIBRARY] = library.NONE
    assert_in_python(*machine.run(), f"the environment variable {library.LIBRARY} is {library.NONE}: unset it")
    assert not machine.log.exists()


def test_a_misspelled_wish_is_an_error(machine):
    machine.environment[library.LIBRARY] = "nothing"
    _, logged = machine.start("import openmm_exactrb as rb; rb.ExactRigidBodyIntegrator(0.001)").communicate()
    assert f"ValueError: the environment variable {library.LIBRARY} is 'nothing': unset it, or set it to" in logged


def test_a_cache_that_cannot_be_made_is_named(machine):
    machine.install(FAST)
    machine.cache.write_text("")
    assert_in_python(*machine.run(), f"set the environment variable {library.CACHE} to another folder")


@pytest.mark.validate  # and by `make library-check`
def test_clang_compiles_the_library(machine):
    names = ("clang++", *(f"clang++-{version}" for version in range(25, 12, -1)))
    clang = next(filter(None, map(shutil.which, names)), None) or pytest.skip("needs clang++")
    machine.install(f'exec {clang} "$@" -O0')
    printed, logged = machine.run()
    assert [line.startswith(COMPILING) for line in logged] == [True, False]
    assert printed[-1].startswith("native; ")


def test_on_windows_the_compiler_is_that_of_visual_studio(machine, monkeypatch):
    monkeypatch.setattr(platform, "system", lambda: "Windows")
    monkeypatch.setenv("PATH", str(machine.folder))
    monkeypatch.delenv(compilation.COMPILER, raising=False)
    there = runpy.run_path(compilation.__file__)
    machine.install(FAST)
    with pytest.raises(there["CompilationError"], match="start Python from the developer prompt of Visual Studio"):
        there["compiler"]()
