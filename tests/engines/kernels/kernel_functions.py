"""Functions of the kernels for processors, compiled from the same texts and with the same flags as the library."""

import ctypes
import hashlib
from pathlib import Path

import mpmath as mp
import numpy as np

from openmm_exactrb.library import compilation
from openmm_exactrb.library.functions import passed
from openmm_exactrb.library.library import private_folder
from openmm_exactrb.support.lock import only_process

#: The unit of roundoff.
U = 2.0**-53


class Functions:
    """Functions of `*_functions.cpp`, compiled unless they are there, beside the library of these tests."""

    def __init__(self):
        sources = sorted(Path(__file__).parent.glob("*_functions.cpp"))
        flags = "-fvisibility=default", f"-I{compilation.SOURCES[0].parent}", *compilation.of_this_machine()
        own = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
        folder = private_folder()
        path = folder / f"kernel_functions-{compilation.digest(*flags, own)}.so"
        with only_process(folder, wait=True):
            if not path.exists():
                compilation.build(path, *flags, sources=sources)
        self._library = ctypes.CDLL(str(path))
        self.at_once = self._library.bodies_at_once()

    def __call__(self, name, *arguments):
        """Call a function, which writes its results into arrays among its arguments."""
        return getattr(self._library, name)(*map(passed, arguments))


def pairs(numbers, low=0.0):
    """Return numbers of the state (..., 2) from their high and low parts."""
    return np.stack(np.broadcast_arrays(numbers, low), axis=-1)


def sum_of(pair):
    """Return the value of a number of the state, in mpf."""
    return mp.mpf(float(pair[0])) + mp.mpf(float(pair[1]))


def words_of_numpy(key, counter):
    """Return the block of words (4,) of NumPy's generator, which increments the counter before each block."""
    before = (sum(word << 64 * k for k, word in enumerate(counter)) - 1) % 2**256
    return np.random.Philox(key=np.array([key, 0], np.uint64), counter=before).random_raw(4)
