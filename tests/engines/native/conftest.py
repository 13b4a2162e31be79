import locale
from pathlib import Path

import pytest

from places import REFERENCE, device_platform


def pytest_collection_modifyitems(items):
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker("library")


@pytest.fixture(autouse=True)
def _same_locale():
    """Restore the locale: OpenMM's PME leaves "C" on OpenCL (VkFFT), and files are read as ASCII in the tests after."""
    before = locale.setlocale(locale.LC_ALL)
    yield
    locale.setlocale(locale.LC_ALL, before)


@pytest.fixture(params=[pytest.param("native", marks=pytest.mark.opencl), "Reference"])
def where(request):
    """Return the name of a place where the engine runs, and the platform there."""
    return request.param, device_platform() if request.param == "native" else REFERENCE
