import dask
import pytest
from distributed.utils import get_mp_context

from forked import FORKED, PRELOADED


@pytest.fixture(autouse=True, scope="package")
def forked_workers():
    """Have dask fork its workers from the process that the other tests fork theirs from."""
    with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
        get_mp_context()  # names what it wants to be preloaded, once
        FORKED.set_forkserver_preload(PRELOADED)
        yield
