import sys

import pytest
from kernel_functions import Functions

from openmm_exactrb.library import compilation


@pytest.fixture(scope="session")
def kernels():
    """Functions of the kernels, compiled once for all workers."""
    if sys.platform == "win32":
        pytest.skip("functions are exported by name on Windows")
    try:
        compilation.compiler()
        compilation.openmm_folder()
    except compilation.CompilationError as error:
        pytest.skip(f"needs a C++ compiler: {error}")
    return Functions()
