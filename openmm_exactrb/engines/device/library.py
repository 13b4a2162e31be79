"""The library of the device engine: found or compiled once into the user's cache, and loaded.

A wheel contains the library for one minor version of OpenMM next to this file. Without it, or with another OpenMM, it
is compiled within seconds, like numba's kernels. The name of the file contains a hash of the source, of OpenMM's
version and of the compiler, and the file is moved into place in one step, because two processes may compile at once.
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
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

_log = logging.getLogger("openmm_exactrb")

#: The C++ source of the library.
SOURCE = Path(__file__).with_name("program_integrator.cpp")
#: The library that a wheel brings along.
BUNDLED = SOURCE.with_suffix(".so")
#: The compiler, if it is not the first of these that is found.
COMPILER = "CXX"
_COMPILERS = ("c++", "g++", "clang++")
#: The folder of what is compiled, if it is not one in the user's own cache.
CACHE = "EXACTRB_CACHE"
_FLAGS = ("-std=c++17", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
_SYSTEMS = ("Linux", "Darwin")


class MissingLibraryError(RuntimeError):
    """The library is not available; the message states the reason and the remedy."""


class Library:
    """The functions of a loaded library, which create and control an integrator.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._functions = ctypes.CDLL(str(path))  # OpenMM's own library is loaded: this one is linked to it
        except OSError as error:
            raise MissingLibraryError(
                f"{path} cannot be loaded ({error}): delete it, so that it is compiled again"
            ) from error
        self._functions.pi_error.restype = ctypes.c_char_p
        self._functions.pi_register.restype = ctypes.c_char_p
        if built_for := self._functions.pi_register():
            raise MissingLibraryError(
                f"{path} was built for OpenMM {built_for.decode()}, not {openmm.__version__}: delete it, "
                "so that it is compiled again"
            )

    def make(self) -> Any:
        """Return a new integrator without a program; in Python it is an openmm.CustomIntegrator."""
        return openmm.XmlSerializer.deserialize('<Integrator type="ProgramIntegrator" version="1" stepSize="0"/>')

    def owns(self, integrator: Any) -> bool:
        """Return whether this library created an integrator."""
        return bool(self._functions.pi_owns(ctypes.c_void_p(int(integrator.this))))

    def call(self, function: str, integrator: Any, *arguments: Any) -> None:
        """Call a function of the library, without Python's lock; raise OpenMMException if it fails."""
        pointer = ctypes.c_void_p(int(integrator.this))
        if getattr(self._functions, f"pi_{function}")(pointer, *arguments):
            raise openmm.OpenMMException(self._functions.pi_error().decode())


class Device:
    """A program integrator that has a Context: its program, arrays and numbers.

    Parameters
    ----------
    integrator : openmm.CustomIntegrator
        An integrator that `Library.make` returned, or the Python object that represents it.
    """

    def __init__(self, library: Library, integrator: Any) -> None:
        self._library, self._integrator = library, integrator

    def _call(self, function: str, *arguments: Any) -> None:
        self._library.call(function, self._integrator, *arguments)

    def load(self, program: str) -> None:
        """Load a program: the text of `openmm_exactrb.engines.device.program.Program`."""
        self._call("program", program.encode())

    def upload(self, name: str, values: NDArray[Any]) -> None:
        """Write an array of the program, of the same number of bytes."""
        values = np.ascontiguousarray(values)
        self._call("upload", name.encode(), ctypes.c_void_p(values.ctypes.data), ctypes.c_size_t(values.nbytes))

    def download(self, name: str, out: NDArray[Any]) -> NDArray[Any]:
        """Read an array of the program into a contiguous one of the same number of bytes."""
        self._call("download", name.encode(), ctypes.c_void_p(out.ctypes.data), ctypes.c_size_t(out.nbytes))
        return out

    def __setitem__(self, scalar: str, value: float) -> None:
        """Set a number of the program."""
        self._call("set", scalar.encode(), ctypes.c_double(value))

    def __getitem__(self, scalar: str) -> float:
        """Return a number of the program."""
        value = ctypes.c_double()
        self._call("get", scalar.encode(), ctypes.byref(value))
        return value.value

    def step(self, steps: int) -> None:
        """Perform steps."""
        self._call("steps", steps)

    def run(self, sequence: str) -> None:
        """Execute a sequence outside of a step."""
        self._call("run", sequence.encode())

    def keep(self) -> None:
        """Save the state of the Context and of the program."""
        self._call("keep")

    def restore(self) -> None:
        """Restore the saved state."""
        self._call("restore")

    @property
    def launches(self) -> int:
        """Number of kernels launched by the program, excluding those of forces."""
        return self._count(0)

    @property
    def evaluations(self) -> int:
        """Number of force evaluations by the program."""
        return self._count(1)

    def changes(self, clear: int = 0) -> int:
        """Return external changes as bits, and clear some of them.

        1: positions, 2: velocities, 4: other quantities on which forces depend, 8: a checkpoint or State was loaded.
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


def _found() -> Path | None:
    """Return the library of the wheel if it is for this minor version of OpenMM."""
    version = BUNDLED.with_suffix(".txt")
    if not (BUNDLED.exists() and version.exists()):
        return None
    return BUNDLED if _minor(version.read_text().strip()) == _minor(openmm.__version__) else None


def _minor(version: str) -> list[str]:
    return version.split(".")[:2]


def describe() -> str:
    """Describe the library of the device engine, or what is missing, without compiling anything."""
    try:
        path = _found() or cached()
        if not path.exists():
            openmm_folder()  # with its headers
    except MissingLibraryError as error:
        return f"not available: {error}"
    return str(path) if path.exists() else f"to be compiled by {compiler()} at first use, in some seconds"


def cached() -> Path:
    """Return the path of the library in the user's cache."""
    found = compiler()
    what = (SOURCE.read_bytes(), openmm.__version__.encode(), _told(found, "--version").encode(), found.encode())
    digest = hashlib.sha256(b"\0".join(what)).hexdigest()[:16]
    return private_folder() / f"program_integrator-openmm{openmm.__version__}-{digest}.so"


def compiled() -> Path:
    """Return the library in the user's cache, and compile it if it is missing."""
    path = cached()
    if not path.exists():
        _log.warning("compiling the device engine for OpenMM %s, once, which takes some seconds", openmm.__version__)
        build(path)
    _check_owner(path)
    return path


def compiler() -> str:
    """Return the path of a C++ compiler; raise MissingLibraryError without one."""
    if platform.system() not in _SYSTEMS:
        raise MissingLibraryError(f"the device engine needs Linux or macOS, not {platform.system()}")
    names = (os.environ.get(COMPILER), *_COMPILERS)
    found = next((path for path in map(shutil.which, filter(None, names)) if path), None)
    if found is None:
        raise MissingLibraryError(
            "the device engine has to be compiled for this OpenMM, but no C++ compiler was found: install one (g++, "
            f"clang++), or name it in the environment variable {COMPILER}"
        )
    return found


def _told(command: str, *arguments: str) -> str:
    return subprocess.run([command, *arguments], capture_output=True, text=True, check=False).stdout


def openmm_folder() -> Path:
    """Return the folder with OpenMM's include and lib; raise MissingLibraryError without headers.

    The folder is that of OpenMM's wheel, or the prefix of a conda environment.
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
    """Compile the library to a path; raise MissingLibraryError with the compiler's first error if that fails."""
    command, folder = command or compiler(), openmm_folder()
    handle, temporary = tempfile.mkstemp(suffix=".so", dir=path.parent)
    os.close(handle)
    try:
        version = f'-DBUILT_FOR="{openmm.__version__}"'
        link = (f"-I{folder / 'include'}", str(SOURCE), "-o", temporary, f"-L{folder / 'lib'}", "-lOpenMM", "-ldl")
        done = subprocess.run([command, version, *_FLAGS, *link], capture_output=True, text=True, check=False)
        if done.returncode:
            errors = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines()
            raise MissingLibraryError(f"{command} cannot compile the device engine: {(errors or ['no message'])[0]}")
        Path(temporary).chmod(0o700)
        Path(temporary).replace(path)
    finally:
        Path(temporary).unlink(missing_ok=True)


def private_folder() -> Path:
    """Return the user's folder of compiled libraries; raise MissingLibraryError if others can write there."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = Path(os.environ.get(CACHE) or home / "openmm-exactrb")
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise MissingLibraryError(f"the folder {folder} cannot be created: {error}; name another in {CACHE}") from error
    _check_owner(folder)
    return folder


def _check_owner(path: Path) -> None:
    """Raise MissingLibraryError for a file or folder that others can access, because code is loaded from it."""
    if sys.platform == "win32":
        return  # a home folder there is its user's alone
    status = path.stat()
    if status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o077:  # noqa: TID251
        raise MissingLibraryError(
            f"{path} is not loaded because other users have access to it: remove it, or name another folder in {CACHE}"
        )
