import os

import dask
import pytest
from distributed.utils import get_mp_context

from forked import START, preload

#: Accidents are signals of POSIX, and need processes that are forked.
collect_ignore_glob = ["*"] if os.name == "nt" else []


@pytest.fixture(autouse=True, scope="package")
def forked_workers():
    """Have dask fork its workers from the process that the other tests fork theirs from."""
    with dask.config.set({"distributed.worker.multiprocessing-method": START}):
        get_mp_context()  # names what it wants to be preloaded, once
        preload()
        yield
