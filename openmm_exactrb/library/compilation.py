"""Compilation of the library from its C++ sources.

The module imports nothing of the package, because wheels are built where numba and scipy are not installed.
"""

from __future__ import annotations

import hashlib
import os
import platform
import runpy
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import openmm

_HERE = Path(__file__).parent
#: The folder of the package, in which the kernel texts are next to the physics that they describe.
PACKAGE = _HERE.parent
#: The C++ sources of the library, and the files that they include.
SOURCES = tuple(sorted((_HERE / "source").glob("*.cpp")))
INCLUDED = tuple(sorted((*(_HERE / "source").glob("*.h"), *PACKAGE.rglob("*.cl"))))
#: The files with constants that kernels share with Python; names in capitals are macros of the kernel texts.
CONSTANTS = tuple(sorted(PACKAGE.rglob("constants.py")))
#: The library that a wheel contains.
BUNDLED = _HERE / "program_integrator.so"
#: The minor version of OpenMM for which the sources are written, because they depend on the layout of its classes.
OPENMM = "8.6"
#: The environment variable that names a compiler, and the commands that are tried if it names none.
COMPILER = "CXX"
#: The beginning of the names of temporary folders, which remain if a process is killed.
TEMPORARY = "compiling-"

_SYSTEM = platform.system()
_COMPILERS: tuple[str, ...] = ("cl",) if _SYSTEM == "Windows" else ("c++", "g++", "clang++")
_TO_INSTALL = (
    "start Python from the developer prompt of Visual Studio" if _SYSTEM == "Windows" else "install g++ or clang++"
)
# Multiplications and additions are not contracted, so that results do not depend on the compiler.
_FLAGS = (
    ("-nologo", "-std:c++17", "-O2", "-fp:precise", "-EHsc", "-MD", "-utf-8")
    if _SYSTEM == "Windows"
    else ("-std=c++17", "-O3", "-fno-math-errno", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden")
)
_LINKER_FLAGS = {
    # Some compilers link the C++ library statically. Its symbols must not be mixed with those of OpenMM's C++ library.
    "Linux": ("-Wl,--exclude-libs,ALL", "-ldl"),
    "Darwin": ("-Wl,-rpath,@loader_path/../../OpenMM.libs/lib",),
}.get(_SYSTEM, ())
_FAILED = f"{{}} cannot compile the library ({{}}): name another C++ compiler in the environment variable {COMPILER}"


class CompilationError(RuntimeError):
    """The library cannot be compiled; the message states the reason and the remedy."""


def check_openmm() -> None:
    """Raise CompilationError if OpenMM has another minor version than the sources."""
    if openmm.__version__.split(".")[:2] != OPENMM.split("."):
        raise CompilationError(
            f'the library supports OpenMM {OPENMM}, not {openmm.__version__}: install "openmm=={OPENMM}.*"'
        )


def compiler() -> str:
    """Return the path of a C++ compiler; raise CompilationError if there is no compiler."""
    for name in (os.environ.get(COMPILER), *_COMPILERS):
        if name and (found := shutil.which(name)):
            return found
    raise CompilationError(
        f"the library has to be compiled, but no C++ compiler was found: {_TO_INSTALL}, or name a compiler in the "
        f"environment variable {COMPILER}"
    )


def openmm_folder() -> Path:
    """Return the folder that contains OpenMM's `include` and `lib`; raise CompilationError if headers are missing.

    The folder belongs to OpenMM's wheel, or is the prefix of a conda environment.
    """
    package = Path(openmm.__file__).parent
    candidates = (package.parent / "OpenMM.libs", *package.parents, *(above / "Library" for above in package.parents))
    for folder in candidates:
        if (folder / "include" / "openmm" / "common" / "ComputeContext.h").exists():
            return folder
    raise CompilationError(
        f"the library has to be compiled, but OpenMM in {package} has no headers: install OpenMM from PyPI or "
        "conda-forge"
    )


def of_this_machine() -> tuple[str, ...]:
    """Return flags for instructions that this machine's processor has. Results are the same to the bit without them."""
    if _SYSTEM != "Linux" or platform.machine() != "x86_64":
        return ()
    with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
        features = next((line for line in lines if line.startswith("flags")), "")
    return ("-mavx2",) if "avx2" in features.split() else ()


@cache
def definitions() -> str:
    """Return the definitions of the constants that kernels share with Python, in the preprocessor's language."""
    found = {name: value for file in CONSTANTS for name, value in runpy.run_path(str(file)).items() if name.isupper()}
    large = 2**31  # literals above need a suffix
    texts = (f"{value}UL" if isinstance(value, int) and value >= large else repr(value) for value in found.values())
    return "".join(f"#define {name} {text}\n" for name, text in zip(found, texts, strict=True))


def digest(*flags: str) -> str:
    """Return a hash of all that determines the compiled library: texts, flags, compiler, OpenMM and machine."""
    command = compiler()
    version = _executed(command, "--version").stdout
    files = (*SOURCES, *INCLUDED, *CONSTANTS, Path(__file__))  # this file contains the flags
    texts = (part for file in files for part in (file.name.encode(), file.read_bytes()))
    words = (openmm.__version__, _SYSTEM, platform.machine(), command, version, *flags)
    return hashlib.sha256(b"\0".join((*texts, *map(str.encode, words)))).hexdigest()[:16]


def build(path: Path, *flags: str, sources: Sequence[Path] = SOURCES) -> None:
    """Compile the library, or other sources, to a path; raise CompilationError with the compiler's first error."""
    check_openmm()
    command, folder = compiler(), openmm_folder()
    built_for = f'-DBUILT_FOR="{openmm.__version__}"'
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=TEMPORARY) as temporary:
        (Path(temporary) / "constants.h").write_text(definitions(), encoding="utf-8")
        objects = [Path(temporary) / source.with_suffix(".o").name for source in sources]
        folders = [f"-I{named}" for named in (folder / "include", PACKAGE, temporary)]
        compiling = (command, *_FLAGS, built_for, *folders, *flags, "-c")
        with ThreadPoolExecutor() as threads:
            list(threads.map(lambda source, out: _run((*compiling, str(source), *_to(out))), sources, objects))
        linked = Path(temporary) / path.name
        _run(_linking(command, folder / "lib", objects, linked, flags))
        linked.chmod(0o700)
        linked.replace(path)


def _to(out: Path) -> Sequence[str]:
    """Return the arguments that name an object file."""
    return (f"-Fo{out}",) if _SYSTEM == "Windows" else ("-o", str(out))


def _linking(command: str, folder: Path, objects: Sequence[Path], out: Path, flags: Sequence[str]) -> Sequence[str]:
    """Return the command that links objects to OpenMM's library in a folder."""
    parts = [*flags, *map(str, objects)]
    if _SYSTEM == "Windows":
        return command, "-nologo", "-LD", "-MD", *parts, f"-Fe{out}", "-link", f"-LIBPATH:{folder}", "OpenMM.lib"
    return command, "-shared", *parts, "-o", str(out), f"-L{folder}", "-lOpenMM", *_LINKER_FLAGS


def _run(command: Sequence[str]) -> None:
    """Execute a compiler; raise CompilationError with its first error after a failure."""
    done = _executed(*command)
    if done.returncode:
        told = (done.stderr + done.stdout).splitlines()
        errors = [line for line in told if "error" in line] or told
        raise CompilationError(_FAILED.format(command[0], (errors or ["no message"])[0]))


def _executed(*command: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    except OSError as error:
        raise CompilationError(_FAILED.format(command[0], error)) from error
