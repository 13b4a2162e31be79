"""How functions are compiled and kept on disk, and a word to who waits for it. Importing this imports numba."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit, types
from numba.core import event
from numba.core.caching import FunctionCache

_log = logging.getLogger("openmm_exactrb")

Function = Callable[..., Any]

_REORDERED = {"reassoc", "contract", "arcp", "nsz"}
# What only compiled code calls needs no door from Python and no place on disk: they take longer than a short function.
_UNSEEN = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_PACKAGE = Path(__file__).parent.parent


def compiled(arguments: str) -> Callable[[Function], Function]:
    """Compile a function when it is defined, or load it from numba's cache on disk.

    Compiled code runs without Python's global lock, and divides as IEEE 754 says.

    Parameters
    ----------
    arguments : str
        What the function takes: "f" for a float, "i" for an integer, and for contiguous arrays of them their number
        of axes behind it; a capital letter is an array that the function writes to. "f2 F1" is a matrix and a result.
    """
    scalars = {"f": types.float64, "i": types.int64}

    def type_of(word: str) -> Any:
        scalar, axes = scalars[word[0].lower()], word[1:]
        return types.Array(scalar, int(axes), "C", readonly=word[0].islower()) if axes else scalar

    signature = types.void(*map(type_of, arguments.split()))

    def decorate(function: Function) -> Function:
        dispatcher: Any = _kept(njit(error_model="numpy", nogil=True)(function))
        dispatcher.compile(signature.args)
        dispatcher.disable_compile()
        ready: Function = dispatcher
        return ready

    return decorate


def reordered(function: Function) -> Function:
    """Compile a function for the arguments of its first call, with sums reordered and products fused.

    nan and inf stay what they are, no square root or division is approximated.
    """
    fast: Function = _kept(njit(error_model="numpy", nogil=True, fastmath=_REORDERED)(function))
    return fast


def inner(function: Function) -> Function:
    """Mark a function that compiled ones call, and nobody else."""
    callee: Function = njit(error_model="numpy", **_UNSEEN)(function)
    return callee


def inner_reordered(function: Function) -> Function:
    """Mark a function that compiled ones call, and nobody else, with the freedom of `reordered`."""
    callee: Function = njit(error_model="numpy", fastmath=_REORDERED, **_UNSEEN)(function)
    return callee


def inlined(function: Function) -> Function:
    """Mark a function that becomes a part of those that call it."""
    part: Function = njit(error_model="numpy", inline="always")(function)
    return part


class _Cache(FunctionCache):  # type: ignore[misc]
    """numba's cache, which looks at the file of a function only, with all sources of the kernels in its key."""

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (*super()._index_key(sig, codegen), sources())


def _kept(dispatcher: Any) -> Any:
    """Have numba keep on disk what it compiles."""
    dispatcher._cache = _Cache(dispatcher.py_func)  # noqa: SLF001  # numba has no door to the key of its cache
    return dispatcher


@cache
def sources() -> str:
    """Return a hash of all files that compiled code may be made of: functions are inlined from one into another."""
    files = [*sorted(_PACKAGE.glob("kernels/**/*.py")), _PACKAGE / "elliptic.py", _PACKAGE / "quaternions.py"]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


class _Announcer(event.Listener):  # type: ignore[misc]
    """Says once what the first run waits for."""

    told = False

    def on_start(self, event: Any) -> None:
        ours = event.data["dispatcher"].py_func.__module__.startswith("openmm_exactrb.")
        if ours and not self.told:
            self.told = True
            _log.warning("compiling kernels: a few seconds, once; the next process finds them in the cache")

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcer())
