"""The library of the device engine, which is loaded from a wheel, or compiled once into the user's cache.

A wheel contains the library for one minor version of OpenMM next to this module. If the wheel has no library, or OpenMM
has another minor version, the library is compiled once, within seconds. The name of the compiled file contains a hash
of the source, of OpenMM's version and of the compiler. The file is moved into place atomically, because two processes
may compile at the same time.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
import shutil
import stat
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.errors import MissingLibraryError

_log = logging.getLogger("openmm_exactrb")

_HERE = Path(__file__).parent
_DEVICE = _HERE / "device"
#: The C++ sources of the library, and the files that they include.
SOURCES = tuple(sorted((_DEVICE / "source").glob("*.cpp")))
_INCLUDED = tuple(sorted((*(_DEVICE / "source").glob("*.h"), *(_DEVICE / "kernels").glob("*.cl"))))
#: The library that a wheel contains.
BUNDLED = _HERE / "program_integrator.so"
#: The type of the library's integrators in XML.
TYPE = "openmm_exactrb (import this package before you read its integrators)"
#: The environment variable that names a compiler, and the commands that are tried if it names none.
COMPILER = "CXX"
_COMPILERS = ("c++", "g++", "clang++")
#: The environment variable that names the folder for compiled libraries; the default folder is in the user's cache.
CACHE = "EXACTRB_CACHE"
# Multiplications and additions are not contracted, so that results do not depend on the compiler.
_FLAGS = ("-std=c++17", "-O3", "-fno-math-errno", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-w")
# Some compilers link the C++ library statically. Its symbols must not be mixed with those of OpenMM's C++ library.
_LINKER_FLAGS = {"Linux": ("-Wl,--exclude-libs,ALL",)}
_SYSTEMS = ("Linux", "Darwin")


class Library:
    """A loaded library, with functions that create and control integrators.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._functions = ctypes.CDLL(str(path))  # OpenMM's library, to which this one is linked, is already loaded
        except OSError as error:
            raise MissingLibraryError(
                f"{path} cannot be loaded ({error}): delete this file so that it is compiled again"
            ) from error
        self._functions.pi_error.restype = ctypes.c_char_p
        self._functions.pi_register.restype = ctypes.c_char_p
        if built_for := self._functions.pi_register():
            raise MissingLibraryError(
                f"{path} was built for OpenMM {built_for.decode()}, not {openmm.__version__}: delete this file so that "
                "it is compiled again"
            )

    def make(self) -> Any:
        """Return a new integrator without a program; in Python it is an openmm.CustomIntegrator."""
        return openmm.XmlSerializer.deserialize(f'<Integrator type="{TYPE}" version="1" stepSize="0"/>')

    def adopt(self, integrator: Any) -> None:
        """Make a new Python integrator, which has no Context and no variables yet, an integrator of this library."""
        made = self.make()
        made.setStepSize(integrator.getStepSize())
        integrator.this = made.this

    def owns(self, integrator: Any) -> bool:
        """Return whether this library created an integrator."""
        return bool(self._functions.pi_owns(ctypes.c_void_p(int(integrator.this))))

    def step_openmm(self, integrator: Any, steps: int) -> None:
        """Let OpenMM perform its own part of steps, in which barostats and thermostats of the System act."""
        self.call("own", integrator, steps)

    def call(self, function: str, integrator: Any, *arguments: Any) -> None:
        """Call a function of the library without Python's global lock; raise OpenMMException if the function fails."""
        pointer = ctypes.c_void_p(int(integrator.this))
        if getattr(self._functions, f"pi_{function}")(pointer, *arguments):
            raise openmm.OpenMMException(self._functions.pi_error().decode())


class Device:
    """Access to the program, the arrays and the scalars of a program integrator that has a Context.

    Parameters
    ----------
    integrator : openmm.CustomIntegrator
        An integrator that `Library.make` returned, or the Python object that represents it.
    """

    def __init__(self, library: Library, integrator: Any) -> None:
        self._library, self._integrator = library, weakref.ref(integrator)
        self._result = (ctypes.c_double * 4)()

    def _call(self, function: str, *arguments: Any) -> None:
        self._library.call(function, self._integrator(), *arguments)

    def load(self, program: str) -> None:
        """Load a program, given as the text of an `openmm_exactrb.engines.device.program.Program`."""
        self._call("program", program.encode())

    def upload(self, name: str, values: NDArray[Any]) -> None:
        """Write values to an array of the program that has the same number of bytes."""
        values = np.ascontiguousarray(values)
        self._call("upload", name.encode(), ctypes.c_void_p(values.ctypes.data), ctypes.c_size_t(values.nbytes))

    def download(self, name: str, out: NDArray[Any]) -> NDArray[Any]:
        """Read an array of the program into a contiguous array `out` of the same number of bytes, and return `out`."""
        self._call("download", name.encode(), ctypes.c_void_p(out.ctypes.data), ctypes.c_size_t(out.nbytes))
        return out

    def __setitem__(self, scalar: str, value: float) -> None:
        """Set a scalar of the program."""
        self._call("set", scalar.encode(), ctypes.c_double(value))

    def __getitem__(self, scalar: str) -> float:
        """Return a scalar of the program."""
        value = ctypes.c_double()
        self._call("get", scalar.encode(), ctypes.byref(value))
        return value.value

    def step(self, steps: int) -> None:
        """Perform a number of steps."""
        self._call("steps", steps)

    def perform(self, steps: int, shows: bool) -> tuple[float, float, float, int]:
        """Save the state in place 0, perform steps, and return a report, and the number of evaluations.

        A processed scheme first computes its inner state, unless the present one belongs to the present settings. If
        `shows` is true or the scheme is not processed, the Context shows the result, to which the report refers.
        """
        self._call("perform", steps, int(shows), self._result)
        translation, rotation, invalid, evaluations = self._result
        return translation, rotation, invalid, int(evaluations)

    def show(self) -> None:
        """Show the state of a processed scheme in the Context."""
        self._call("show")

    def report(self, shown: bool) -> tuple[float, float, float]:
        """Return the kinetic energies (kJ/mol) of translation and rotation, and the number of invalid bodies.

        The report refers to the state that the Context shows, or to the inner state.
        """
        self._call("report", int(shown), self._result)
        translation, rotation, invalid, _ = self._result
        return translation, rotation, invalid

    def run(self, sequence: str) -> None:
        """Execute a sequence outside of a step."""
        self._call("run", sequence.encode())

    def keep(self, slot: int = 0) -> None:
        """Save the state of the Context and of the program in one of two places, 0 and 1."""
        self._call("keep", slot)

    def restore(self, slot: int = 0) -> None:
        """Restore the state that was saved in a place."""
        self._call("restore", slot)

    @property
    def launches(self) -> int:
        """The number of kernel launches of the program, excluding those of force evaluations."""
        return self._count(0)

    @property
    def evaluations(self) -> int:
        """The number of force evaluations that the program requested."""
        return self._count(1)

    def changes(self, clear: int = 0) -> int:
        """Return the external changes to the Context as bits, and then clear the bits in `clear`.

        The value 1 marks changed positions, 2 changed velocities, 4 forces with changed parameters, as set by
        ``updateParametersInContext``, and 8 a loaded checkpoint or State.
        """
        value = ctypes.c_int()
        self._call("changes", clear, ctypes.byref(value))
        return value.value

    def _count(self, which: int) -> int:
        value = ctypes.c_longlong()
        self._call("count", which, ctypes.byref(value))
        return value.value


@cache
def library() -> Library:
    """Return the library; raise MissingLibraryError if it is not available."""
    return Library(_found() or compiled())


def of_library(integrator: Any) -> bool:
    """Return whether an integrator is one of the library, if that is loaded."""
    return library.cache_info().currsize > 0 and library().owns(integrator)


def _found() -> Path | None:
    """Return the path of the wheel's library, or None if there is no library for this minor version of OpenMM."""
    version = BUNDLED.with_suffix(".txt")
    if not (BUNDLED.exists() and version.exists()):
        return None
    return BUNDLED if _minor(version.read_text().strip()) == _minor(openmm.__version__) else None


def _minor(version: str) -> list[str]:
    return version.split(".")[:2]


def describe() -> str:
    """Return the path of the library, or a sentence that states how it will be compiled or why it is not available."""
    try:
        path = _found() or cached()
        if not path.exists():
            openmm_folder()  # raises an error if headers are missing
    except MissingLibraryError as error:
        return f"not available: {error}"
    return str(path) if path.exists() else f"to be compiled by {compiler()} at first use, which takes some seconds"


def cached() -> Path:
    """Return the path of the library in the user's cache, where the file may not exist yet."""
    found = compiler()
    texts = [file.name.encode() + file.read_bytes() for file in (*SOURCES, *_INCLUDED)]
    flags = " ".join((*_FLAGS, *_LINKER_FLAGS.get(platform.system(), ())))
    what = (*texts, flags.encode(), openmm.__version__.encode(), _told(found, "--version").encode(), found.encode())
    digest = hashlib.sha256(b"\0".join(what)).hexdigest()[:16]
    return private_folder() / f"program_integrator-openmm{openmm.__version__}-{digest}.so"


def compiled() -> Path:
    """Return the path of the library in the user's cache, after compiling the library if it is missing."""
    path = cached()
    if not path.exists():
        _log.warning("compiling the device engine, which takes a few seconds; later processes load it from the cache")
        build(path)
    _check_owner(path)
    return path


def compiler() -> str:
    """Return the path of a C++ compiler; raise MissingLibraryError if there is no compiler."""
    if platform.system() not in _SYSTEMS:
        raise MissingLibraryError(f"the device engine needs Linux or macOS, not {platform.system()}")
    names = (os.environ.get(COMPILER), *_COMPILERS)
    found = next((path for path in map(shutil.which, filter(None, names)) if path), None)
    if found is None:
        raise MissingLibraryError(
            "the device engine has to be compiled for this OpenMM, but no C++ compiler was found: install g++ or "
            f"clang++, or name a compiler in the environment variable {COMPILER}"
        )
    return found


def _told(command: str, *arguments: str) -> str:
    return subprocess.run([command, *arguments], capture_output=True, text=True, check=False).stdout


def openmm_folder() -> Path:
    """Return the folder that contains OpenMM's `include` and `lib`; raise MissingLibraryError if headers are missing.

    The folder belongs to OpenMM's wheel, or is the prefix of a conda environment.
    """
    package = Path(openmm.__file__).parent
    candidates = (package.parent / "OpenMM.libs", *package.parents)
    for folder in candidates:
        if (folder / "include" / "openmm" / "common" / "ComputeContext.h").exists():
            return folder
    raise MissingLibraryError(
        f"the device engine has to be compiled, but OpenMM in {package} has no headers: install OpenMM from PyPI or "
        "conda-forge"
    )


def build(path: Path, command: str | None = None) -> None:
    """Compile the library to a path; raise MissingLibraryError with the compiler's first error after a failure."""
    command, folder = command or compiler(), openmm_folder()
    with tempfile.TemporaryDirectory(dir=path.parent) as temporary:
        compiling = (command, f'-DBUILT_FOR="{openmm.__version__}"', *_FLAGS, f"-I{folder / 'include'}", "-c")
        objects = [Path(temporary) / source.with_suffix(".o").name for source in SOURCES]
        with ThreadPoolExecutor() as threads:
            list(threads.map(lambda source, out: _run((*compiling, str(source), "-o", str(out))), SOURCES, objects))
        linked = Path(temporary) / path.name
        flags = ("-shared", *_LINKER_FLAGS.get(platform.system(), ()))
        _run((command, *flags, *map(str, objects), "-o", str(linked), f"-L{folder / 'lib'}", "-lOpenMM", "-ldl"))
        linked.chmod(0o700)
        linked.replace(path)


def _run(command: Sequence[str]) -> None:
    """Run a compiler; raise MissingLibraryError with its first error after a failure."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines()
        raise MissingLibraryError(
            f"{command[0]} cannot compile the device engine ({(errors or ['no message'])[0]}): name another C++ "
            f"compiler in the environment variable {COMPILER}"
        )


def private_folder() -> Path:
    """Return the user's folder for compiled libraries; raise MissingLibraryError if other users have access to it."""
    folder = _folder()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise MissingLibraryError(
            f"the folder {folder} cannot be created ({error.strerror or error}): set the environment variable {CACHE} "
            "to another folder"
        ) from error
    _check_owner(folder)
    return folder


def _folder() -> Path:
    """Return the folder that the environment names, or the default; raise MissingLibraryError without a home folder."""
    if named := os.environ.get(CACHE):
        return Path(named)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "openmm-exactrb")
    except RuntimeError as error:  # neither HOME nor an entry of the user, as in some containers
        raise MissingLibraryError(
            f"the user has no home folder for the compiled library: set the environment variable {CACHE} to a folder"
        ) from error


def _check_owner(path: Path) -> None:
    """Raise MissingLibraryError if other users can access a file or folder, because code is loaded from it."""
    if sys.platform == "win32":
        return  # on Windows, home folders are private
    status = path.stat()
    if status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o077:  # noqa: TID251
        raise MissingLibraryError(
            f"{path} is not used, because other users have access to it: delete it, or set the environment variable "
            f"{CACHE} to a new folder"
        )
