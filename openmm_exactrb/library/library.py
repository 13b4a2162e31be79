"""The library of C++ integrators, which is loaded from a wheel, or compiled once into the user's cache.

Wheels contain the library next to this module. Without it, the library is compiled at first use, once on a machine: the
name of the compiled file contains a hash of all that determines it, a lock lets other processes wait, and the file is
moved into place atomically. Where there is no library, the host engine performs all steps.
"""

from __future__ import annotations

import ctypes
import logging
import os
import shutil
import signal
import stat
import sys
import threading
import time
import weakref
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import openmm
from numpy.typing import NDArray

from openmm_exactrb.errors import MissingLibraryError
from openmm_exactrb.library import compilation
from openmm_exactrb.library.compilation import BUNDLED, CompilationError
from openmm_exactrb.support.lock import only_process

_log = logging.getLogger("openmm_exactrb")

# OpenMM's own function, which the package replaces later.
_read = openmm.XmlSerializer.__dict__["_deserializeIntegrator"].__func__
#: The type of the library's integrators in XML.
TYPE = "openmm_exactrb (import this package before you read its integrators)"
#: The environment variable that names the folder for compiled libraries; the default folder is in the user's cache.
CACHE = "EXACTRB_CACHE"
#: The duration of the compilation (s) on two idle cores.
SECONDS = 10
#: The environment variable that has the value NONE if the library must not be used.
LIBRARY, NONE = "EXACTRB_LIBRARY", "none"
#: What is said once in a process whose integrators are not those of the library.
SLOWER = (
    "steps are performed in NumPy; with the package's library, a single molecule or a small peptide would run hundreds "
    "of times as fast, 27 water molecules 18 times and 895 water molecules 1.5 times as fast: %s"
)


# Types of the functions in `Library.call_back`.
_BOUND = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_longlong)
_STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_longlong, ctypes.c_int)
_ASKED = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_longlong)

_listeners: list[Any] = []


class Library:
    """A loaded library, with functions that create and control integrators.

    Attributes
    ----------
    path : Path
    exported : ctypes.CDLL
        The exported functions.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.exported = ctypes.CDLL(str(path))  # OpenMM's library, to which this one is linked, is already loaded
        except OSError as error:
            raise MissingLibraryError(
                f"{path} cannot be loaded ({error}): delete this file so that it is compiled again"
            ) from error
        self.exported.pi_error.restype = ctypes.c_char_p
        self.exported.pi_register.restype = self.exported.pi_derivative.restype = ctypes.c_char_p
        if built_for := self.exported.pi_register():
            raise MissingLibraryError(
                f"{path} was built for OpenMM {built_for.decode()}, not {openmm.__version__}: delete this file so that "
                "it is compiled again"
            )

    def make(self) -> Any:
        """Return a new integrator without a program; in Python it is an openmm.CustomIntegrator."""
        return _read(f'<Integrator type="{TYPE}" version="1" stepSize="0"/>')

    def adopt(self, integrator: Any) -> None:
        """Make a new Python integrator, which has no Context and no variables yet, an integrator of this library."""
        made = self.make()
        made.setStepSize(integrator.getStepSize())
        integrator.this = made.this

    def owns(self, integrator: Any) -> bool:
        """Return whether this library created an integrator."""
        return bool(self.exported.pi_owns(ctypes.c_void_p(int(integrator.this))))

    def number(self, integrator: Any) -> int:
        """Return the number of an integrator of this library, which unlike its address is not used again."""
        number = ctypes.c_longlong()
        self.call("number", integrator, ctypes.byref(number))
        return number.value

    def notice(self, integrator: Any) -> None:
        """Let an integrator of this library notice that another part of a CompoundIntegrator has moved particles."""
        self.call("notice", integrator)

    def face(self, pointer: int) -> Any:
        """Return a Python object, which does not own it, for an existing integrator of this library."""
        self.exported.pi_hand(ctypes.c_void_p(pointer))
        face = self.make()
        face.thisown = 0
        return face

    def call_back(
        self,
        bound: Callable[[int, int], None],
        step: Callable[[int, int], None],
        asked: Callable[[int], None],
        other_format: str,
    ) -> None:
        """Let integrators with settings call functions of Python.

        bound(pointer, number) is called while a Context is created, step(number, steps) for steps that C++ starts, and
        asked(number) when C++ asks for the tolerance of constraints. If such a function raises an error, C++ throws an
        OpenMMException with its message.
        """
        kinds = (_BOUND, bound), (_STEP, step), (_ASKED, asked)
        self._callbacks = [kind(self._reporting(function)) for kind, function in kinds]
        self.exported.pi_hooks(*self._callbacks, other_format.encode())

    def _reporting(self, function: Callable[..., None]) -> Callable[..., int]:
        """Return a function that calls another one, and returns 1 after an error, which is reported to C++."""

        def reporting(*arguments: Any) -> int:
            try:
                function(*arguments)
            except BaseException as error:  # an error that leaves a callback is lost
                message = str(error) or type(error).__name__
                self.exported.pi_fail(message.encode(), isinstance(error, KeyboardInterrupt) and _repeatable())
                return 1
            return 0

        return reporting

    def step_openmm(self, integrator: Any, steps: int) -> None:
        """Let OpenMM perform its own part of steps, in which barostats and thermostats of the System act."""
        self.call("own", integrator, steps)

    def derivative(self, energy: str, variable: str) -> list[str]:
        """Return the steps that compute the derivative of an energy; see source/expressions.h.

        An OpenMMException is raised if the energy has functions other than those of OpenMM.
        """
        steps = self.exported.pi_derivative(energy.encode(), variable.encode())
        if steps is None:
            raise openmm.OpenMMException(self.exported.pi_error().decode())
        return str(steps.decode()).splitlines()

    def call(self, function: str, integrator: Any, *arguments: Any) -> None:
        """Call a function of the library without Python's global lock; raise OpenMMException if the function fails."""
        pointer = ctypes.c_void_p(int(integrator.this))
        if getattr(self.exported, f"pi_{function}")(pointer, *arguments):
            raise openmm.OpenMMException(self.exported.pi_error().decode())


class Machine:
    """Access to the program, the arrays and the scalars of a program integrator that has a Context.

    Parameters
    ----------
    integrator : openmm.CustomIntegrator
        An integrator that `Library.make` returned, or the Python object that represents it.
    """

    def __init__(self, library: Library, integrator: Any) -> None:
        self._library, self._integrator = library, weakref.ref(integrator)
        self._result = (ctypes.c_double * 4)()
        self._changes: ctypes.c_int | None = None  # memory of the integrator, which is read before every call

    def _call(self, function: str, *arguments: Any) -> None:
        self._library.call(function, self._integrator(), *arguments)

    def load(self, program: str) -> None:
        """Load a program, given as the text of an `openmm_exactrb.engines.native.program.Program`."""
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
        """Save the state of the Context and of the program in one of three places, 0 to 2."""
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
        if self._changes is None:
            bits = ctypes.POINTER(ctypes.c_int)()
            self._call("changes", ctypes.byref(bits))
            self._changes = bits.contents
        value = self._changes.value
        if value & clear:
            self._changes.value = value & ~clear
        return value

    def _count(self, which: int) -> int:
        value = ctypes.c_longlong()
        self._call("count", which, ctypes.byref(value))
        return value.value


def _repeatable() -> bool:
    """Return whether SIGINT raises KeyboardInterrupt in this thread."""
    handled = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    return handled and threading.current_thread() is threading.main_thread()


def library() -> Library:
    """Return the library; raise MissingLibraryError if it is not available."""
    found = _loaded()
    if isinstance(found, str):
        raise MissingLibraryError(found)
    return found


def missing() -> str | None:
    """Return why there is no library, or None."""
    found = _loaded()
    return found if isinstance(found, str) else None


@cache
def _loaded() -> Library | str:
    """Return the library, or the reason why it is not available; this is found out once in a process."""
    try:
        found = Library(_bundled() or compiled())
    except (MissingLibraryError, CompilationError) as error:
        return str(error)
    if _listeners:
        found.call_back(*_listeners)
    return found


def listen(*arguments: Any) -> None:
    """Set the arguments of `Library.call_back`."""
    _listeners[:] = arguments


def of_library(integrator: Any) -> bool:
    """Return whether an integrator is one of the library, if that is loaded."""
    loaded = _loaded() if _loaded.cache_info().currsize else None
    return isinstance(loaded, Library) and loaded.owns(integrator)


def adopt(integrator: Any) -> None:
    """Make a new integrator one of the library; if there is no library, say once what this means."""
    try:
        library().adopt(integrator)
    except MissingLibraryError as error:
        _say_slower(str(error))


@cache
def _say_slower(reason: str) -> None:
    _log.warning(SLOWER, reason)


def describe() -> str:
    """Return the path of the library, or a sentence that states how it will be compiled or why it is not available."""
    try:
        path = _bundled() or cached()
        if path.exists():
            return str(path)
        compilation.openmm_folder()  # raises an error if headers are missing
    except (MissingLibraryError, CompilationError) as error:
        return f"not available: {error}"
    return f"to be compiled by {compilation.compiler()} at first use, which takes some seconds"


def _bundled() -> Path | None:
    """Return the path of the wheel's library, or None if the wheel has none; raise errors if no library may be used."""
    asked = os.environ.get(LIBRARY, "")
    if asked == NONE:
        raise MissingLibraryError(f"the environment variable {LIBRARY} is {NONE}: unset it")
    if asked:
        raise ValueError(f"the environment variable {LIBRARY} is {asked!r}: unset it, or set it to {NONE!r}")
    compilation.check_openmm()
    return BUNDLED if BUNDLED.exists() else None


def cached() -> Path:
    """Return the path of the library in the user's cache, where the file may not exist yet."""
    digest = compilation.digest(*compilation.of_this_machine())
    return private_folder() / f"program_integrator-openmm{openmm.__version__}-{digest}.so"


def compiled() -> Path:
    """Return the path of the library in the user's cache, after compiling the library if it is missing."""
    path = cached()
    try:
        if not path.exists():
            with only_process(path.with_name("lock"), wait=True) as locked:
                if locked:  # what is left was left by a process that was killed
                    for left in path.parent.glob(f"{compilation.TEMPORARY}*"):
                        shutil.rmtree(left, ignore_errors=True)
                if not path.exists():
                    _compile(path)
        _check_owner(path)
    except OSError as error:
        raise MissingLibraryError(
            f"the library cannot be compiled ({error}): set the environment variable {CACHE} to another folder"
        ) from error
    return path


def _compile(path: Path) -> None:
    _log.warning("compiling the library of integrators, once on this machine, which takes about %d seconds", SECONDS)
    start = time.perf_counter()
    compilation.build(path, *compilation.of_this_machine())
    _log.warning("compiled in %.0f s; later processes load %s", time.perf_counter() - start, path)


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
