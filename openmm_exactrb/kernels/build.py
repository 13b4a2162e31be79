"""Compilation of functions by numba, with a cache on disk; importing this module imports numba."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache

_log = logging.getLogger("openmm_exactrb")

Function = Callable[..., Any]
_Decorator = Callable[[Function], Function]

_REORDERED = {"reassoc", "contract", "arcp", "nsz"}
# Functions that only compiled code calls need no wrappers, which take longer to compile than a short function.
_NO_WRAPPERS = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_PACKAGE = Path(__file__).parent.parent


def at_first_call(function: Function) -> Function:
    """Compile a function at its first call; its fast-math options (`_REORDERED`) still respect nan and infinity."""
    fast: Function = _cached(njit(error_model="numpy", nogil=True, fastmath=_REORDERED)(function))
    return fast


#: Marks a function that only compiled functions call.
inner: _Decorator = njit(error_model="numpy", **_NO_WRAPPERS)
#: The same as `inner`, with sums reordered and products fused.
inner_reordered: _Decorator = njit(error_model="numpy", fastmath=_REORDERED, **_NO_WRAPPERS)
#: Marks a function that is inlined into compiled functions.
inlined: _Decorator = njit(error_model="numpy", inline="always")


class _Cache(FunctionCache):  # type: ignore[misc]
    """numba's cache, with a key that also contains a hash of all kernel sources."""

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (*super()._index_key(sig, codegen), sources())


def _cached(dispatcher: Any) -> Any:
    """Let numba cache the compiled code of a function on disk."""
    dispatcher._cache = _Cache(dispatcher.py_func)  # noqa: SLF001  # numba has no public way to set the key
    return dispatcher


@cache
def sources() -> str:
    """Return a hash of all files from which functions are inlined into compiled code."""
    rooms = "kernels", "mathematics", "openmm_access", "potentials/compiled"
    files = [file for room in rooms for file in sorted(_PACKAGE.glob(f"{room}/*.py"))]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


class _Announcer(event.Listener):  # type: ignore[misc]
    """Logs once that kernels are being compiled."""

    told = False

    def on_start(self, event: Any) -> None:
        ours = event.data["dispatcher"].py_func.__module__.startswith("openmm_exactrb.")
        if ours and not self.told:
            self.told = True
            _log.warning("compiling kernels, which takes a few seconds; later processes load them from the cache")

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcer())
