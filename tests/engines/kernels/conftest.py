import os
import sys

import pytest
from kernel_functions import Functions

from openmm_exactrb.library import compilation


@pytest.fixture(scope="session")
def kernels(tmp_path_factory):
    """Functions of the kernels, compiled once: pytest's workers share a folder."""
    if sys.platform == "win32":
        pytest.skip("functions are exported by name on Windows")
    folder = tmp_path_factory.getbasetemp()
    try:
        compilation.compiler()
        compilation.openmm_folder()
    except compilation.CompilationError as error:
        pytest.skip(f"needs a C++ compiler: {error}")
    return Functions(folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder)
